//! Tests of faults that commands report before they start to work, and of stdout that cannot be written.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::fs::File;
use std::process::{Command, Stdio};

use sightline_tests::{Sandbox, program};

const MAZE: &str = "generate maze --grid 3x3 -o maze.glb";
const BAKE: &str =
    "bake maze.glb --cells 2x2x2 --target-error 0.1 --backend cpu --data-dir data -o maze.pvs";

#[test]
fn impossible_worker_arguments_are_rejected() {
    let sandbox = Sandbox::new();
    sandbox.run("worker --threads 0").code(2).says("1 to 1024");
    sandbox
        .run("worker --adapter no-such-adapter")
        .code(2)
        .says("--adapter no-such-adapter");
}

#[test]
fn mesh_is_written_only_as_ply() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    sandbox
        .run("mesh maze.glb -o maze.stl")
        .code(2)
        .says(".ply");
    assert!(!sandbox.path("maze.stl").exists());
}

#[test]
fn missing_inputs_and_unwritable_folders_are_reported_before_scene() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    sandbox.ok(BAKE);
    // The scene is missing as well. The message names the file that is read first.
    sandbox
        .run("sightlines gone.glb --queries gone.jsonl")
        .code(3)
        .says("gone.jsonl")
        .says("--queries");
    sandbox
        .run("measure gone.glb maze.pvs --path gone.txt")
        .code(3)
        .says("gone.txt")
        .says("--path");
    sandbox
        .run("measure gone.glb maze.pvs --images maze.glb/x")
        .code(2)
        .says("--images");
    sandbox
        .run("generate maze -o none/maze.glb")
        .code(2)
        .says("none");
    sandbox
        .run("mesh gone.glb -o none/maze.ply")
        .code(2)
        .says("none");
    sandbox
        .run("bake gone.glb -o none/maze.pvs")
        .code(2)
        .says("none");
    sandbox.run("fetch 1 -o none/maze.pvs").code(2).says("none");
}

#[cfg(target_os = "linux")]
#[test]
fn full_stdout_is_error_and_closed_stdout_is_not() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    sandbox.ok(BAKE);
    for line in ["dump maze.pvs", "info maze.pvs", "query maze.pvs 1 1 1"] {
        let mut command = Command::new(program());
        command
            .args(line.split(' '))
            .current_dir(sandbox.path(""))
            .stderr(Stdio::piped());
        let full = command
            .stdout(File::options().write(true).open("/dev/full").unwrap())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&full.stderr).into_owned();
        assert_eq!(full.status.code(), Some(1), "{line}: {said}");
        assert!(said.contains("stdout cannot be written"), "{line}: {said}");
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let closed = command.stdout(writer).output().unwrap();
        assert!(
            closed.status.success() && closed.stderr.is_empty(),
            "{line}: {closed:?}"
        );
    }
}
