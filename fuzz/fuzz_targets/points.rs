//! Arbitrary bytes as the lines of a points file, whose openness is computed: `cargo +nightly fuzz run
//! points` in `fuzz/`. A crash found becomes a file in `crates/ambient/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_ambient::fuzzing::points(bytes);
});
