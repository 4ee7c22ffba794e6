//! Arbitrary bytes as triangles: do two of them see each other? The checker judges every answer: `cargo
//! +nightly fuzz run query` in `fuzz/`. A crash found becomes a file in `crates/exact/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_exact::fuzzing::query(bytes);
});
