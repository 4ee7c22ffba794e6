//! A fuzz target that decodes and checks bytes as the certificate of a cell:
//! `cargo +nightly fuzz run certificate` in `fuzz/`. A crash becomes a file in
//! `crates/certificate/tests/crashes/`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = sightline_certificate::fuzzing::certificate(bytes);
});
