//! A fuzz target that decodes bytes as the output of a tile and encodes it again:
//! `cargo +nightly fuzz run tile` in `fuzz/`. A crash becomes a test in
//! `crates/model/src/output/codec/tests.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_model::codec::fuzzing::tile(bytes);
});
