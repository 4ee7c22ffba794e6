//! Tests of a damaged journal in the real program.
//!
//! The coordinator does not start, `store verify` does not change a byte, and `store verify --repair`
//! continues after all numbers that were issued.

// The lint's exception for tests does not cover the helper functions of a test.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use sightline_tests::Sandbox;

/// Returns the contents of all files below a folder.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        if entry.path().is_dir() {
            found.extend(files(&entry.path()));
        } else {
            found.insert(entry.path(), std::fs::read(entry.path()).unwrap());
        }
    }
    found
}

#[test]
fn damaged_journal_is_reported_and_repaired() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    {
        let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
        for seed in 1..=3 {
            assert_eq!(
                coordinator.submit(&format!(
                    "town.glb --backend cpu --cells 2x2x1 --seed {seed}"
                )),
                seed
            );
        }
    }
    let journal = sandbox.path("data/state/journal");
    let mut bytes = std::fs::read(&journal).unwrap();
    // The last bit of the last acknowledged frame.
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&journal, &bytes).unwrap();
    let before = files(&sandbox.path("data"));
    let repair = "store verify --repair --data-dir data";
    let command = format!("`sightline {repair}`");
    let verified = sandbox.run("store verify --data-dir data").code(3);
    verified
        .says("state/journal is damaged at byte")
        .says(&command);
    assert_eq!(
        files(&sandbox.path("data")),
        before,
        "a check must not change a byte"
    );
    let refused = sandbox
        .run("coordinator --listen 127.0.0.1:0 --data-dir data")
        .code(3);
    refused.says("is damaged at byte").says(&command);
    assert_eq!(std::fs::read(&journal).unwrap(), bytes);
    let repaired = sandbox.ok(repair);
    assert!(repaired.contains("state/damaged/journal-1"), "{repaired}");
    assert_eq!(sandbox.read("data/state/damaged/journal-1"), bytes);
    sandbox.ok("store verify --data-dir data");
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    // The killed coordinator may have left a view without the damaged frame, and the repair then names its
    // job. No number is issued again.
    let is_named = repaired.contains("job 3 and the latest changes of other jobs are lost");
    let jobs = coordinator.json("jobs").as_array().unwrap().len();
    assert_eq!(jobs, if is_named { 2 } else { 3 }, "{repaired}");
    assert_eq!(
        coordinator.submit("town.glb --backend cpu --cells 2x2x1 --seed 4"),
        4
    );
}

#[test]
fn cut_journal_without_view_names_lost_jobs() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    {
        let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
        for seed in 1..=3 {
            coordinator.submit(&format!(
                "town.glb --backend cpu --cells 2x2x1 --seed {seed}"
            ));
        }
    }
    std::fs::remove_dir_all(sandbox.path("data/state/sled")).unwrap();
    let bytes = sandbox.read("data/state/journal");
    sandbox.write("data/state/journal", &bytes[..bytes.len() - 1]);
    sandbox
        .run("store verify --data-dir data")
        .code(3)
        .says("job 3 and the latest changes of other jobs are lost");
    sandbox.ok("store verify --repair --data-dir data");
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    assert_eq!(coordinator.json("jobs").as_array().unwrap().len(), 2);
    assert_eq!(
        coordinator.submit("town.glb --backend cpu --cells 2x2x1 --seed 3"),
        4,
        "number 3 was given out before"
    );
}
