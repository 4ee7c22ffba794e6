//! A fuzz target that reads bytes as triangles, and queries the visibility of one triangle from another. The
//! checker verifies every answer. Run: `cargo +nightly fuzz run query` in `fuzz/`. A crash becomes a file in
//! `crates/exact/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_exact::fuzzing::query(bytes);
});
