//! A fuzz target that reads bytes as a PLY file: `cargo +nightly fuzz run ply` in `fuzz/`. A crash becomes a
//! file in `crates/scene/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_scene::fuzzing::ply(bytes);
});
