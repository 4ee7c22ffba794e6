//! A fuzz target that reads bytes as a glTF or GLB file: `cargo +nightly fuzz run gltf` in `fuzz/`. A crash
//! becomes a file in `crates/scene/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_scene::fuzzing::gltf(bytes);
});
