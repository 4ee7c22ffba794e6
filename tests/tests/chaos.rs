//! The chaos harness (`scripts/chaos.sh`, docs/chaos.md) with the seeds that once found something and a dozen
//! more: real processes in network namespaces, killed, stopped, cut off and damaged, give the calm run's
//! bytes. The dozen has every kind of farm: one coordinator, two on PostgreSQL, blobs in a bucket, a liar.
//!
//! Needs root, what `scripts/setup.sh --for test` installs, and the programs of `cargo build --workspace`.
//! Where the harness says that it cannot run, the test says so in one line and passes; where `CI` is set it
//! fails instead.

#![allow(clippy::panic, clippy::print_stderr, reason = "helpers of tests")]

use std::path::Path;
use std::process::Command;

use sightline_tests::{in_ci, program};

/// What the harness ends with on a machine that lacks what it needs.
const CANNOT_RUN: i32 = 2;
/// Fresh schedules, with the seeds from 1 on.
const FRESH: &str = "12";

/// Runs the harness; panics with what it says unless it ends well, or cannot run outside of CI.
fn harness(arguments: &[&str]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/chaos.sh");
    let ran = Command::new(script)
        .args(arguments)
        .args(["--shrink", "0", "--keep"])
        .arg(Path::new(env!("CARGO_TARGET_TMPDIR")).join("chaos-failed"))
        .env("SIGHTLINE_BIN", program())
        .output()
        .unwrap_or_else(|e| panic!("the harness does not start: {e}"));
    let [out, err] = [&ran.stdout, &ran.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    match ran.status.code() {
        Some(0) => eprintln!("{out}"),
        Some(CANNOT_RUN) if !in_ci() => eprintln!("chaos test did not run: {}", err.trim()),
        _ => panic!("the harness ended with {}:\n{out}{err}", ran.status),
    }
}

#[test]
fn chaos_changes_no_byte_and_loses_nothing_acknowledged() {
    harness(&["--regressions", "--schedules", FRESH, "--jobs", "4"]);
}

#[test]
fn chaos_finds_what_is_wrong() {
    harness(&["--self-check"]);
}
