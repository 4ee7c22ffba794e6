//! The reading of scenes: from a file or from memory, with the kinds and sides of triangles.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sightline_scene::kinds::Kind;
use sightline_scene::{Object, Rule, Scene, Triangle, load};

use crate::error::Error;
use crate::observer::{Observer, warn};
use crate::process::{threads, use_threads};
use crate::result::{NamedResult, check_scene};

/// The source of a scene.
///
/// ```
/// use sightline::SceneSource;
///
/// let source = SceneSource::File("level.glb".into());
/// assert_eq!(source.path().to_str(), Some("level.glb"));
/// ```
#[derive(Clone, Debug)]
pub enum SceneSource {
    /// A file: .obj, .ply, .gltf or .glb.
    File(PathBuf),
    /// Triangles in the order of their ids, and the objects that they form, in world space.
    Triangles(Vec<Triangle>, Vec<Object>),
}

impl SceneSource {
    /// Returns the file, or a word that stands for the mesh in messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Triangles(..) => Path::new("mesh"),
        }
    }
}

/// The options of reading a scene: the kinds of its triangles, and the sides that they have.
///
/// ```
/// let options: sightline::LoadOptions =
///     serde_json::from_str(r#"{"rules": [["see-through", "glass*"]]}"#)?;
/// assert_eq!(options.rules[0].glob, "glass*");
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LoadOptions {
    /// Kinds of objects and materials by globs over their names. Of several rules that match a name, the last
    /// one counts. As JSON, a rule is a pair of a kind's name and a glob.
    #[serde(with = "rules")]
    pub rules: Vec<Rule>,
    /// True if the textures of masked materials are read.
    pub alpha_textures: bool,
    /// True if triangles show and block from their front only.
    pub cull_back_faces: bool,
}

impl LoadOptions {
    /// Returns true if no option is given.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the options with which a result was baked. `name` is the result's in messages.
    fn from_info(info: &serde_json::Value, name: &Path) -> Result<Self, Error> {
        let rules = info["kinds"]["rules"].as_array().map_or(&[][..], |r| r);
        let rule = |r: &serde_json::Value| {
            Rule::new(Kind::from_name(r["kind"].as_str()?)?, r["glob"].as_str()?).ok()
        };
        let rules = rules.iter().map(|r| {
            rule(r).ok_or_else(|| {
                Error::input(format!(
                    "{}: the rule about kinds {r} is unknown; bake the scene again",
                    name.display()
                ))
            })
        });
        Ok(Self {
            rules: rules.collect::<Result<_, _>>()?,
            alpha_textures: info["kinds"]["alpha_textures"] == true,
            cull_back_faces: info["cull_back_faces"] == true,
        })
    }
}

/// Rules as pairs of names, for serde.
mod rules {
    use serde::de::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use sightline_scene::Rule;
    use sightline_scene::kinds::Kind;

    pub(super) fn serialize<S: Serializer>(rules: &[Rule], to: S) -> Result<S::Ok, S::Error> {
        let pairs: Vec<(&str, &str)> = rules.iter().map(|r| (r.kind.name(), &*r.glob)).collect();
        pairs.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Rule>, D::Error> {
        let pairs = Vec::<(String, String)>::deserialize(from)?;
        let rule = |(kind, glob): &(String, String)| {
            let kind = Kind::from_name(kind)
                .ok_or_else(|| D::Error::custom(format!("{kind:?} is not a kind of triangles")))?;
            Rule::new(kind, glob).map_err(D::Error::custom)
        };
        pairs.iter().map(rule).collect()
    }
}

/// Reads a scene. The observer receives warnings about the parts of the file that the program ignores.
///
/// Coordinates are in world space, in the units of the file; triangles are numbered in the order of the file.
///
/// ```
/// use sightline::{LoadOptions, SceneSource, Silent, read_scene};
/// use sightline_scene::{Object, Triangle};
///
/// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(Into::into);
/// let object = Object { name: "floor".into(), first: 0, count: 1 };
/// let source = SceneSource::Triangles(vec![Triangle { v: corners }], vec![object]);
/// let scene = read_scene(&source, &LoadOptions::default(), &Silent)?;
/// assert_eq!(scene.len(), 1);
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Input`] with the file, the element and the reason.
pub fn read_scene(
    source: &SceneSource,
    options: &LoadOptions,
    observer: &dyn Observer,
) -> Result<Arc<Scene>, Error> {
    use_threads(threads(None))?;
    let LoadOptions {
        rules,
        alpha_textures,
        cull_back_faces,
    } = options.clone();
    let options = load::Options {
        limits: load::Limits::default(),
        rules,
        alpha_textures,
        cull_back_faces,
    };
    let path = source.path();
    let loaded = match source {
        SceneSource::File(path) => sightline_scene::load_with(path, &options),
        SceneSource::Triangles(triangles, objects) => load::from_memory(
            &path.display().to_string(),
            (triangles.clone(), objects.clone()),
            &options,
        ),
    }?;
    for text in &loaded.warnings {
        warn(observer, format!("{}: {text}", path.display()));
    }
    Ok(Arc::new(loaded.scene))
}

/// Reads the scene of a result, with the options of the user, or otherwise the options of the bake.
///
/// # Errors
/// [`crate::ErrorKind::Input`], also for another scene than that of the result.
pub fn read_scene_of(
    source: &SceneSource,
    options: &LoadOptions,
    result: NamedResult<'_>,
    observer: &dyn Observer,
) -> Result<Arc<Scene>, Error> {
    let scene = if options.is_empty() {
        let options = LoadOptions::from_info(&result.info(), result.name)?;
        read_scene(source, &options, observer)?
    } else {
        read_scene(source, options, observer)?
    };
    check_scene(&scene, source.path(), result)?;
    Ok(scene)
}
