//! The functions of the fuzz targets: one function for each format.
//!
//! Each function accepts any bytes and returns true if the bytes are a valid scene. The function encodes and
//! decodes this scene again, and panics only if the program has a defect. Small limits keep the memory of a
//! run proportional to its input, so that a memory limit of the fuzzer is useful.

use crate::load::{LoadLimits, LoadOptions, load_bytes_with};
use crate::{Scene, write_mesh_ply};

/// The limits of one run.
pub const LIMITS: LoadLimits = LoadLimits {
    triangles: 1 << 14,
    objects: 1 << 10,
};

/// Loads bytes as an OBJ file.
pub fn obj(bytes: &[u8]) -> bool {
    file("fuzz.obj", bytes)
}

/// Loads bytes as a PLY file.
pub fn ply(bytes: &[u8]) -> bool {
    file("fuzz.ply", bytes)
}

/// Loads bytes as a glTF or GLB file, depending on the first bytes.
pub fn gltf(bytes: &[u8]) -> bool {
    file("fuzz", bytes)
}

/// Decodes bytes as a canonical scene.
pub fn scene_blob(bytes: &[u8]) -> bool {
    let Ok(scene) = Scene::from_blob("fuzz", bytes) else {
        return false;
    };
    // The encoding is canonical: each scene has exactly one encoding.
    assert!(
        scene.to_blob() == bytes,
        "a canonical scene must be written as it was read"
    );
    true
}

/// Loads `bytes`, and encodes and decodes a valid scene as canonical bytes and as PLY.
fn file(name: &str, bytes: &[u8]) -> bool {
    let options = LoadOptions {
        limits: LIMITS,
        rules: Vec::new(),
        alpha_textures: true,
        cull_back_faces: true,
    };
    let Ok(scene) = load_bytes_with(name, bytes, None, &options).map(|l| l.scene) else {
        return false;
    };
    let blob = scene.to_blob();
    let again = Scene::from_blob("fuzz", &blob).map(|s| s.to_blob());
    assert!(
        again.is_ok_and(|b| b == blob),
        "the canonical bytes of a loaded scene must decode to the same scene"
    );
    let mut ply = Vec::new();
    let written = write_mesh_ply(&scene, &mut ply);
    assert!(written.is_ok(), "a write to memory must not fail");
    let again = load_bytes_with("fuzz.ply", &ply, None, &options).map(|l| l.scene);
    let same = again.is_ok_and(|s| bits(&s) == bits(&scene));
    assert!(same, "a written mesh must load with the same vertices");
    true
}

/// Returns the bits of all coordinates, for a comparison in which −0 differs from 0.
fn bits(scene: &Scene) -> Vec<u32> {
    scene
        .triangles()
        .iter()
        .flat_map(|t| t.v)
        .flat_map(|v| v.to_array())
        .map(f32::to_bits)
        .collect()
}
