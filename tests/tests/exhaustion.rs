//! Tests of commands that have too little memory, too few threads or too few descriptors. They end with exit
//! code 1 and a sentence, regardless of their work.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use sightline_pvs::{Builder, CellTree, Header, Items, Node, Object};
use sightline_tests::{Run, Sandbox};

/// The number of triangles that a small file claims.
const TRIANGLES: u32 = 5_000_000;

/// Writes a result of a few hundred bytes with one cell that sees all of its many triangles.
fn small_result(sandbox: &Sandbox) {
    let tree = CellTree::new([[0.0; 3], [1.0; 3]], vec![Node::Leaf]).unwrap();
    let object = Object {
        name: "all".into(),
        first: 0,
        count: TRIANGLES,
        source: None,
    };
    let (method, info_json) = ("aggressive".into(), "{}".into());
    let header = Header {
        triangles: TRIANGLES,
        method,
        tree,
        objects: vec![object],
        info_json,
    };
    let mut builder = Builder::new(header).unwrap();
    builder
        .set_items(&Items::Objects { never: Vec::new() })
        .unwrap();
    builder.push_cell(&[0], &[], 0).unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    assert!(file.len() < 500, "{} bytes", file.len());
    sandbox.write("small.pvs", file);
}

/// Returns true if a command succeeded. Otherwise it must have ended with code 1, a sentence, and one of the
/// texts on stderr.
#[track_caller]
fn ends_well(run: Run, texts: &[&str]) -> bool {
    if run.succeeded() {
        return true;
    }
    let run = run.code(1);
    assert!(
        run.err.lines().any(|line| line.starts_with("error: ")),
        "no sentence:\n{}",
        run.err
    );
    assert!(
        texts.iter().any(|text| run.err.contains(text)),
        "none of {texts:?}:\n{}",
        run.err
    );
    false
}

/// Returns a folder with a scene and its bake.
fn baked() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 3x3 -o maze.glb");
    sandbox.ok(&format!("{BAKE} --data-dir first -o maze.pvs"));
    sandbox
}

const BAKE: &str = "bake maze.glb --cells 2x1x1 --target-error 0.1 --backend cpu";

#[test]
fn small_result_needs_little_memory() {
    let sandbox = Sandbox::new();
    small_result(&sandbox);
    // 160 MiB for stacks and heap: a JSON document in memory would need 32 bytes for each id.
    let limited = |line: &str| sandbox.run_limited("ulimit -d 163840", line).code(0).out;
    let answer = limited("query small.pvs 0.5 0.5 0.5 --json");
    let end = format!(
        ",{}],\"undecided\":[],\"set_aside\":false}}\n",
        TRIANGLES - 1
    );
    assert!(answer.ends_with(&end), "{}", &answer[answer.len() - 100..]);
    assert!(
        limited("dump small.pvs").ends_with(&format!(",{}],\"undecided\":[]}}\n", TRIANGLES - 1))
    );
    limited("info small.pvs --json");
    limited("diff small.pvs small.pvs --json");
    limited("export small.pvs --format manifest -o small.json");
}

#[test]
fn missing_descriptors_end_with_sentence() {
    let sandbox = baked();
    let texts = [
        "Too many open files",
        "too many open files",
        "open files, but a server needs",
    ];
    let generate = "generate maze --grid 3x3 -o again.glb";
    // The loader opens one file at a time, in addition to stdin, stdout and stderr.
    assert!(!ends_well(
        sandbox.run_limited("ulimit -n 4", generate),
        &texts
    ));
    assert!(!ends_well(
        sandbox.run_limited("ulimit -n 6", "jobs"),
        &texts
    ));
    for few in 4..60 {
        let bake = format!("{BAKE} --data-dir with-{few} -o again.pvs");
        if ends_well(
            sandbox.run_limited(&format!("ulimit -n {few}"), &bake),
            &texts,
        ) {
            assert!(few > 10, "a bake needs more descriptors than {few}");
            return;
        }
    }
    panic!("a bake needs 60 descriptors");
}

#[test]
fn missing_memory_and_threads_end_with_sentence() {
    let mut sandbox = baked();
    // The coordinates of three million triangles have 108 MB.
    let generate = "generate forest --triangles 3000000 -o forest.glb";
    assert!(!ends_well(
        sandbox.run_limited("ulimit -d 50000", generate),
        &["ulimit -v"]
    ));
    // The needed memory depends on the number of threads, so the limit rises until the bake succeeds.
    let suffices = (5_000..400_000).step_by(5_000).find(|kilobytes| {
        let bake = format!("{BAKE} --data-dir with-{kilobytes} -o again.pvs");
        let run = sandbox.run_limited(&format!("ulimit -d {kilobytes}"), &bake);
        ends_well(run, &["ulimit -v"])
    });
    assert!(
        suffices.is_some_and(|kilobytes| kilobytes > 20_000),
        "a bake succeeds with {suffices:?} kilobytes"
    );
    // The stacks of 4000 threads have 8 GB.
    sandbox.set("RAYON_NUM_THREADS", "4000");
    for _ in 0..8 {
        assert!(!ends_well(
            sandbox.run_limited("ulimit -d 1000000", "info maze.pvs"),
            &["ulimit -v"]
        ));
    }
}
