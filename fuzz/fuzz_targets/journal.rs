//! A fuzz target that opens and continues bytes as the files of a journal: `cargo +nightly fuzz run journal`
//! in `fuzz/`. A crash becomes a test in `coordinator/store/src/journal_tests.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let folder = std::env::temp_dir().join(format!("sightline-fuzz-{}", std::process::id()));
    let _ = std::fs::create_dir_all(&folder);
    sightline_coordinator::fuzzing::journal(&folder, bytes);
});
