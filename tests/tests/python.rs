//! The Python package: its own tests, run with the package and the program of this build.

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
fn meshes_are_taken_or_refused_in_a_sentence() {
    pytest("test_mesh.py");
}

#[test]
fn bake_measure_and_verify_do_what_the_commands_do() {
    pytest("test_work.py");
}

#[test]
fn a_result_says_what_the_commands_say_of_it() {
    pytest("test_pvs.py");
}

#[test]
fn a_client_submits_follows_and_fetches() {
    pytest("test_client.py");
}

#[test]
fn the_package_is_typed() {
    pytest("test_types.py");
}

#[test]
fn the_notebook_ends_in_a_plot() {
    pytest("test_notebook.py");
}

#[test]
fn the_example_of_the_readme_runs() {
    pytest("test_readme.py");
}
