//! A fuzz target that reads bytes as a viewpoint and triangles, builds cells, and queries the visible
//! triangles: `cargo +nightly fuzz run soup` in `fuzz/`. A crash becomes a test in
//! `crates/tetra/tests/fuzzed.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_tetra::fuzzing::soup(bytes);
});
