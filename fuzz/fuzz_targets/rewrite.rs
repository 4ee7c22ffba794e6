//! A fuzz target that writes values into bytes as a glTF or GLB file: `cargo +nightly fuzz run rewrite` in
//! `fuzz/`. A crash becomes a file in `crates/texels/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_texels::fuzzing::rewrite(bytes);
});
