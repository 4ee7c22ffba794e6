//! Tests of the examples for engines (examples/). Each example runs in its engine if the engine can run here,
//! or otherwise against a stub or a parser, as examples/README.md lists.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use serde_json::{Value, json};
use sightline_tests::{Browser, Sandbox, Site, example, in_ci, program};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_owned()
}

/// Returns a folder with a maze and its exact result, and the output of `dump` about its cells' objects.
fn maze() -> &'static (Sandbox, Vec<Value>) {
    static SHARED: OnceLock<(Sandbox, Vec<Value>)> = OnceLock::new();
    SHARED.get_or_init(|| {
        let sandbox = Sandbox::new();
        sandbox.ok("generate maze --grid 5x3 -o level.glb");
        let boxes = "--view-box 0.4,0.5,0.4,9.6,1.5,5.6 --cells 5x1x3";
        sandbox.ok(&format!(
            "bake level.glb -o level.pvs {boxes} --method exact --backend cpu"
        ));
        let dump = sandbox.ok("dump level.pvs --items objects");
        let cells = dump
            .lines()
            .skip(1)
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        (sandbox, cells)
    })
}

/// Returns the centre of a cell of `dump`.
fn middle(cell: &Value) -> [f64; 3] {
    [0, 1, 2].map(|k| {
        f64::midpoint(
            cell["min"][k].as_f64().unwrap(),
            cell["max"][k].as_f64().unwrap(),
        )
    })
}

/// Prints that a test is not run, or fails on CI.
fn skipped(why: &str) {
    assert!(!in_ci(), "{why}");
    eprintln!("not run: {why}");
}

/// Returns the output of a command that must succeed, or `None` if its program is missing, which is a failure
/// on CI.
fn said(command: &mut Command) -> Option<String> {
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
        Err(e) => {
            skipped(&format!("{command:?} ({e}); scripts/setup.sh --for test"));
            None
        }
    }
}

/// Returns the folder for downloads in the target folder of this build.
fn kept() -> PathBuf {
    std::env::current_exe()
        .unwrap()
        .ancestors()
        .nth(3)
        .unwrap()
        .join("engines")
}

/// Returns a Python with a package index, or `None` if it is not available.
fn python() -> Option<&'static Path> {
    static PYTHON: OnceLock<Option<PathBuf>> = OnceLock::new();
    let made = || {
        let folder = kept().join("python");
        let python = folder.join("bin/python");
        if !python.exists() {
            said(Command::new("python3").args(["-m", "venv"]).arg(&folder))?;
        }
        Some(python)
    };
    PYTHON.get_or_init(made).as_deref()
}

/// Runs pip with these arguments after `command`. Returns false if packages cannot be downloaded, which is a
/// failure on CI.
fn pip(python: &Path, command: &str, arguments: &[&str]) -> bool {
    let mut pip = Command::new(python);
    pip.args([
        "-m",
        "pip",
        command,
        "--quiet",
        "--disable-pip-version-check",
    ])
    .args(arguments);
    let out = pip.output().unwrap();
    if !out.status.success() {
        let why = String::from_utf8_lossy(&out.stderr);
        skipped(&format!(
            "pip cannot fetch {arguments:?}: {}",
            why.lines().last().unwrap_or_default()
        ));
    }
    out.status.success()
}

/// The wheel that contains three.js r168 as modules, so that a test does not need npm.
const WHEEL: &str = "nicegui==2.24.2 \
    --hash=sha256:9b810fe75f3dd1ff926e3d96d71e25031387fe5b7a21d32159a32611b8023423\n";

/// Returns a folder with three.module.js and modules/GLTFLoader.js, or `None` if they cannot be downloaded.
fn three() -> Option<PathBuf> {
    let folder = kept().join("three-168");
    let modules = folder.join("nicegui/elements/lib/three");
    if !modules.join("complete").exists() {
        let python = python()?;
        std::fs::create_dir_all(&folder).unwrap();
        let list = folder.join("wheel.txt");
        std::fs::write(&list, WHEEL).unwrap();
        let [list, at] = [&list, &folder].map(|path| path.to_str().unwrap());
        if !pip(
            python,
            "download",
            &["--no-deps", "--require-hashes", "-r", list, "-d", at],
        ) {
            return None;
        }
        let wheel = folder.join("nicegui-2.24.2-py3-none-any.whl");
        let unpack = "import sys, zipfile
z = zipfile.ZipFile(sys.argv[1])
z.extractall(sys.argv[2], [n for n in z.namelist() if n.startswith('nicegui/elements/lib/three/')])";
        said(
            Command::new(python)
                .args(["-c", unpack])
                .args([&wheel, &folder]),
        )?;
        std::fs::remove_file(wheel).unwrap();
        std::fs::write(modules.join("complete"), "").unwrap();
    }
    Some(modules)
}

/// The script of the test in the page. It draws all meshes in separate colours, from a point in all
/// directions, with culling and without.
const LOOK: &str = "
    const example = await globalThis.example;
    const { THREE, renderer, scene, camera, culler } = example;
    const meshes = [];
    scene.traverse((o) => { if (o.isMesh) meshes.push(o); });
    meshes.forEach((mesh, k) => {
      const color = (k + 1) * 2654435 & 0xffffff;
      mesh.material = new THREE.MeshBasicMaterial({ color, side: THREE.DoubleSide });
    });
    renderer.setSize(256, 256, false);
    camera.fov = 90; camera.aspect = 1; camera.updateProjectionMatrix();
    const gl = renderer.getContext();
    const picture = (culled) => {
      const { cell, calls } = example.draw(culled);
      const pixels = new Uint8Array(4 * 256 * 256);
      gl.readPixels(0, 0, 256, 256, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      return { cell, calls, pixels };
    };
    const differing = (a, b) => {
      let n = 0;
      for (let i = 0; i < a.length; i += 4) {
        n += a[i] !== b[i] || a[i + 1] !== b[i + 1] || a[i + 2] !== b[i + 2];
      }
      return n;
    };
    const look = (eye, turn) => {
      camera.position.set(...eye);
      camera.rotation.set(turn > 3 ? (turn - 4.5) * Math.PI : 0, turn * Math.PI / 2, 0);
      camera.updateMatrixWorld();
    };";

#[test]
fn three_draws_same_pictures_with_fewer_calls() {
    let Some(three) = three() else { return };
    let Some(browser) = Browser::start([400, 300]) else {
        return;
    };
    let (sandbox, cells) = maze();
    // Use the page with another import map: in this three.js, the loader imports a module by another name.
    let page = std::fs::read_to_string(root().join("examples/three/index.html")).unwrap();
    let (before, map) = page.split_once("<script type=\"importmap\">").unwrap();
    let (_, after) = map.split_once("</script>").unwrap();
    let map = json!({"imports": {
        "three": "/three/three.module.js",
        "three/addons/loaders/": "/three/modules/",
        "BufferGeometryUtils": "/three/modules/BufferGeometryUtils.js",
    }});
    let page = format!(
        "{before}<link rel=icon href=data:,><script type=\"importmap\">{map}</script>{after}"
    );
    sandbox.write("index.html", page);
    let site = Site::start(&[
        ("/examples/three/index.html", sandbox.path("index.html")),
        ("/level/", sandbox.path(".")),
        ("/three/", three),
        ("/", root()),
    ]);
    browser.open(
        &site.address("/examples/three/index.html?scene=/level/level.glb&pvs=/level/level.pvs"),
    );
    // The page itself counts the draw calls.
    let counted = "await globalThis.example; await new Promise(requestAnimationFrame);
        await new Promise(requestAnimationFrame); return document.getElementById('status').textContent";
    let status = browser.run(counted);
    assert!(
        status.as_str().unwrap().contains("draw calls with culling"),
        "{status}"
    );
    browser.run("const { renderer } = await globalThis.example; renderer.setAnimationLoop(null);");
    let eyes: Vec<[f64; 3]> = cells.iter().map(middle).collect();
    let answer = browser.run(&format!(
        "{LOOK} const all = [];
        for (const eye of {eyes:?}) for (let turn = 0; turn < 6; turn++) {{
          look(eye, turn);
          const off = picture(false), on = picture(true);
          all.push([on.cell, on.calls, off.calls, differing(on.pixels, off.pixels)]);
        }}
        return all;"
    ));
    let all = answer.as_array().unwrap();
    assert_eq!(all.len(), 6 * cells.len());
    for (number, view) in all.iter().enumerate() {
        let [cell, on, off, differing] = [0, 1, 2, 3].map(|k| view[k].as_i64().unwrap());
        assert_eq!(cell, (number / 6) as i64);
        assert!(on <= off && differing == 0, "view {number}: {view}");
    }
    let sum = |k: usize| {
        all.iter()
            .map(|view| view[k].as_i64().unwrap())
            .sum::<i64>()
    };
    assert!(
        sum(1) * 5 < sum(2) * 4,
        "{} draw calls with culling, {} without",
        sum(1),
        sum(2)
    );
    // The comparison detects a single missing mesh.
    let missing = browser.run(&format!(
        "{LOOK} look({:?}, 0);
        const whole = picture(true), counts = meshes.map((mesh) => {{
          const before = mesh.layers.mask;
          mesh.layers.mask = 0;
          renderer.render(scene, camera);
          const pixels = new Uint8Array(4 * 256 * 256);
          gl.readPixels(0, 0, 256, 256, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
          mesh.layers.mask = before;
          return differing(whole.pixels, pixels);
        }});
        return Math.max(...counts);",
        eyes[0]
    ));
    assert!(missing.as_i64().unwrap() > 100, "{missing}");
    // Another scene is rejected with a message.
    sandbox.ok("generate maze --grid 4x3 -o other.glb");
    browser.open(
        &site.address("/examples/three/index.html?scene=/level/other.glb&pvs=/level/level.pvs"),
    );
    let why = browser.run(
        "try { await globalThis.example; } catch (e) {
          await new Promise(requestAnimationFrame); return document.getElementById('status').textContent; }",
    );
    assert!(
        why.as_str()
            .unwrap()
            .contains("load the file that was baked"),
        "{why}"
    );
}

#[test]
fn unity_component_culls_in_stub_of_unity() {
    let (sandbox, cells) = maze();
    sandbox.ok("export level.pvs --format sidecar -o level.json");
    let sidecar: Value = serde_json::from_slice(&sandbox.read("level.json")).unwrap();
    let nodes: Vec<&str> = sidecar["objects"]
        .as_array()
        .unwrap()
        .iter()
        .map(node)
        .collect();
    let mut names: Vec<&str> = nodes.clone();
    names.push("a lamp of the game");
    sandbox.write("names.txt", names.join("\n"));
    let eyes: Vec<String> = cells
        .iter()
        .map(|cell| middle(cell).map(|c| c.to_string()).join(" "))
        .collect();
    sandbox.write("eyes.txt", format!("{}\n1e6 0 0\n", eyes.join("\n")));
    let exe = sandbox.path("stub.exe");
    let mut compile = Command::new("mcs");
    compile
        .arg("-warnaserror")
        .arg(format!("-out:{}", exe.display()));
    compile.args([
        "readers/csharp/SightlinePvs.cs",
        "examples/unity/SightlineCuller.cs",
    ]);
    compile
        .arg("tests/engines/UnityStub.cs")
        .current_dir(root());
    if said(&mut compile).is_none() {
        return;
    }
    let libraries = program().parent().unwrap().to_owned();
    let run = |file: &str| {
        let mut mono = Command::new("mono");
        mono.arg(&exe)
            .arg(file)
            .current_dir(sandbox.path("."))
            .env("LD_LIBRARY_PATH", &libraries);
        said(&mut mono).unwrap()
    };
    let out = run("level.pvs");
    let mut lines = out.lines();
    for (number, cell) in cells.iter().enumerate() {
        let (shown_cell, shown) = lines.next().unwrap().split_once(':').unwrap();
        assert_eq!(shown_cell, number.to_string());
        assert_eq!(shown, expected(&names, &nodes, cells, cell).join(","));
        assert!(shown.split(',').count() < names.len());
    }
    assert_eq!(lines.next().unwrap(), format!("-1:{}", names.join(",")));
    assert_eq!(lines.collect::<Vec<_>>(), ["off:0"]);
    sandbox.write("broken.pvs", "no result");
    assert!(run("broken.pvs").contains("culling is off"));
}

/// Returns the node of an object of a sidecar, which is named `node/mesh#primitive`.
fn node(object: &Value) -> &str {
    object["name"].as_str().unwrap().split('/').next().unwrap()
}

/// Returns the names that are shown from a cell: names in its set, and names in no set at all.
fn expected<'a>(names: &[&'a str], nodes: &[&str], cells: &[Value], cell: &Value) -> Vec<&'a str> {
    let has = |cell: &Value, name: &str| {
        let ids = cell["visible"].as_array().unwrap().iter();
        ids.map(|id| nodes[id.as_u64().unwrap() as usize])
            .any(|node| node == name)
    };
    let is_known = |name: &str| cells.iter().any(|cell| has(cell, name));
    names
        .iter()
        .copied()
        .filter(|name| !is_known(name) || has(cell, name))
        .collect()
}

#[test]
fn godot_script_is_valid_gdscript() {
    let Some(python) = python() else { return };
    let tools = [
        "gdtoolkit==4.5.0",
        "lark==1.2.2",
        "docopt-ng==0.9.0",
        "radon==6.0.1",
    ];
    if !pip(python, "install", &tools) {
        return;
    }
    let script = root().join("examples/godot/sightline_culler.gd");
    let tool = |name: &str| Command::new(python.with_file_name(name));
    said(tool("gdparse").arg(&script)).unwrap();
    said(tool("gdlint").arg(&script)).unwrap();
    // The parser rejects an invalid script.
    let text = std::fs::read_to_string(&script).unwrap().replacen(
        "func _ready() -> void:",
        "func _ready( -> void:",
        1,
    );
    let sandbox = Sandbox::new();
    sandbox.write("broken.gd", text);
    assert!(
        !tool("gdparse")
            .arg(sandbox.path("broken.gd"))
            .output()
            .unwrap()
            .status
            .success()
    );
    eprintln!(
        "not run: examples/godot in Godot (neither Debian nor PyPI has Godot 4); it is parsed and linted"
    );
}

#[test]
fn players_receive_players_that_their_cells_see() {
    let (sandbox, cells) = maze();
    let seen = sandbox.ok("dump level.pvs --items cells");
    let seen: Vec<Value> = seen
        .lines()
        .skip(1)
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let sees = |a: usize, b: usize| seen[a]["visible"].as_array().unwrap().contains(&json!(b));
    let lines = cells.iter().enumerate().map(|(number, cell)| {
        let [x, y, z] = middle(cell);
        format!("p{number} {x} {y} {z}\n")
    });
    let players: String = lines.collect();
    let interest = example("interest");
    let ask = |arguments: &str, players: &str| {
        let mut child = Command::new(&interest)
            .args(arguments.split_whitespace())
            .current_dir(sandbox.path("."))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // A program that rejects its arguments does not read stdin.
        drop(child.stdin.take().unwrap().write_all(players.as_bytes()));
        let out = child.wait_with_output().unwrap();
        let lines = String::from_utf8(out.stdout).unwrap();
        let lines: Vec<String> = lines
            .lines()
            .map(|line| line.trim_end().to_owned())
            .collect();
        (lines, String::from_utf8(out.stderr).unwrap())
    };
    let all = 0..cells.len();
    let (lines, _) = ask("level.pvs", &format!("# players\n\n{players}"));
    let expected: Vec<String> = all
        .clone()
        .map(|a| {
            let told = all.clone().filter(|b| *b != a && sees(a, *b));
            told.fold(format!("p{a}:"), |line, b| format!("{line} p{b}"))
        })
        .collect();
    assert_eq!(lines, expected);
    let pairs = |lines: &[String]| {
        lines
            .iter()
            .map(|line| line.split(' ').count() - 1)
            .sum::<usize>()
    };
    let most = cells.len() * (cells.len() - 1);
    assert!((1..most).contains(&pairs(&lines)), "{lines:?}");
    // With a margin, more players may see each other. Visibility stays symmetric.
    let (wider, _) = ask("level.pvs 1.5", &players);
    assert!(pairs(&wider) > pairs(&lines), "{wider:?}");
    let knows = |a: usize, b: usize| wider[a].split(' ').any(|name| name == format!("p{b}"));
    assert!(
        all.clone()
            .all(|a| all.clone().all(|b| a == b || knows(a, b) == knows(b, a))),
        "{wider:?}"
    );
    // The visibility of a player outside the view box is unknown, so the player sees everyone, and everyone
    // sees the player.
    let (lines, _) = ask("level.pvs", &format!("{players}far -100 0 0\n"));
    assert_eq!(lines.last().unwrap().split(' ').count(), 1 + cells.len());
    assert!(
        lines[..cells.len()]
            .iter()
            .all(|line| line.ends_with(" far"))
    );
    let (_, why) = ask("level.pvs", "p 1 2\n");
    assert!(
        why.contains("line 1") && why.contains("name x y z"),
        "{why}"
    );
    assert!(ask("level.pvs -1", "").1.contains("usage"));
    sandbox.ok("bake level.glb -o none.pvs --cells 2x1x1 --cell-to-cell off --backend cpu");
    assert!(ask("none.pvs", &players).1.contains("--cell-to-cell on"));
}
