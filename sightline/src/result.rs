//! Results: reading result files, and checking that a result was baked from a given scene.

use std::path::Path;

use sightline_pvs::{Pvs, PvsError};
use sightline_scene::Scene;
use sightline_scene::kinds::{KindCount, SurfaceKind};

use crate::error::Error;
use crate::words::plural;

/// An open result with its name for messages.
///
/// ```no_run
/// use sightline::{NamedResult, open};
///
/// let path = "level.pvs".as_ref();
/// let pvs = open(path)?;
/// let result = NamedResult::new(&pvs, path);
/// println!("{}", result.info()["spec"]);
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct NamedResult<'a> {
    /// The result.
    pub pvs: &'a Pvs,
    /// The name for messages, which is a path.
    pub name: &'a Path,
}

impl<'a> NamedResult<'a> {
    /// Creates a result with a name.
    pub fn new(pvs: &'a Pvs, name: &'a Path) -> Self {
        Self { pvs, name }
    }

    /// Returns the description of the bake, or null if another program wrote a result without one.
    pub fn info(&self) -> serde_json::Value {
        serde_json::from_str(self.pvs.info_json()).unwrap_or_default()
    }

    /// Creates an error about the result.
    pub(crate) fn error(&self, e: impl std::fmt::Display) -> Error {
        Error::input(format!("{}: {e}", self.name.display()))
    }
}

/// Opens a result file, which is mapped into memory, and checks all of it.
///
/// ```no_run
/// let pvs = sightline::open("level.pvs".as_ref())?;
/// let mut triangles = Vec::new();
/// if let Some(cell) = pvs.find_cell([1.5, 2.0, -3.0]) {
///     pvs.visible(cell, &mut triangles)?;
/// }
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Input`] with the file and the reason, if the file cannot be read or is damaged.
pub fn open(path: &Path) -> Result<Pvs, Error> {
    Pvs::open(path).map_err(|e| match e {
        PvsError::Open { .. } => {
            Error::input(format!("{e}; give a file that `sightline bake` wrote"))
        }
        PvsError::Memory { .. } => Error::internal(format!("{}: {e}", path.display())),
        e => Error::input(format!("{}: {e}", path.display())),
    })
}

/// Checks that a result was baked from `scene`. `path` is the path of the scene, for messages.
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the result was baked from another scene.
pub fn check_scene(scene: &Scene, path: &Path, result: NamedResult<'_>) -> Result<(), Error> {
    let (pvs, name) = (result.pvs, result.name.display());
    if scene.len() != pvs.triangle_count() {
        return Err(Error::input(format!(
            "{} has {}, but {name} was baked from another scene with {} triangles; give that scene",
            path.display(),
            plural(scene.len() as usize, "triangle"),
            pvs.triangle_count()
        )));
    }
    // A result of another program may lack the digest. Results of earlier versions identify the scene without
    // the positions of its objects in a glTF file.
    let info = result.info();
    let digests = [scene.digest(), scene.digest_without_sources()].map(|d| d.to_string());
    match info["spec"]["scene"].as_str() {
        Some(digest) if digests.iter().all(|own| own != digest) => Err(Error::input(format!(
            "{name} was baked from another scene than {}, or with other flags for kinds of \
             surfaces; give that scene, or bake again",
            path.display()
        ))),
        Some(_) | None => Ok(()),
    }
}

/// Checks that a scene has no alpha masks, which exact queries do not support.
///
/// # Errors
/// [`crate::ErrorKind::Usage`] if the scene has alpha masks.
pub fn without_masks(scene: &Scene) -> Result<(), Error> {
    if scene.kinds().any_masked() {
        return Err(Error::usage(
            "exact queries do not read alpha textures; omit --alpha-textures, so that masked \
             geometry is see-through as a whole, or bake with --method aggressive",
        )
        .about("alpha-textures"));
    }
    Ok(())
}

/// Returns the numbers of triangles of each kind from the description (`info`) of a result.
pub fn kind_counts(info: &serde_json::Value) -> Vec<KindCount> {
    let counts = info["kinds"]["counts"].as_array().map_or(&[][..], |c| c);
    let count = |c: &serde_json::Value| {
        Some(KindCount {
            kind: SurfaceKind::from_name(c["kind"].as_str()?)?,
            reason: c["reason"].as_str()?.to_owned(),
            triangles: c["triangles"].as_u64()?,
        })
    };
    counts.iter().filter_map(count).collect()
}
