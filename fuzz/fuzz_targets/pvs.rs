//! A fuzz target that reads bytes as a `.pvs` file with correct checksums: `cargo +nightly fuzz run pvs` in
//! `fuzz/`. A crash becomes a file in `crates/pvs/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_pvs::fuzzing::pvs(bytes);
});
