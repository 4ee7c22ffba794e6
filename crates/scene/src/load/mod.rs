//! Reading scene files: OBJ, PLY, glTF and GLB become one [`Scene`] whose ids follow the order of the file.
//!
//! The content of a file determines its kind, which must agree with the extension. Nothing is repaired: a
//! file that violates its format is refused with the element at fault. Materials, normals, texture
//! coordinates, skinning, morphing and animation are ignored, because they do not change which static
//! triangles exist.

mod gltf;
mod names;
mod obj;
mod ply;
mod sniff;

use std::path::Path;

use crate::{Scene, SceneError};
pub use sniff::Kind;

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
        Self { triangles: 1 << 28, objects: 1 << 22 }
    }
}

/// Reads the scene in `path`, whose extension must agree with its content.
///
/// Relative URIs of buffers in a glTF file are relative to the directory of the file.
///
/// # Errors
/// [`SceneError::Io`] when a file cannot be read, [`SceneError::Bad`] when its contents cannot be used.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    let name = path.display().to_string();
    let bytes = read_file(path, u64::MAX)?;
    // The empty parent of a bare file name is the current directory.
    let base = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    load_bytes(&name, &bytes, Some(base))
}

/// Reads a scene held in memory. `name` appears in errors and gives the extension; a name without a known
/// extension is judged by content alone. Without `base_dir`, buffers outside the file are refused.
///
/// # Errors
/// As [`load`].
pub fn load_bytes(name: &str, bytes: &[u8], base_dir: Option<&Path>) -> Result<Scene, SceneError> {
    load_bytes_limited(name, bytes, base_dir, &Limits::default())
}

/// [`load_bytes`] with limits on the number of triangles and objects.
///
/// # Errors
/// As [`load`], and [`SceneError::Bad`] when the scene is beyond `limits`.
pub fn load_bytes_limited(
    name: &str,
    bytes: &[u8],
    base_dir: Option<&Path>,
    limits: &Limits,
) -> Result<Scene, SceneError> {
    match sniff::kind_of(name, bytes)? {
        Kind::Obj => obj::parse(name, bytes, limits),
        Kind::Ply => ply::parse(name, bytes, limits),
        Kind::Gltf => gltf::parse_json(name, bytes, base_dir, limits),
        Kind::Glb => gltf::parse_glb(name, bytes, base_dir, limits),
    }
}

/// At most `limit` bytes of a regular file; anything else (a directory, a device, a pipe) is refused.
fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, SceneError> {
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
fn too_many_triangles(file: &str, element: String, limits: &Limits) -> SceneError {
    SceneError::bad(
        file,
        element,
        format!("the scene has more than {} triangles with it", limits.triangles),
        "split the scene into parts, or use fewer instances",
    )
}

/// The refusal of a scene with more objects than `limits` allows.
fn too_many_objects(file: &str, element: String, limits: &Limits) -> SceneError {
    SceneError::bad(
        file,
        element,
        format!("the scene has more than {} objects with it", limits.objects),
        "merge objects before exporting",
    )
}
