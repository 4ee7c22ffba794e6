//! Runs the examples of this crate on a small bake.
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "../examples/verify.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod verify;

use std::path::Path;
use std::process::Command;

fn sightline(folder: &Path, arguments: &str) {
    let run = Command::new(env!("CARGO_BIN_EXE_sightline"))
        .args(arguments.split(' '))
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(run.status.success(), "{arguments}: {}", String::from_utf8_lossy(&run.stderr));
}

#[test]
fn the_example_verifies_a_bake() {
    let folder = tempfile::tempdir().unwrap();
    sightline(folder.path(), "generate rooms --triangles 400 -o s.glb");
    sightline(
        folder.path(),
        "bake s.glb --cells 2x1x1 --backend cpu --method exact --certificates -o s.pvs --data-dir data",
    );
    let report = verify::verify_files(&folder.path().join("s.glb"), &folder.path().join("s.pvs")).unwrap();
    assert_eq!(report.cells, 2);
    assert!(report.totals.witnesses.all > 0 && report.totals.hidden.sum() > 0, "{report:?}");
    assert_eq!(report.totals.witnesses.all, report.totals.witnesses.checked);
}
