//! Reading scene files: OBJ, PLY, glTF and GLB become one [`Scene`] whose ids follow the order of the file.
//!
//! The content of a file determines its kind, which must agree with the extension. Nothing is repaired: a
//! file that violates its format is refused with the element at fault. Materials, normals, texture
//! coordinates, skinning, morphing and animation are ignored, because they do not change which static
//! triangles exist.

mod gltf;
mod limits;
mod names;
mod obj;
mod ply;
mod sniff;

use std::path::Path;

use crate::{Scene, SceneError};
pub use limits::Limits;
use limits::read_file;
pub use sniff::Kind;

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
