//! Runs the examples of this crate on a small bake.
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "../examples/verify.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod verify;

#[path = "../examples/submit.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod submit;

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

fn sightline(folder: &Path, arguments: &str) {
    let run = Command::new(env!("CARGO_BIN_EXE_sightline"))
        .args(arguments.split(' '))
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(
        run.status.success(),
        "{arguments}: {}",
        String::from_utf8_lossy(&run.stderr)
    );
}

#[test]
fn the_example_verifies_a_bake() {
    let folder = tempfile::tempdir().unwrap();
    sightline(folder.path(), "generate rooms --triangles 400 -o s.glb");
    sightline(
        folder.path(),
        "bake s.glb --cells 2x1x1 --backend cpu --method exact --certificates -o s.pvs --data-dir data",
    );
    let report =
        verify::verify_files(&folder.path().join("s.glb"), &folder.path().join("s.pvs")).unwrap();
    assert_eq!(report.cells, 2);
    assert!(
        report.totals.witnesses.all > 0 && report.totals.hidden.sum() > 0,
        "{report:?}"
    );
    assert_eq!(report.totals.witnesses.all, report.totals.witnesses.checked);
}

/// A child that ends with the test.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(folder: &Path, arguments: &str) -> Ends {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sightline"));
    command
        .args(arguments.split(' '))
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    Ends(command.spawn().unwrap())
}

#[test]
fn the_example_submits_a_scene_and_fetches_the_result() {
    let folder = tempfile::tempdir().unwrap();
    sightline(folder.path(), "generate rooms --triangles 400 -o s.glb");
    let mut coordinator = start(
        folder.path(),
        "coordinator --data-dir data --listen 127.0.0.1:0",
    );
    // The first line of stdout is the address.
    let mut line = String::new();
    BufReader::new(coordinator.0.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let address = line.split_whitespace().last().unwrap().to_owned();
    let url = if address.starts_with("http") {
        address
    } else {
        format!("http://{address}")
    };
    let _worker = start(
        folder.path(),
        &format!("worker --coordinator {url} --backend cpu"),
    );
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let result = runtime
        .block_on(submit::bake_at(&url, &folder.path().join("s.glb")))
        .unwrap();
    let pvs = sightline_pvs::Pvs::from_bytes(result).unwrap();
    assert_eq!(pvs.cells(), 32);
}
