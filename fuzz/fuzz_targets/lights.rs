//! Arbitrary bytes as the lines of a lights file, whose form factors are computed: `cargo +nightly fuzz run
//! lights` in `fuzz/`. A crash found becomes a file in `crates/ambient/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_ambient::fuzzing::lights(bytes);
});
