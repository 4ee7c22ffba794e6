//! A fuzz target that reads bytes as calls of the gRPC interface, to a coordinator in memory:
//! `cargo +nightly fuzz run calls` in `fuzz/`. A crash becomes a test in
//! `coordinator/src/services/fuzzing.rs`.
#![no_main]

static INTERFACE: std::sync::LazyLock<sightline_coordinator::fuzzing::Interface> =
    std::sync::LazyLock::new(sightline_coordinator::fuzzing::Interface::new);

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sightline_coordinator::fuzzing::calls(&INTERFACE, bytes);
});
