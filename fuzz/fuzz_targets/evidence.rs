//! Any bytes as the witnesses and certificates of a cell, read and checked: `cargo +nightly fuzz run evidence` in `fuzz/`. A
//! crash found becomes a numbered case in `crates/exact/tests/cells.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_exact::fuzzing::evidence(bytes);
});
