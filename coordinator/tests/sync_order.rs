//! The order of system calls that make a journal frame and a blob durable, as recorded by `strace`.
//!
//! The unit tests use a simulated disk, so they cannot detect a missing sync of a real disk. The test runs
//! itself under `strace` as the writing process.

// The lint's exception for tests does not cover the helper functions of a test.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;
use std::process::Command;

use sightline_store::{Blobs, FileBlobs, SledStore, Store};

const FOLDER: &str = "SIGHTLINE_SYNC_ORDER_FOLDER";

/// Writes one epoch and one blob, each between two marks.
#[test]
fn writer_syncs_one_epoch_and_one_blob() {
    let Ok(folder) = std::env::var(FOLDER) else {
        println!("does nothing without {FOLDER}; acknowledged_data_is_synced_in_order sets it");
        return;
    };
    let folder = Path::new(&folder);
    let store = SledStore::open(&folder.join("state")).unwrap();
    let blobs = FileBlobs::open(&folder.join("blobs")).unwrap();
    let mark = |name: &str| std::fs::write(folder.join("mark"), name).unwrap();
    mark("journal begins");
    store.begin_epoch().unwrap();
    mark("journal ends");
    mark("blob begins");
    blobs.put(b"walls").unwrap();
    mark("blob ends");
    mark("stream begins");
    let mut writer = blobs.put_stream().unwrap();
    writer.append(b"floor").unwrap();
    writer.finish(None).unwrap();
    mark("stream ends");
}

/// Returns the calls between the two marks of a section.
fn section<'a>(calls: &[&'a str], name: &str) -> Vec<&'a str> {
    let at = |mark: String| {
        let found = calls
            .iter()
            .position(|call| call.contains("/mark>") && call.contains(&mark));
        found.unwrap_or_else(|| panic!("no mark '{mark}' in {calls:#?}"))
    };
    calls[at(format!("{name} begins")) + 1..at(format!("{name} ends"))].to_vec()
}

/// Checks that calls with these parts occur in this order.
fn assert_order(calls: &[&str], parts: &[[&str; 2]]) {
    let mut rest = calls.iter();
    for [call, path] in parts {
        let found = rest.any(|line| line.contains(&format!("{call}(")) && line.contains(path));
        assert!(
            found,
            "{call} of {path} is missing or too early in {calls:#?}"
        );
    }
}

fn hex(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

#[test]
fn acknowledged_data_is_synced_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let (data, log) = (folder.path().join("data"), folder.path().join("log"));
    std::fs::create_dir(&data).unwrap();
    let ran = Command::new("strace")
        .args([
            "-f",
            "-y",
            "-s",
            "200",
            "-e",
            "trace=write,fsync,fdatasync,rename",
            "-o",
        ])
        .arg(&log)
        .arg(std::env::current_exe().unwrap())
        .args([
            "writer_syncs_one_epoch_and_one_blob",
            "--exact",
            "--nocapture",
            "--test-threads=1",
        ])
        .env(FOLDER, &data)
        .output();
    let is_ci = std::env::var_os("CI").is_some_and(|ci| ci != "false");
    match ran {
        Err(e) if !is_ci => {
            println!("not run: strace cannot be started ({e}); install strace");
            return;
        }
        ran => {
            let ran = ran.unwrap();
            assert!(
                ran.status.success(),
                "{}",
                String::from_utf8_lossy(&ran.stderr)
            );
        }
    }
    let log = std::fs::read_to_string(&log).unwrap();
    // If another thread interrupts a call, a separate line records the call's end. Only the start counts.
    let calls: Vec<&str> = log
        .lines()
        .filter(|line| !line.contains("resumed>"))
        .collect();
    assert_order(
        &section(&calls, "journal"),
        &[
            ["write", "/state/journal>"],
            ["fdatasync", "/state/journal>"],
            ["write", "/state/journal.mark>"],
        ],
    );
    for (name, bytes) in [("blob", b"walls"), ("stream", b"floor")] {
        let hex = hex(bytes);
        let (inner, outer) = (
            format!("/blobs/{}/{}>", &hex[..2], &hex[2..4]),
            format!("/blobs/{}>", &hex[..2]),
        );
        assert_order(
            &section(&calls, name),
            &[
                ["write", "/blobs/tmp/"],
                ["fdatasync", "/blobs/tmp/"],
                ["rename", &hex],
                ["fsync", &inner],
                ["fsync", &outer],
                ["fsync", "/blobs>"],
            ],
        );
    }
    // The watermark becomes durable when no command waits, and at the latest at the end.
    assert_order(
        &calls,
        &[
            ["write", "/state/journal.mark>"],
            ["fdatasync", "/state/journal.mark>"],
        ],
    );
}
