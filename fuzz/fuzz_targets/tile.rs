//! Arbitrary bytes as the output of a tile, decoded and encoded again: `cargo +nightly fuzz run tile` in
//! `fuzz/`. A crash found becomes a test in `crates/model/src/output/codec/tests.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_model::codec::fuzzing::tile(bytes);
});
