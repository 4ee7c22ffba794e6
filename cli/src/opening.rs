//! Opening scenes and results, and checking that a result was baked from a given scene.

use std::path::{Path, PathBuf};

use sightline_pvs::{Pvs, PvsError};
use sightline_scene::kinds::{Kind, KindCount};
use sightline_scene::{Object, Rule, Scene, Triangle};

use crate::error::CliError;
use crate::kind_args::KindArgs;
use crate::progress::say;

/// A number with its noun, in the plural unless the number is 1.
pub fn plural(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Opens a result; the error names the file.
pub fn open(path: &Path) -> Result<Pvs, CliError> {
    Pvs::open(path).map_err(|e| match e {
        PvsError::Open { .. } => {
            CliError::Input(format!("{e}; name a file that `sightline bake` wrote"))
        }
        PvsError::Memory { .. } => CliError::Internal(format!("{}: {e}", path.display())),
        e => CliError::Input(format!("{}: {e}", path.display())),
    })
}

/// Where a scene comes from.
#[derive(Clone, Debug)]
pub enum Source {
    /// A file: .obj, .ply, .gltf or .glb.
    File(PathBuf),
    /// Triangles in the order of their ids, and the objects that they form.
    Memory(Vec<Triangle>, Vec<Object>),
}

impl Source {
    /// The file, or a word that stands for a mesh in messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Memory(..) => Path::new("mesh"),
        }
    }
}

/// Reads a scene file with the flags of the user about kinds and sides, and prints the warnings.
pub fn scene(path: &Path, kinds: &KindArgs) -> Result<Scene, CliError> {
    read(&Source::File(path.to_owned()), kinds)
}

/// Reads a scene with the flags of the user about kinds and sides, and prints the warnings.
pub fn read(source: &Source, kinds: &KindArgs) -> Result<Scene, CliError> {
    let KindArgs {
        rules,
        alpha_textures,
        cull_back_faces,
    } = kinds.clone();
    let limits = sightline_scene::load::Limits::default();
    let options = sightline_scene::load::Options {
        limits,
        rules,
        alpha_textures,
        cull_back_faces,
    };
    let path = source.path();
    let loaded = match source {
        Source::File(path) => sightline_scene::load_with(path, &options),
        Source::Memory(triangles, objects) => sightline_scene::load::from_memory(
            &path.display().to_string(),
            (triangles.clone(), objects.clone()),
            &options,
        ),
    }?;
    loaded
        .warnings
        .iter()
        .for_each(|w| say(&format!("warning: {}: {w}", path.display())));
    Ok(loaded.scene)
}

/// Reads the scene file of a result: with the flags of the user, or else with those that the result was baked
/// with.
pub fn scene_of(
    path: &Path,
    kinds: &KindArgs,
    pvs: &Pvs,
    result: &Path,
) -> Result<Scene, CliError> {
    read_for(&Source::File(path.to_owned()), kinds, pvs, result)
}

/// Reads the scene of a result, as [`scene_of`].
pub fn read_for(
    source: &Source,
    kinds: &KindArgs,
    pvs: &Pvs,
    result: &Path,
) -> Result<Scene, CliError> {
    let scene = if kinds.is_empty() {
        read(source, &flags_of(pvs, result)?)?
    } else {
        read(source, kinds)?
    };
    check_scene(&scene, pvs, source.path(), result)?;
    Ok(scene)
}

/// The flags that a result was baked with.
fn flags_of(pvs: &Pvs, result: &Path) -> Result<KindArgs, CliError> {
    let info: serde_json::Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    let cull_back_faces = info["cull_back_faces"] == true;
    let rules = info["kinds"]["rules"].as_array().map_or(&[][..], |r| r);
    let rule = |r: &serde_json::Value| {
        Rule::new(Kind::from_name(r["kind"].as_str()?)?, r["glob"].as_str()?).ok()
    };
    let rules = rules
        .iter()
        .map(|r| {
            rule(r).ok_or_else(|| {
                CliError::Input(format!(
                    "{}: it names a rule about kinds that is none: {r}",
                    result.display()
                ))
            })
        })
        .collect::<Result<_, _>>()?;
    let alpha_textures = info["kinds"]["alpha_textures"] == true;
    Ok(KindArgs {
        rules,
        alpha_textures,
        cull_back_faces,
    })
}

/// Refuses a scene with alpha masks where exact queries are asked for.
pub fn without_masks(scene: &Scene) -> Result<(), CliError> {
    if scene.kinds().any_masked() {
        return Err(CliError::Usage(
            "exact queries do not read alpha textures; leave out --alpha-textures, so that masked geometry \
             is see-through as a whole, or bake with --method aggressive"
                .to_owned(),
        ));
    }
    Ok(())
}

/// The counts of kinds in the description of a result.
pub fn counts_of(info: &serde_json::Value) -> Vec<KindCount> {
    let counts = info["kinds"]["counts"].as_array().map_or(&[][..], |c| c);
    let count = |c: &serde_json::Value| {
        Some(KindCount {
            kind: Kind::from_name(c["kind"].as_str()?)?,
            reason: c["reason"].as_str()?.to_owned(),
            triangles: c["triangles"].as_u64()?,
        })
    };
    counts.iter().filter_map(count).collect()
}

/// The kinds and sides of a scene in words, one line each.
pub fn scene_in_words(scene: &Scene) -> Vec<String> {
    let mut lines = kinds_in_words(&scene.kinds().counts());
    let one_sided = scene.sides().one_sided();
    if one_sided > 0 {
        lines.push(sides_in_words(Some(one_sided)));
    }
    lines
}

/// Says that back faces are culled, and how many triangles have one side where that is known.
pub fn sides_in_words(one_sided: Option<u64>) -> String {
    let count = one_sided.map_or(String::new(), |n| format!(" ({n} triangles)"));
    format!("back faces are culled: triangles without a double-sided material have one side{count}")
}

/// The kinds of a scene in words, one line each.
pub fn kinds_in_words(counts: &[KindCount]) -> Vec<String> {
    if counts.is_empty() {
        return vec![
            "all triangles are opaque: no material, animation or flag says otherwise".to_owned(),
        ];
    }
    Kind::ALL
        .into_iter()
        .filter_map(|kind| {
            let of: Vec<&KindCount> = counts.iter().filter(|c| c.kind == kind).collect();
            let sum: u64 = of.iter().map(|c| c.triangles).sum();
            let reasons: Vec<String> = of
                .iter()
                .map(|c| format!("{} {}", c.triangles, c.reason))
                .collect();
            (sum > 0).then(|| format!("{}: {sum} triangles ({})", kind.name(), reasons.join(", ")))
        })
        .collect()
}

/// Refuses a scene that is not the one a result was baked from.
pub fn check_scene(scene: &Scene, pvs: &Pvs, path: &Path, result: &Path) -> Result<(), CliError> {
    if scene.len() != pvs.triangle_count() {
        return Err(CliError::Input(format!(
            "{} has {}, but {} was baked from another scene, one of {}; name that scene",
            path.display(),
            plural(scene.len() as usize, "triangle"),
            result.display(),
            pvs.triangle_count()
        )));
    }
    let info: serde_json::Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    // A result written by another program may lack the digest.
    let is_of = |digest: &str| {
        // Results of earlier versions name the scene without the places of its objects in a glTF file.
        digest == scene.digest().to_string() || digest == scene.digest_without_sources().to_string()
    };
    if info["spec"]["scene"]
        .as_str()
        .is_some_and(|digest| !is_of(digest))
    {
        return Err(CliError::Input(format!(
            "{} was baked from another scene than {}, or with other flags about what blocks and shows; name \
             that scene, or bake again",
            result.display(),
            path.display()
        )));
    }
    Ok(())
}
