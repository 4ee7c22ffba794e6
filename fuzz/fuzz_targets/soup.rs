//! Arbitrary bytes as a viewpoint and triangles, which get cells and are looked at: `cargo +nightly fuzz run
//! soup` in `fuzz/`. A crash found becomes a test of `crates/tetra/tests/fuzzed.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_tetra::fuzzing::soup(bytes);
});
