//! The reading of scenes from a file or from memory, with the kinds and sides of triangles.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sightline_scene::kinds::SurfaceKind;
use sightline_scene::{KindRule, Object, Scene, Triangle, load};

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
    /// A file with the extension .obj, .ply, .gltf or .glb.
    File(PathBuf),
    /// Triangles in world space in the order of their ids, and the objects that they form.
    Triangles(Vec<Triangle>, Vec<Object>),
}

impl SceneSource {
    /// Returns the path of the file, or `mesh` for triangles, for messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Triangles(..) => Path::new("mesh"),
        }
    }
}

/// The options for reading a scene: the kinds of its triangles, and their sides.
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
    /// Kinds of objects and materials by globs over their names. If several rules match a name, the last one
    /// counts. In JSON, a rule is a pair of a kind's name and a glob.
    #[serde(with = "rules")]
    pub rules: Vec<KindRule>,
    /// True to read the textures of masked materials.
    pub alpha_textures: bool,
    /// True if triangles show and block only from their front. Materials with doubleSided have two front
    /// sides.
    pub cull_back_faces: bool,
}

impl LoadOptions {
    /// Returns true if no option is given.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the options with which a result was baked. `name` is the name of the result, for messages.
    fn from_info(info: &serde_json::Value, name: &Path) -> Result<Self, Error> {
        let rules = info["kinds"]["rules"].as_array().map_or(&[][..], |r| r);
        let rule = |r: &serde_json::Value| {
            KindRule::new(
                SurfaceKind::from_name(r["kind"].as_str()?)?,
                r["glob"].as_str()?,
            )
            .ok()
        };
        let rules = rules.iter().map(|r| {
            rule(r).ok_or_else(|| {
                Error::input(format!(
                    "{}: the rule {r} about kinds of triangles is unknown to this version; bake the scene \
                     again",
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

/// The serialisation of rules as pairs of names, for serde.
mod rules {
    use serde::de::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use sightline_scene::KindRule;
    use sightline_scene::kinds::SurfaceKind;

    pub(super) fn serialize<S: Serializer>(rules: &[KindRule], to: S) -> Result<S::Ok, S::Error> {
        let pairs: Vec<(&str, &str)> = rules.iter().map(|r| (r.kind.name(), &*r.glob)).collect();
        pairs.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Vec<KindRule>, D::Error> {
        let pairs = Vec::<(String, String)>::deserialize(from)?;
        let rule = |(kind, glob): &(String, String)| {
            let kind = SurfaceKind::from_name(kind).ok_or_else(|| {
                D::Error::custom(format!(
                    "{kind:?} is not a kind of triangles; see \
                docs/kinds.md"
                ))
            })?;
            KindRule::new(kind, glob).map_err(D::Error::custom)
        };
        pairs.iter().map(rule).collect()
    }
}

/// Reads a scene. The observer receives warnings about the parts of the file that the program ignores.
///
/// Coordinates are in world space, in the units of the file. Triangles are numbered in the order of the file.
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
/// [`crate::ErrorKind::Input`] with the file, the element and the reason, if the scene cannot be read.
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
    let options = load::LoadOptions {
        limits: load::LoadLimits::default(),
        rules,
        alpha_textures,
        cull_back_faces,
    };
    let path = source.path();
    let loaded = match source {
        SceneSource::File(path) => sightline_scene::load_with(path, &options),
        SceneSource::Triangles(triangles, objects) => load::from_memory(
            &path.display().to_string(),
            triangles.clone(),
            objects.clone(),
            &options,
        ),
    }?;
    for text in &loaded.warnings {
        warn(observer, format!("{}: {text}", path.display()));
    }
    Ok(Arc::new(loaded.scene))
}

/// Reads the scene of a result. The options are `options` if any are given, and otherwise the options of the
/// bake.
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the scene cannot be read or is not the scene of the result.
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
