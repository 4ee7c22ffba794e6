//! Opening a result, and checking that it was baked from a given scene.

use std::path::Path;

use sightline_pvs::{Pvs, PvsError};
use sightline_scene::Scene;

use crate::error::CliError;

/// A number with its noun, in the plural unless the number is 1.
pub fn plural(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Opens a result; the error names the file.
pub fn open(path: &Path) -> Result<Pvs, CliError> {
    Pvs::open(path).map_err(|e| match e {
        PvsError::Open { .. } => CliError::Input(format!("{e}; name a file that `sightline bake` wrote")),
        e => CliError::Input(format!("{}: {e}", path.display())),
    })
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
    if info["scene"].as_str().is_some_and(|digest| digest != scene.digest().to_string()) {
        return Err(CliError::Input(format!(
            "{} was baked from another scene than {}; name that scene, or bake again",
            result.display(),
            path.display()
        )));
    }
    Ok(())
}
