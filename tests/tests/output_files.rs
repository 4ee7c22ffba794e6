//! Tests of files that commands write for users: the order of the system calls, and failing writes.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use sightline_tests::{FILE_CALLS, Sandbox, Strace, SystemCall, program};

const MAZE: &str = "generate maze --grid 2x2 -o maze.glb";
const BAKE: &str =
    "bake maze.glb --cells 2x1x2 --target-error 0.1 --backend cpu --data-dir data -o maze.pvs";

/// Command lines, each with the files that the command writes.
const WRITERS: [(&str, &[&str]); 18] = [
    (MAZE, &["maze.glb"]),
    (BAKE, &["maze.pvs"]),
    (
        "plan maze.glb --cells 2x1x2 --target-error 0.1 --backend cpu -o plan",
        &["plan/job.bin", "plan/scene.bin", "plan/plan.json"],
    ),
    ("tile plan 0", &["plan/tiles/0.tile"]),
    ("assemble plan -o tiles.pvs", &["tiles.pvs"]),
    ("mesh maze.glb -o maze.ply", &["maze.ply"]),
    (
        "export maze.pvs --format sidecar -o maze.json",
        &["maze.json"],
    ),
    ("export maze.pvs --format csv -o maze.csv", &["maze.csv"]),
    (
        "export maze.pvs --format gltf --scene maze.glb -o seen.glb",
        &["seen.glb"],
    ),
    ("view maze.pvs maze.glb -o view.html", &["view.html"]),
    (
        "diff maze.pvs maze.pvs --scene maze.glb -o diff.html",
        &["diff.html"],
    ),
    (
        "report maze.pvs maze.glb -o report.html --viewpoints 4 --resolution 32 --backend cpu",
        &["report.html"],
    ),
    (
        "tetra maze.glb -o maze.tets --export maze.vtu",
        &["maze.tets", "maze.vtu"],
    ),
    (
        "store export --data-dir data -o records.jsonl",
        &["records.jsonl"],
    ),
    (
        "man pages",
        &["pages/sightline.1", "pages/sightline-bake.1"],
    ),
    (
        "token new --tokens tokens.json --user ada --scope read",
        &["tokens.json"],
    ),
    (
        "measure maze.glb maze.pvs --viewpoints 8 --resolution 32 --backend cpu --images images --turntable",
        &["images/worst_turntable.png"],
    ),
    (
        "bench maze.glb --samplers lines --cells 2x1x2 --viewpoints 4 --resolution 16 --least-error 1 \
         --out out --results out/results.md",
        &["out/curves.csv", "out/curves.svg", "out/results.md"],
    ),
];

/// Returns the quoted strings in a call.
fn strings(call: &SystemCall) -> Vec<&str> {
    call.text.split('"').skip(1).step_by(2).collect()
}

/// Returns the path of the file that a call created, if any.
fn created(call: &SystemCall) -> Option<&Path> {
    let creates = call.name == "creat" || call.name == "openat" && call.text.contains("O_CREAT");
    let (_, result) = call.text.rsplit_once(" = ")?;
    let path = result.split_once('<')?.1.strip_suffix('>')?;
    (creates && call.succeeded()).then_some(Path::new(path))
}

/// Checks that a renamed file was synced before the rename, and its folder afterwards.
#[track_caller]
fn assert_synced(calls: &[SystemCall], folder: &Path, file: &str, line: &str) {
    let target = folder.join(file);
    let syncs = |path: &Path, call: &SystemCall| {
        call.name == "fsync"
            && call.succeeded()
            && call.text.contains(&format!("<{}>", path.display()))
    };
    let mut renames = 0;
    for call in calls
        .iter()
        .filter(|call| call.name.starts_with("rename") && call.succeeded())
    {
        let [.., from, to] = strings(call)[..] else {
            panic!("{call:?}")
        };
        if folder.join(to) != target {
            continue;
        }
        renames += 1;
        // Remove dots in the middle of the path, as in strace's paths of descriptors.
        let from: PathBuf = folder.join(from).components().collect();
        let before = |c: &&SystemCall| syncs(&from, c) && c.returned < call.begun;
        assert!(
            calls.iter().any(|c| before(&c)),
            "{line}: {file} is renamed without a sync\n{calls:#?}"
        );
        let after = |c: &&SystemCall| syncs(target.parent().unwrap(), c) && call.returned < c.begun;
        assert!(
            calls.iter().any(|c| after(&c)),
            "{line}: the folder of {file} is not synced\n{calls:#?}"
        );
    }
    assert!(
        renames > 0,
        "{line}: {file} is not renamed into place\n{calls:#?}"
    );
}

#[test]
fn commands_sync_files_and_folders_in_order() {
    let sandbox = Sandbox::new();
    let folder = std::fs::canonicalize(sandbox.path("")).unwrap();
    // Records of the farm and caches have separate rules.
    let others: Vec<PathBuf> = ["data", "cache", "calls"]
        .iter()
        .map(|name| folder.join(name))
        .collect();
    for (line, files) in WRITERS {
        let Some(strace) = Strace::new(&folder.join("calls")) else {
            return;
        };
        let mut command = strace.command(program(), FILE_CALLS);
        command
            .args(line.split_whitespace())
            .current_dir(&folder)
            .env("XDG_CACHE_HOME", folder.join("cache"));
        let ran = command.stdin(Stdio::null()).output().unwrap();
        assert!(
            ran.status.success(),
            "{line}: {}",
            String::from_utf8_lossy(&ran.stderr)
        );
        let calls = strace.calls();
        for file in files {
            assert_synced(&calls, &folder, file, line);
        }
        for path in calls
            .iter()
            .filter_map(created)
            .filter(|path| path.starts_with(&folder))
        {
            let name = path.file_name().unwrap().to_str().unwrap();
            let is_fine = name.starts_with(".sightline-part-")
                || name == "tokens.json.lock"
                || others.iter().any(|other| path.starts_with(other));
            assert!(is_fine, "{line}: {name} is written in place");
        }
    }
}

#[test]
fn failed_writes_leave_previous_files() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    sandbox.ok(BAKE);
    sandbox.ok("mesh maze.glb -o maze.ply");
    sandbox.ok("export maze.pvs --format csv -o maze.csv");
    let names = || {
        let entries = std::fs::read_dir(sandbox.path("")).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = names();
    for (line, file) in [
        (MAZE, "maze.glb"),
        ("mesh maze.glb -o maze.ply", "maze.ply"),
        ("export maze.pvs --format csv -o maze.csv", "maze.csv"),
        ("view maze.pvs maze.glb -o new.html", "new.html"),
    ] {
        let old = std::fs::read(sandbox.path(file)).ok();
        // Files end after one block, as on a full disk. The shell ignores the signal that would end the
        // program.
        let limited = format!("trap '' XFSZ; ulimit -f 1; exec \"$0\" {line}");
        let mut command = Command::new("sh");
        command
            .args(["-c", &limited])
            .arg(program())
            .current_dir(sandbox.path(""))
            .stdin(Stdio::null());
        let ran = command.output().unwrap();
        let text = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert_eq!(ran.status.code(), Some(1), "{line}: {text}");
        assert!(
            text.contains(&format!("{file} cannot be written")),
            "{line}: {text}"
        );
        assert_eq!(std::fs::read(sandbox.path(file)).ok(), old, "{line}");
        assert_eq!(names(), before, "{line}");
    }
}

#[test]
fn pipes_and_redirected_stdout_are_rejected() {
    let sandbox = Sandbox::new();
    let generate = |stdout: Stdio, output: &str| {
        let mut command = Command::new(program());
        command
            .args(["generate", "maze", "--grid", "2x2", "-o", output])
            .current_dir(sandbox.path(""));
        let ran = command
            .stdin(Stdio::null())
            .stdout(stdout)
            .output()
            .unwrap();
        (
            ran.status.code(),
            String::from_utf8_lossy(&ran.stderr).into_owned(),
        )
    };
    let (code, text) = generate(Stdio::piped(), "/dev/stdout");
    assert!(
        code == Some(2) && text.contains("a device or a pipe"),
        "{text}"
    );
    let redirected = std::fs::File::create(sandbox.path("maze.glb")).unwrap();
    for output in ["/dev/stdout", "maze.glb"] {
        let (code, text) = generate(redirected.try_clone().unwrap().into(), output);
        assert!(
            code == Some(2) && text.contains("standard output"),
            "{text}"
        );
    }
    assert!(sandbox.read("maze.glb").is_empty());
}
