//! A fuzz target that reads bytes as an OBJ file: `cargo +nightly fuzz run obj` in `fuzz/`. A crash becomes a
//! file in `crates/scene/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_scene::fuzzing::obj(bytes);
});
