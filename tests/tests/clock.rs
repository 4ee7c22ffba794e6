//! Tests of a coordinator whose wall clock steps between two runs.

#![cfg(target_os = "linux")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::path::PathBuf;

use sightline_tests::{Sandbox, in_ci, wait_for};

/// Returns the library of Debian's package `faketime`. If the library is absent, prints a line with the
/// reason and returns `None`, which is a failure on CI.
fn faketime() -> Option<PathBuf> {
    let folders = std::fs::read_dir("/usr/lib")
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let found = folders
        .map(|f| f.join("faketime/libfaketimeMT.so.1"))
        .find(|library| library.is_file());
    if found.is_none() {
        assert!(
            !in_ci(),
            "faketime has to be installed in continuous integration: scripts/setup.sh --for test"
        );
        eprintln!("not run: results after a clock step (faketime is not installed)");
    }
    found
}

/// Runs a job, starts the coordinator again after a step of the wall clock, and checks that the result
/// exists.
fn result_survives(step: &str, event: &str) {
    let Some(library) = faketime() else { return };
    let mut sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 2x2 -o maze.glb");
    // Only the run of retention ten seconds after the start logs a message.
    sandbox.set("SIGHTLINE_LOG", "info,sightline_coordinator=debug");
    let arguments = "--listen 127.0.0.1:0 --keep 24h";
    let job = {
        let coordinator = sandbox.serve("data", arguments);
        let _worker = coordinator.worker();
        let job = coordinator.submit("maze.glb --cells 1x1x1 --target-error 0.1");
        coordinator.finish(job);
        coordinator.process.signal("TERM");
        job
    };
    sandbox.set("LD_PRELOAD", library);
    sandbox.set("FAKETIME", step);
    // Files keep their true times, and the monotonic clock continues.
    sandbox.set("NO_FAKE_STAT", "1");
    sandbox.set("DONT_FAKE_MONOTONIC", "1");
    sandbox.set("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    let coordinator = sandbox.serve("data", arguments);
    let passed = || {
        coordinator
            .process
            .err()
            .contains("retention has finished")
            .then_some(())
    };
    wait_for("the pass of retention", passed);
    assert!(
        coordinator.process.err().contains(event),
        "{}",
        coordinator.process.err()
    );
    assert!(!coordinator.finish(job).is_empty());
}

#[test]
fn result_survives_clock_ten_years_ahead() {
    result_survives("+3650d", "or the wall clock was set forward");
}

#[test]
fn result_survives_clock_ten_years_behind() {
    result_survives("-3650d", "behind its last time in the store");
}
