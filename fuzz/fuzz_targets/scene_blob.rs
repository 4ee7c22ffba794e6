//! A fuzz target that reads bytes as a canonical scene: `cargo +nightly fuzz run scene_blob` in `fuzz/`. A
//! crash becomes a file in `crates/scene/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_scene::fuzzing::scene_blob(bytes);
});
