//! Arbitrary bytes as the certificate of a cell, decoded and checked: `cargo +nightly fuzz run certificate`
//! in `fuzz/`. A crash found becomes a file in `crates/certificate/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_certificate::fuzzing::certificate(bytes);
});
