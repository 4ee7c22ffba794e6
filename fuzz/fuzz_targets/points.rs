//! A fuzz target that reads bytes as a points file and computes the openness:
//! `cargo +nightly fuzz run points` in `fuzz/`. A crash becomes a file in `crates/ambient/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_ambient::fuzzing::points(bytes);
});
