//! The bodies of the fuzz targets of the scene parsers, which `tests/mutations.rs` calls too: one function a
//! format.
//!
//! Each must return for arbitrary bytes, and returns whether they were accepted. An accepted scene is checked
//! further. Small limits keep the memory of a run in proportion to its input.

use crate::load::{Limits, load_bytes_limited};
use crate::{Scene, write_mesh_ply};

/// Limits of one run.
pub const LIMITS: Limits = Limits { triangles: 1 << 14, objects: 1 << 10 };

/// Bytes as an OBJ file.
pub fn obj(bytes: &[u8]) -> bool {
    file("fuzz.obj", bytes)
}

/// Bytes as a PLY file.
pub fn ply(bytes: &[u8]) -> bool {
    file("fuzz.ply", bytes)
}

/// Bytes as a glTF or GLB file; the first bytes decide which.
pub fn gltf(bytes: &[u8]) -> bool {
    file("fuzz", bytes)
}

/// Bytes as a canonical scene.
pub fn scene_blob(bytes: &[u8]) -> bool {
    let Ok(scene) = Scene::from_blob("fuzz", bytes) else { return false };
    // The encoding is canonical: one scene has one string of bytes.
    assert!(scene.to_blob() == bytes, "a canonical scene must be written as it was read");
    true
}

/// Loads `bytes`, and passes an accepted scene through both encodings and back.
fn file(name: &str, bytes: &[u8]) -> bool {
    let Ok(scene) = load_bytes_limited(name, bytes, None, &LIMITS) else { return false };
    let blob = scene.to_blob();
    let again = Scene::from_blob("fuzz", &blob).map(|s| s.to_blob());
    assert!(again.is_ok_and(|b| b == blob), "a loaded scene must survive its canonical bytes");
    let mut ply = Vec::new();
    let written = write_mesh_ply(&scene, &mut ply);
    assert!(written.is_ok(), "memory does not refuse writes");
    let again = load_bytes_limited("fuzz.ply", &ply, None, &LIMITS);
    let same = again.is_ok_and(|s| bits(&s) == bits(&scene));
    assert!(same, "a written mesh must load with the same vertices");
    true
}

/// Coordinates by their bits, so that -0 differs from 0.
fn bits(scene: &Scene) -> Vec<u32> {
    scene.triangles().iter().flat_map(|t| t.v).flat_map(|v| v.to_array()).map(f32::to_bits).collect()
}
