//! Code that all loaders share: limits, file reading, and the texts of remedies.

use std::path::Path;

use crate::SceneError;

/// The remedy for a file that violates its format.
pub(crate) const EXPORT_AGAIN: &str =
    "the file is damaged or its exporter is at fault; export or copy the file again";
/// The remedy for a coordinate that is not a finite 32-bit float.
pub(crate) const REPAIR_VERTEX: &str =
    "remove or repair the vertex (coordinates must be finite 32-bit floats) and export again";

/// The maximum size of a loaded scene. Instances and strips can describe far more triangles than the file has
/// bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadLimits {
    /// Maximum number of triangles.
    pub triangles: u32,
    /// Maximum number of objects.
    pub objects: u32,
}

impl Default for LoadLimits {
    /// Returns limits of 268 435 456 triangles (9.7 GB of vertices) and 4 194 304 objects.
    fn default() -> Self {
        Self {
            triangles: 1 << 28,
            objects: 1 << 22,
        }
    }
}

/// Reads at most `limit` bytes of a regular file. Rejects a directory, a device or a pipe.
pub(super) fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, SceneError> {
    use std::io::Read;
    let io = |e| SceneError::io(path, e);
    let meta = std::fs::metadata(path).map_err(io)?;
    if !meta.is_file() {
        return Err(SceneError::bad(
            path.display().to_string(),
            "whole file",
            "the path is not a regular file",
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

/// Creates the error for a scene that has more triangles than `limits` allows from `element` on.
pub(super) fn too_many_triangles(file: &str, element: String, limits: &LoadLimits) -> SceneError {
    SceneError::bad(
        file,
        element,
        format!(
            "with this element, the scene has more than {} triangles",
            limits.triangles
        ),
        "split the scene into parts, or use fewer instances",
    )
}

/// Creates the error for a scene that has more objects than `limits` allows from `element` on.
pub(super) fn too_many_objects(file: &str, element: String, limits: &LoadLimits) -> SceneError {
    SceneError::bad(
        file,
        element,
        format!(
            "with this element, the scene has more than {} objects",
            limits.objects
        ),
        "merge objects before exporting",
    )
}
