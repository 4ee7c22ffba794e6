//! Any bytes as triangles, and whether two of them see each other, with the checker as judge: `cargo +nightly fuzz run query` in
//! `fuzz/`. A crash found becomes a numbered case in `crates/exact/tests/fuzzed.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_exact::fuzzing::query(bytes);
});
