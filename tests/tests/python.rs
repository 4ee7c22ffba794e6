//! Runs the tests of the Python package with the package and the program of this build.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::process::Command;

use sightline_tests::{Sandbox, program, python, python_folder};

/// Runs a file of `python/tests`.
fn pytest(file: &str) {
    let Some(python) = python() else { return };
    let sandbox = Sandbox::new();
    let out = Command::new(python)
        .args([
            "-m",
            "pytest",
            "--quiet",
            "--no-header",
            "-p",
            "no:cacheprovider",
        ])
        .arg(python_folder().join("tests").join(file))
        .current_dir(sandbox.path("."))
        .env("SIGHTLINE_BIN", std::path::absolute(program()).unwrap())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&out.stdout);
    assert!(
        out.status.success(),
        "{file}: {said}{}",
        String::from_utf8_lossy(&out.stderr)
    );
    assert!(
        said.contains(" passed") && !said.contains("skipped"),
        "{file}: {said}"
    );
}

#[test]
fn meshes_are_accepted_or_rejected_with_sentence() {
    pytest("test_mesh.py");
}

#[test]
fn bake_measure_and_verify_match_commands() {
    pytest("test_work.py");
}

#[test]
fn result_matches_commands() {
    pytest("test_pvs.py");
}

#[test]
fn client_submits_follows_and_fetches() {
    pytest("test_client.py");
}

#[test]
fn package_is_typed() {
    pytest("test_types.py");
}

#[test]
fn notebook_ends_in_plot() {
    pytest("test_notebook.py");
}

#[test]
fn example_of_readme_runs() {
    pytest("test_readme.py");
}
