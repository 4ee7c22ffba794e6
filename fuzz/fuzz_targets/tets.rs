//! Arbitrary bytes as a `.tets` file with right checksums, which is looked at: `cargo +nightly fuzz run
//! tets` in `fuzz/`. A crash found becomes a test of `crates/tetra/tests/fuzzed.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_tetra::fuzzing::tets(bytes);
});
