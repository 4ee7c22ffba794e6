//! Runs the chaos harness (`scripts/chaos.sh`, docs/chaos.md) with the seeds that once found a fault, and
//! with a dozen more seeds.
//!
//! Real processes in network namespaces are killed, stopped, cut off and damaged, and have to give the bytes
//! of the calm run. The dozen covers every kind of farm: one coordinator, two on PostgreSQL, blobs in a
//! bucket, and a faulty worker.
//!
//! The test needs root, the packages of `scripts/setup.sh --for test`, and the programs of
//! `cargo build --workspace`. If the harness reports that it cannot run, the test prints this in one line and
//! passes. If `CI` is set, the test fails instead.

#![allow(clippy::panic, clippy::print_stderr, reason = "helpers of tests")]

use std::path::Path;
use std::process::Command;

use sightline_tests::{in_ci, program};

/// The exit code of the harness on a machine that lacks a requirement.
const CANNOT_RUN: i32 = 2;
/// The number of new schedules, with the seeds from 1 on.
const FRESH: &str = "12";

/// Runs the harness. Panics with its output if it fails, or on CI if it cannot run.
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
fn chaos_keeps_bytes_and_acknowledged_changes() {
    harness(&["--regressions", "--schedules", FRESH, "--jobs", "4"]);
}

#[test]
fn chaos_detects_injected_fault() {
    harness(&["--self-check"]);
}
