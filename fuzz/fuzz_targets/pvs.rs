//! Arbitrary bytes as a `.pvs` file with right checksums, which is read: `cargo +nightly fuzz run pvs` in
//! `fuzz/`. A crash found becomes a file in `crates/pvs/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_pvs::fuzzing::pvs(bytes);
});
