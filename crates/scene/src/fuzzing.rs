//! The functions of the fuzz targets: one for each format, for any bytes.
//!
//! Each returns whether the bytes were accepted, and must return for all bytes; an accepted scene is checked
//! further. Small limits keep the memory of a run in proportion to its input, so that a memory limit of the
//! fuzzer is useful.

use crate::load::{Limits, Options, load_bytes_with};
use crate::{Scene, write_mesh_ply};

/// Limits of one run.
pub const LIMITS: Limits = Limits {
    triangles: 1 << 14,
    objects: 1 << 10,
};

/// Bytes as an OBJ file.
pub fn obj(bytes: &[u8]) -> bool {
    file("fuzz.obj", bytes)
}

/// Bytes as a PLY file.
pub fn ply(bytes: &[u8]) -> bool {
    file("fuzz.ply", bytes)
}

/// Bytes as a glTF or GLB file, depending on the first bytes.
pub fn gltf(bytes: &[u8]) -> bool {
    file("fuzz", bytes)
}

/// Bytes as a canonical scene.
pub fn scene_blob(bytes: &[u8]) -> bool {
    let Ok(scene) = Scene::from_blob("fuzz", bytes) else {
        return false;
    };
    // The encoding is canonical: a scene has one encoding.
    assert!(
        scene.to_blob() == bytes,
        "a canonical scene must be written as it was read"
    );
    true
}

/// Loads `bytes`; encodes and decodes an accepted scene in both encodings.
fn file(name: &str, bytes: &[u8]) -> bool {
    let options = Options {
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
        "a loaded scene must survive its canonical bytes"
    );
    let mut ply = Vec::new();
    let written = write_mesh_ply(&scene, &mut ply);
    assert!(written.is_ok(), "memory does not refuse writes");
    let again = load_bytes_with("fuzz.ply", &ply, None, &options).map(|l| l.scene);
    let same = again.is_ok_and(|s| bits(&s) == bits(&scene));
    assert!(same, "a written mesh must load with the same vertices");
    true
}

/// Coordinates by their bits, so that -0 differs from 0.
fn bits(scene: &Scene) -> Vec<u32> {
    scene
        .triangles()
        .iter()
        .flat_map(|t| t.v)
        .flat_map(|v| v.to_array())
        .map(f32::to_bits)
        .collect()
}
