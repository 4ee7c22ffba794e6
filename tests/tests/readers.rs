//! Tests of the readers of results in other languages. They read the same sets from the same files as the
//! Rust reader, and reject the same damaged files.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde_json::{Value, json};
use sightline_tests::{Browser, Sandbox, in_ci, libraries, python, python_folder};

/// The names and bake arguments of results of every kind.
const RESULTS: [(&str, &str); 12] = [
    ("grid", "rooms.glb --cells 4x2x3 --backend cpu"),
    ("one", "rooms.glb --cells 1x1x1 --backend cpu"),
    (
        "adaptive",
        "rooms.glb --triangle-budget 400 --max-depth 6 --backend cpu",
    ),
    (
        "exact",
        "rooms.glb --cells 3x1x2 --method exact --backend cpu",
    ),
    (
        "certified",
        "rooms.glb --cells 2x1x2 --method exact --certificates --backend cpu",
    ),
    (
        "verified",
        "rooms.glb --cells 3x1x2 --method verified --time-budget 1s --backend cpu",
    ),
    ("portals", "rooms.glb --cells 3x1x2 --method portals"),
    (
        "walls",
        "rooms.glb --cells walls:9 --reachable-from 2,1.5,3 --method portals",
    ),
    (
        "clusters",
        "rooms.glb --cells 3x1x2 --granularity clusters --backend cpu",
    ),
    (
        "objects",
        "rooms.glb --cells 3x1x2 --granularity objects --backend cpu",
    ),
    (
        "shares",
        "rooms.glb --cells 3x1x2 --contributions --cell-to-cell off --backend cpu",
    ),
    (
        "glass",
        "rooms.glb --cells 3x1x2 --see-through * --max-error 0.05 --backend cpu",
    ),
];

/// Bakes all results in a folder. Returns the description of each from the Rust reader.
fn results(sandbox: &Sandbox) -> Vec<Value> {
    sandbox.ok("generate rooms --grid 3x2 --triangles 1500 -o rooms.glb");
    let said = |(name, job): (&str, &str)| {
        sandbox.ok(&format!("bake {job} -o {name}.pvs"));
        let lines = sandbox.ok(&format!("dump {name}.pvs"));
        let mut lines = lines
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).unwrap());
        let header = lines.next().unwrap();
        let cells: Vec<Value> = lines.collect();
        let values_of = |key: &str| {
            cells
                .iter()
                .map(|cell| cell[key].clone())
                .collect::<Vec<_>>()
        };
        json!({
            "name": name, "triangles": header["triangles"], "method": header["method"],
            "cells": cells.len(), "visible": values_of("visible"),
            "undecided": values_of("undecided"),
        })
    };
    RESULTS.into_iter().map(said).collect()
}

/// Returns damaged versions of a file, each of which the Rust reader rejects.
fn damaged(sandbox: &Sandbox, whole: &[u8]) -> Vec<Vec<u8>> {
    let mut all = vec![
        Vec::new(),
        whole[..7].to_vec(),
        whole[..39].to_vec(),
        whole[..whole.len() - 1].to_vec(),
    ];
    let longer: Vec<u8> = whole.iter().copied().chain([0]).collect();
    all.push(longer);
    for k in 0..60 {
        let mut bytes = whole.to_vec();
        let at = if k < 30 { k * 7 } else { k * whole.len() / 60 };
        bytes[at] ^= 1 << (k % 8);
        all.push(bytes);
    }
    for bytes in &all {
        sandbox.write("damaged.pvs", bytes);
        sandbox.run("info damaged.pvs").code(3);
    }
    all
}

/// The JavaScript that describes a result in the format of [`results`].
const SAY: &str = "const say = (name, bytes) => {
    const p = Pvs.parse(bytes), cells = [...Array(p.cells).keys()];
    return { name, triangles: p.triangles, method: p.method, cells: p.cells,
      visible: cells.map((c) => [...p.trianglesOf(p.visible(c))]),
      undecided: cells.map((c) => [...p.trianglesOf(p.undecided(c))]) }; };
    const refused = (bytes) => {
      try { Pvs.parse(bytes); return false; } catch (e) { return e.name === 'PvsError'; }
    };";

/// Returns a folder with all results and damaged files, the descriptions from the Rust reader, and the number
/// of damaged files.
fn shared() -> &'static (Sandbox, Vec<Value>, usize) {
    static SHARED: OnceLock<(Sandbox, Vec<Value>, usize)> = OnceLock::new();
    SHARED.get_or_init(|| {
        let sandbox = Sandbox::new();
        let expected = results(&sandbox);
        let damaged = damaged(&sandbox, &sandbox.read("exact.pvs"));
        for (k, bytes) in damaged.iter().enumerate() {
            sandbox.write(&format!("damaged-{k}.pvs"), bytes);
        }
        (sandbox, expected, damaged.len())
    })
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_owned()
}

/// Runs a command that must succeed. Returns `None` if the program is missing, which is a failure on CI.
fn run(command: &mut Command) -> Option<String> {
    match command.output() {
        Ok(out) => {
            let err = String::from_utf8_lossy(&out.stderr);
            assert!(
                out.status.success(),
                "{command:?}: {err}{}",
                String::from_utf8_lossy(&out.stdout)
            );
            Some(String::from_utf8(out.stdout).unwrap())
        }
        Err(e) if !in_ci() => {
            eprintln!("not run: {command:?} ({e}); scripts/setup.sh --for test");
            None
        }
        Err(e) => panic!("{command:?}: {e}"),
    }
}

/// Runs the program of a reader on all results and damaged files, and checks its descriptions.
fn ask(command: &mut Command) {
    let (sandbox, expected, damaged) = shared();
    let command = command
        .arg(damaged.to_string())
        .args(RESULTS.iter().map(|(name, _)| *name));
    let Some(out) = run(command.current_dir(sandbox.path("."))) else {
        return;
    };
    check(&serde_json::from_str(&out).unwrap(), expected, *damaged);
}

#[test]
fn c_reads_same_sets_and_rejects_same_files() {
    let (sandbox, ..) = shared();
    let folder = root().join("readers/c");
    for (name, library) in [
        ("static", "libsightline_pvs_c.a"),
        ("dynamic", "libsightline_pvs_c.so"),
    ] {
        let say = sandbox.path(&format!("say-{name}"));
        let mut compile = Command::new("cc");
        compile
            .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"])
            .arg("-o")
            .arg(&say);
        compile
            .arg("-I")
            .arg(folder.join("include"))
            .arg(folder.join("tests/say.c"));
        compile
            .arg(libraries().join(library))
            .args(["-lpthread", "-ldl", "-lm"]);
        if run(&mut compile).is_some() {
            ask(Command::new(&say).env("LD_LIBRARY_PATH", libraries()));
        }
    }
}

#[test]
fn csharp_reads_same_sets_and_rejects_same_files() {
    let (sandbox, ..) = shared();
    let folder = root().join("readers/csharp");
    let say = sandbox.path("Say.exe");
    let mut compile = Command::new("mcs");
    compile
        .arg("-warnaserror")
        .arg(format!("-out:{}", say.display()));
    compile
        .arg(folder.join("SightlinePvs.cs"))
        .arg(folder.join("tests/Say.cs"));
    if run(&mut compile).is_some() {
        ask(Command::new("mono")
            .arg(&say)
            .env("LD_LIBRARY_PATH", libraries()));
    }
}

#[test]
fn python_reads_same_sets_and_rejects_same_files() {
    let Some(python) = python() else { return };
    ask(Command::new(python).arg(python_folder().join("tests/say.py")));
}

#[test]
fn javascript_reads_same_sets_and_rejects_same_files() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .join("readers/js");
    let source = std::fs::read_to_string(folder.join("pvs.mjs")).unwrap();
    assert!(source.len() < 15_000, "{} bytes", source.len());
    let (sandbox, expected, damaged) = shared();
    sandbox.write("reader.mjs", &source);
    let names: Vec<&str> = RESULTS.iter().map(|(name, _)| *name).collect();
    sandbox.write(
        "read.mjs",
        format!(
            "import {{ Pvs }} from './reader.mjs'; import fs from 'node:fs'; {SAY}
             console.log(JSON.stringify({{ said: {names:?}.map((n) => say(n, fs.readFileSync(n + '.pvs'))),
               refused: [...Array({}).keys()].map((k) =>
                 refused(fs.readFileSync('damaged-' + k + '.pvs'))) }}));
             // Read by ranges, from a server that supports them.
             let bytes = 0;
             globalThis.fetch = async (url, {{ headers }}) => {{
               const all = fs.readFileSync(url), [, from, to] = /bytes=(\\d+)-(\\d+)/.exec(headers.Range);
               const part = all.subarray(+from, Math.min(+to + 1, all.length));
               bytes += part.length;
               return new Response(part, {{ status: 206, headers: {{
                 'content-range': `bytes ${{from}}-${{+from + part.length - 1}}/${{all.length}}` }} }});
             }};
             for (const name of {names:?}) {{
               const far = await Pvs.ranges(name + '.pvs'), near = Pvs.parse(fs.readFileSync(name + '.pvs'));
               for (let c = 0; c < near.cells; c++) {{
                 const same = String(await far.visible(c)) === String(near.visible(c))
                   && String(await far.undecided(c)) === String(near.undecided(c));
                 if (!same) throw new Error(name);
               }}
             }}
             bytes = 0;
             await (await Pvs.ranges('certified.pvs')).visible(0);
             if (bytes * 4 > fs.statSync('certified.pvs').size) throw new Error(`${{bytes}} bytes`);",
            damaged
        ),
    );
    // Use Node if it is installed; the test of browsers is below.
    match Command::new("node")
        .arg(sandbox.path("read.mjs"))
        .current_dir(sandbox.path("."))
        .output()
    {
        Ok(out) => {
            assert!(
                out.status.success(),
                "{}",
                String::from_utf8_lossy(&out.stderr)
            );
            let answer: Value = serde_json::from_slice(&out.stdout).unwrap();
            check(&answer, expected, *damaged);
        }
        Err(e) => eprintln!("not run: node ({e}); the browser is asked alone"),
    }
    let Some(browser) = Browser::start([300, 200]) else {
        return;
    };
    let module = source.replace("export ", "").replace("</", "<\\/");
    let blocks = names.iter().map(|name| format!("{name}.pvs"));
    let blocks = blocks.chain((0..*damaged).map(|k| format!("damaged-{k}.pvs")));
    let bytes: Vec<Vec<u8>> = blocks.map(|name| sandbox.read(&name)).collect();
    sandbox.write(
        "read.html",
        format!(
            "<!doctype html><meta charset=utf-8><link rel=icon href=data:,><script type=module>{module}\n{SAY}
             const all = {bytes:?}.map((b) => Uint8Array.from(b));
             globalThis.answer = {{ said: {names:?}.map((n, k) => say(n, all[k])),
               refused: all.slice({}).map(refused) }};</script>",
            names.len()
        ),
    );
    browser.open(&format!("file://{}", sandbox.path("read.html").display()));
    check(&browser.run("return globalThis.answer"), expected, *damaged);
    assert_eq!(browser.messages(), Vec::<String>::new());
}

/// Panics unless a reader describes all results in the same way and rejects all damaged files.
fn check(answer: &Value, expected: &[Value], damaged: usize) {
    for (said, expected) in answer["said"].as_array().unwrap().iter().zip(expected) {
        assert_eq!(said, expected, "{}", expected["name"]);
    }
    assert_eq!(answer["said"].as_array().unwrap().len(), expected.len());
    assert_eq!(answer["refused"], json!(vec![true; damaged]));
}
