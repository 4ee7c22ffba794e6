//! A fuzz target that reads bytes as a lights file and computes the form factors:
//! `cargo +nightly fuzz run lights` in `fuzz/`. A crash becomes a file in `crates/ambient/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_ambient::fuzzing::lights(bytes);
});
