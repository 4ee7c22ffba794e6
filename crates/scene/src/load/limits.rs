//! What all loaders share: limits, the reading of files, and the texts of remedies.

use std::path::Path;

use crate::SceneError;

/// Remedy for a file that violates its format.
pub(crate) const EXPORT_AGAIN: &str =
    "the file is damaged or its exporter is at fault; export or copy it again";
/// Remedy for a coordinate that is no finite 32-bit float.
pub(crate) const REPAIR_VERTEX: &str =
    "remove or repair the vertex (coordinates must be finite 32-bit floats) and export again";

/// Limits of a loaded scene. Instances and strips can name far more triangles than the file has bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most triangles accepted.
    pub triangles: u32,
    /// Most objects accepted.
    pub objects: u32,
}

impl Default for Limits {
    /// 268 435 456 triangles (9.7 GB of vertices) and 4 194 304 objects.
    fn default() -> Self {
        Self {
            triangles: 1 << 28,
            objects: 1 << 22,
        }
    }
}

/// At most `limit` bytes of a regular file; anything else (a directory, a device, a pipe) is refused.
pub(super) fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, SceneError> {
    use std::io::Read;
    let io = |e| SceneError::io(path, e);
    let meta = std::fs::metadata(path).map_err(io)?;
    if !meta.is_file() {
        return Err(SceneError::bad(
            path.display().to_string(),
            "whole file",
            "it is not a regular file",
            "name a scene file (.obj, .ply, .gltf or .glb)",
        ));
    }
    let file = std::fs::File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    bytes
        .try_reserve_exact(usize::try_from(meta.len().min(limit)).unwrap_or(usize::MAX))
        .map_err(|e| io(std::io::Error::new(std::io::ErrorKind::OutOfMemory, e)))?;
    file.take(limit).read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}

/// The refusal of a scene with more triangles than `limits` allows.
pub(super) fn too_many_triangles(file: &str, element: String, limits: &Limits) -> SceneError {
    SceneError::bad(
        file,
        element,
        format!(
            "the scene has more than {} triangles with it",
            limits.triangles
        ),
        "split the scene into parts, or use fewer instances",
    )
}

/// The refusal of a scene with more objects than `limits` allows.
pub(super) fn too_many_objects(file: &str, element: String, limits: &Limits) -> SceneError {
    SceneError::bad(
        file,
        element,
        format!("the scene has more than {} objects with it", limits.objects),
        "merge objects before exporting",
    )
}
