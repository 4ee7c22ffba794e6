//! The scenes of a benchmark, and the command line of a bake.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use sightline_scene::Aabb;

use crate::error::BenchError;

/// A scene to measure.
pub struct Input {
    /// The path of the scene's file.
    pub path: PathBuf,
    /// The name of the scene in tables and files.
    pub name: String,
    /// The number of triangles of the scene.
    pub triangles: u32,
    /// The bounding box of the scene's triangles.
    pub bounds: Aabb,
}

/// Reads every scene once. The benchmark then reports faults of files before the first bake, and no bake
/// waits for the disk.
pub fn inputs(paths: &[PathBuf]) -> Result<Vec<Input>, BenchError> {
    let stem = |p: &Path| {
        p.file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let mut inputs = Vec::new();
    for path in paths {
        let alone = paths.iter().filter(|p| stem(p) == stem(path)).count() == 1;
        let name = if alone {
            stem(path)
        } else {
            path.display().to_string()
        };
        let scene = sightline_scene::load(path).map_err(|e| BenchError::Input(e.to_string()))?;
        inputs.push(Input {
            path: path.clone(),
            name,
            triangles: scene.len(),
            bounds: scene.bounds(),
        });
    }
    Ok(inputs)
}

/// Returns the command line of a bake of `scene` to `folder`/out.pvs, from an empty store.
pub fn bake_line(scene: &Path, folder: &Path) -> Vec<OsString> {
    vec![
        "bake".into(),
        scene.into(),
        "-o".into(),
        folder.join("out.pvs").into(),
        "--data-dir".into(),
        folder.join("store").into(),
        "--backend".into(),
        "cpu".into(),
    ]
}
