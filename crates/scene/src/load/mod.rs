//! Readers of scene files: OBJ, PLY, glTF and GLB files become one [`Scene`] whose ids follow the order of
//! the file.
//!
//! The content of a file determines its format, which must agree with the extension. Loaders do not repair
//! files: a file that violates its format is rejected, and the error names the element at fault. Materials,
//! animations and skins determine the kinds of triangles ([`mod@crate::kinds`]), unless a rule of the user
//! determines the kind. Normals, texture coordinates (except those for masks) and morph targets are ignored.

mod format;
mod gltf;
mod limits;
mod marks;
mod memory;
mod mtl;
mod names;
mod obj;
mod ply;

use std::path::Path;

use self::format::{SceneFile, SceneFormat, find_format};
pub use self::gltf::{EXTENSIONS, Extension, Support, uri_bytes};
use self::marks::Marks;
use crate::{KindRule, Scene, SceneError, Sides};
pub use limits::LoadLimits;
use limits::read_file;
pub use memory::from_memory;

/// The formats of scene files, in the order in which their signatures are compared. To add a format, add a
/// module and a row.
static FORMATS: [SceneFormat; 4] = [
    SceneFormat {
        name: "GLB",
        extension: ".glb",
        content: "a binary glTF (GLB)",
        has_signature: gltf::is_glb,
        accepts_text: false,
        read: |file, marks| {
            gltf::parse_glb(file.name, file.bytes, file.base_dir, file.limits, marks)
        },
    },
    SceneFormat {
        name: "glTF",
        extension: ".gltf",
        content: "JSON (glTF)",
        has_signature: gltf::is_json,
        accepts_text: false,
        read: |file, marks| {
            gltf::parse_json(file.name, file.bytes, file.base_dir, file.limits, marks)
        },
    },
    SceneFormat {
        name: "PLY",
        extension: ".ply",
        content: "a PLY file",
        has_signature: ply::has_signature,
        accepts_text: false,
        read: |file, marks| ply::parse(file.name, file.bytes, file.limits, marks),
    },
    SceneFormat {
        name: "OBJ",
        extension: ".obj",
        content: "Wavefront OBJ text",
        has_signature: obj::has_signature,
        accepts_text: true,
        read: |file, marks| obj::parse(file.name, file.bytes, file.base_dir, file.limits, marks),
    },
];

/// The options of loading.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// The maximum size of the scene.
    pub limits: LoadLimits,
    /// The user's rules for the kinds of triangles, which have precedence over the file. If several rules
    /// match, the last of these rules applies.
    pub rules: Vec<KindRule>,
    /// True if the textures of glTF materials with `alphaMode` MASK are read, so that their triangles are
    /// masked. Otherwise these triangles are completely see-through.
    pub alpha_textures: bool,
    /// True if lines meet triangles only from their front, unless their material is double-sided.
    pub cull_back_faces: bool,
}

/// A loaded scene with the warnings of its loader.
#[derive(Clone, Debug)]
pub struct LoadedScene {
    /// The scene of the file.
    pub scene: Scene,
    /// The descriptions of faults that did not stop the loading, such as a missing material library or a rule
    /// without a match.
    pub warnings: Vec<String>,
}

/// Reads the scene in `path`, whose extension must agree with its content.
///
/// Relative URIs of buffers in a glTF file are relative to the directory of the file.
///
/// # Errors
/// [`SceneError::Io`] if a file cannot be read, or [`SceneError::Bad`] if its contents cannot be used.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    load_with(path, &LoadOptions::default()).map(|l| l.scene)
}

/// Reads a scene as [`load`] does, with options. Also returns warnings.
///
/// # Errors
/// The errors of [`load`].
pub fn load_with(path: &Path, options: &LoadOptions) -> Result<LoadedScene, SceneError> {
    let name = path.display().to_string();
    let bytes = read_file(path, u64::MAX)?;
    // The empty parent of a bare file name means the current directory.
    let base = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    load_bytes_with(&name, &bytes, Some(base), options)
}

/// Reads a scene from memory.
///
/// `name` is the file name in errors, and its extension must agree with the content. Without a known
/// extension, only the content determines the format. Without `base_dir`, buffers outside the file are
/// rejected.
///
/// # Errors
/// The errors of [`load`].
pub fn load_bytes(name: &str, bytes: &[u8], base_dir: Option<&Path>) -> Result<Scene, SceneError> {
    load_bytes_with(name, bytes, base_dir, &LoadOptions::default()).map(|l| l.scene)
}

/// Reads a scene as [`load_bytes`] does, with options. Also returns warnings.
///
/// # Errors
/// The errors of [`load`], and [`SceneError::Bad`] if the scene exceeds the limits.
pub fn load_bytes_with(
    name: &str,
    bytes: &[u8],
    base_dir: Option<&Path>,
    options: &LoadOptions,
) -> Result<LoadedScene, SceneError> {
    let mut marks = Marks::new(name, &options.rules, options.alpha_textures)?;
    let file = SceneFile {
        name,
        bytes,
        base_dir,
        limits: &options.limits,
    };
    let format = find_format(&FORMATS, &file)?;
    let scene = (format.read)(&file, &mut marks)?;
    scene.check_reach(name)?;
    let sides = if options.cull_back_faces {
        marks.sides(scene.len())
    } else {
        Sides::both()
    };
    let (kinds, masks, warnings) = marks.finish();
    Ok(LoadedScene {
        scene: scene
            .with_masks(name, kinds, masks)?
            .with_sides(name, sides)?,
        warnings,
    })
}
