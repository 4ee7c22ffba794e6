//! Reading scene files: OBJ, PLY, glTF and GLB become one [`Scene`] whose ids follow the order of the file.
//!
//! The content of a file determines its kind, which must agree with the extension. Nothing is repaired: a
//! file that violates its format is refused with the element at fault. Materials, animations and skins decide
//! the kinds of triangles ([`mod@crate::kinds`]), unless a rule of the user does. Normals, texture
//! coordinates (except those of masks) and morph targets are ignored.

mod gltf;
mod limits;
mod marks;
mod memory;
mod mtl;
mod names;
mod obj;
mod ply;
mod sniff;

use std::path::Path;

pub use self::gltf::{EXTENSIONS, Extension, Support, uri_bytes};
use self::marks::Marks;
use crate::{Rule, Scene, SceneError, Sides};
pub use limits::Limits;
use limits::read_file;
pub use memory::from_memory;
pub use sniff::Kind;

/// Options of loading.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Limits of the scene.
    pub limits: Limits,
    /// Rules about the kinds of triangles, which go before the file; of several that match, the last counts.
    pub rules: Vec<Rule>,
    /// Whether the textures of glTF materials with `alphaMode` MASK are read, so that their triangles are
    /// masked. Otherwise these triangles are see-through as a whole.
    pub alpha_textures: bool,
    /// Whether triangles are met from their front alone, unless their material is double-sided.
    pub cull_back_faces: bool,
}

/// A loaded scene.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The scene.
    pub scene: Scene,
    /// Faults that did not stop the loading: a missing material library, a rule that matches nothing.
    pub warnings: Vec<String>,
}

/// Reads the scene in `path`, whose extension must agree with its content.
///
/// Relative URIs of buffers in a glTF file are relative to the directory of the file.
///
/// # Errors
/// [`SceneError::Io`] when a file cannot be read, [`SceneError::Bad`] when its contents cannot be used.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    load_with(path, &Options::default()).map(|l| l.scene)
}

/// [`load`] with options; returns warnings as well.
///
/// # Errors
/// As [`load`].
pub fn load_with(path: &Path, options: &Options) -> Result<Loaded, SceneError> {
    let name = path.display().to_string();
    let bytes = read_file(path, u64::MAX)?;
    // The empty parent of a bare file name is the current directory.
    let base = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    load_bytes_with(&name, &bytes, Some(base), options)
}

/// Reads a scene held in memory. `name` appears in errors and gives the extension; a name without a known
/// extension is judged by content alone. Without `base_dir`, buffers outside the file are refused.
///
/// # Errors
/// As [`load`].
pub fn load_bytes(name: &str, bytes: &[u8], base_dir: Option<&Path>) -> Result<Scene, SceneError> {
    load_bytes_with(name, bytes, base_dir, &Options::default()).map(|l| l.scene)
}

/// [`load_bytes`] with options; returns warnings as well.
///
/// # Errors
/// As [`load`], and [`SceneError::Bad`] when the scene is beyond the limits.
pub fn load_bytes_with(
    name: &str,
    bytes: &[u8],
    base_dir: Option<&Path>,
    options: &Options,
) -> Result<Loaded, SceneError> {
    let mut marks = Marks::new(name, &options.rules, options.alpha_textures)?;
    let limits = &options.limits;
    let scene = match sniff::kind_of(name, bytes)? {
        Kind::Obj => obj::parse(name, bytes, base_dir, limits, &mut marks),
        Kind::Ply => ply::parse(name, bytes, limits, &mut marks),
        Kind::Gltf => gltf::parse_json(name, bytes, base_dir, limits, &mut marks),
        Kind::Glb => gltf::parse_glb(name, bytes, base_dir, limits, &mut marks),
    }?;
    scene.check_reach(name)?;
    let sides = if options.cull_back_faces {
        marks.sides(scene.len())
    } else {
        Sides::both()
    };
    let (kinds, masks, warnings) = marks.finish();
    Ok(Loaded {
        scene: scene
            .with_masks(name, kinds, masks)?
            .with_sides(name, sides)?,
        warnings,
    })
}
