//! A fuzz target that reads bytes as a `.tets` file with correct checksums, and queries it:
//! `cargo +nightly fuzz run tets` in `fuzz/`. A crash becomes a test in `crates/tetra/tests/fuzzed.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_tetra::fuzzing::tets(bytes);
});
