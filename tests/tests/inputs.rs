//! Tests of the program's inputs: bad scenes and bad arguments are rejected with a helpful message, and
//! generated scenes are the same in every run.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use sightline_tests::Sandbox;

/// Creates a PLY file that announces this number of vertices and faces, with `body` after the header.
fn ply(format: &str, vertices: u64, faces: u64, body: &[u8]) -> Vec<u8> {
    let header = format!(
        "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty \
            float z\n\
         element face {faces}\nproperty list uint uint vertex_indices\nend_header\n"
    );
    [header.as_bytes(), body].concat()
}

/// Creates a GLB with this JSON and this binary chunk.
fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let pad = |bytes: &[u8], with: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), with);
        bytes
    };
    let (json, binary) = (pad(json.as_bytes(), b' '), pad(binary, 0));
    let word = |n: usize| (n as u32).to_le_bytes();
    let mut out = b"glTF".to_vec();
    for part in [
        &word(2)[..],
        &word(28 + json.len() + binary.len()),
        &word(json.len()),
        b"JSON",
        &json,
        &word(binary.len()),
        b"BIN\0",
        &binary,
    ] {
        out.extend_from_slice(part);
    }
    out
}

/// Creates a glTF of one triangle without an index list. The three positions are in the first buffer, `count`
/// is the announced number of positions, and `bytes` the announced number of bytes.
fn gltf(count: u64, bytes: u64) -> String {
    serde_json::json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": bytes}],
        "buffers": [{"byteLength": bytes}],
    })
    .to_string()
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

const CORNERS: [f32; 9] = [0., 0., 0., 1., 0., 0., 0., 1., 0.];

#[test]
fn base_scenes_of_bad_scenes_are_good() {
    let sandbox = Sandbox::new();
    let face: Vec<u8> = [3u32, 0, 1, 2]
        .iter()
        .flat_map(|i| i.to_le_bytes())
        .collect();
    let body = [floats(&CORNERS), face].concat();
    sandbox.write("good.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    sandbox.write("good.ply", ply("binary_little_endian", 3, 1, &body));
    sandbox.write(
        "text.ply",
        ply("ascii", 3, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
    );
    sandbox.write("good.glb", glb(&gltf(3, 36), &floats(&CORNERS)));
    let mut meshes = Vec::new();
    for file in ["good.obj", "good.ply", "text.ply", "good.glb"] {
        assert_eq!(
            sandbox.json(&format!("mesh {file} -o mesh.ply"))["triangles"],
            1
        );
        meshes.push(sandbox.read("mesh.ply"));
    }
    assert!(meshes.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn bad_scenes_are_rejected_with_name_and_remedy() {
    let nan = {
        let mut c = CORNERS;
        c[4] = f32::NAN;
        c
    };
    let face = |list: &[u32]| -> Vec<u8> { list.iter().flat_map(|i| i.to_le_bytes()).collect() };
    let little = |v, f, body: &[u8]| ply("binary_little_endian", v, f, body);
    let body = [floats(&CORNERS), face(&[3, 0, 1, 2])].concat();
    let good_ply = little(3, 1, &body);
    let good_glb = glb(&gltf(3, 36), &floats(&CORNERS));
    let mut long_glb = good_glb.clone();
    long_glb[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut long_chunk = good_glb.clone();
    long_chunk[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
    let short = |bytes: &[u8]| bytes[..bytes.len() - 3].to_vec();

    let table: Vec<(&str, Vec<u8>)> = vec![
        // Scenes without a triangle.
        ("empty.obj", vec![]),
        ("empty.ply", vec![]),
        ("empty.gltf", vec![]),
        ("empty.glb", vec![]),
        ("no-face.obj", b"v 0 0 0\nv 1 0 0\n".into()),
        ("no-face.ply", little(3, 0, &floats(&CORNERS))),
        // Files that end too early.
        ("short.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2".into()),
        ("short-vertex.obj", b"v 0 0\nf 1 1 1\n".into()),
        ("short.ply", short(&good_ply)),
        ("short-header.ply", good_ply[..40].to_vec()),
        (
            "short-text.ply",
            ply("ascii", 3, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1"),
        ),
        ("short.gltf", gltf(3, 36)[..60].into()),
        ("short.glb", short(&good_glb)),
        ("short-header.glb", good_glb[..10].to_vec()),
        // Coordinates that are not finite.
        ("nan.obj", b"v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n".into()),
        ("inf.obj", b"v 0 0 0\nv 1e39 0 0\nv 0 1 0\nf 1 2 3\n".into()),
        (
            "nan.ply",
            little(3, 1, &[floats(&nan), face(&[3, 0, 1, 2])].concat()),
        ),
        ("nan.glb", glb(&gltf(3, 36), &floats(&nan))),
        // References to elements that do not exist.
        ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n".into()),
        (
            "index-zero.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n".into(),
        ),
        (
            "index-negative.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n".into(),
        ),
        (
            "index.ply",
            little(3, 1, &[floats(&CORNERS), face(&[3, 0, 1, 3])].concat()),
        ),
        (
            "index-text.ply",
            ply("ascii", 3, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n"),
        ),
        (
            "index.glb",
            glb(
                &gltf(3, 36).replace("\"mesh\":0", "\"mesh\":7"),
                &floats(&CORNERS),
            ),
        ),
        // Huge counts without data.
        ("count-vertices.ply", little(4_294_967_295, 1, &body)),
        ("count-faces.ply", little(3, 4_294_967_295, &body)),
        ("count-larger.ply", little(u64::MAX, 1, &body)),
        (
            "count-list.ply",
            little(
                3,
                1,
                &[floats(&CORNERS), face(&[u32::MAX, 0, 1, 2])].concat(),
            ),
        ),
        (
            "count.glb",
            glb(&gltf(4_294_967_295, 36), &floats(&CORNERS)),
        ),
        (
            "count-view.glb",
            glb(&gltf(3, 4_294_967_295), &floats(&CORNERS)),
        ),
        ("count-total.glb", long_glb),
        ("count-chunk.glb", long_chunk),
        // Files with the extension of another format, and files that are not scenes.
        ("wrong.obj", good_ply.clone()),
        ("wrong.ply", good_glb.clone()),
        ("wrong.glb", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".into()),
        ("wrong.gltf", good_glb),
        ("picture.png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".into()),
        ("archive.glb", b"PK\x03\x04 and so on".into()),
        (
            "noise.obj",
            (0..2000u32)
                .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
                .collect(),
        ),
    ];
    let sandbox = Sandbox::new();
    for (name, bytes) in &table {
        sandbox.write(name, bytes);
        for command in [
            format!("mesh {name} -o out.ply"),
            format!("bake {name} -o out.pvs --data-dir data"),
        ] {
            refused(&sandbox, &command, name);
        }
    }
    std::fs::create_dir(sandbox.path("folder.obj")).unwrap();
    for name in ["missing.obj", "folder.obj"] {
        refused(&sandbox, &format!("mesh {name} -o out.ply"), name);
    }
    for output in ["out.ply", "out.pvs", "data"] {
        assert!(
            !sandbox.path(output).exists(),
            "{output} was begun for a scene that cannot be used"
        );
    }
}

/// Runs a command that must reject `file`. It has to end with exit code 3, and a message with the file's
/// name, the fault and, after a semicolon, the remedy.
#[track_caller]
fn refused(sandbox: &Sandbox, command: &str, file: &str) {
    let run = sandbox.run(command).code(3);
    let said = run.err.trim();
    let Some((reason, remedy)) = said
        .strip_prefix("error: ")
        .and_then(|s| s.rsplit_once("; "))
    else {
        panic!("sightline {command} gives no remedy: {said}");
    };
    assert!(reason.starts_with(&format!("{file}: ")), "{said}");
    assert!(
        reason.len() > file.len() + 10 && remedy.len() > 10,
        "{said}"
    );
}

#[test]
fn huge_announced_counts_need_no_memory() {
    let sandbox = Sandbox::new();
    sandbox.write("vertices.ply", ply("binary_little_endian", 1 << 40, 1, b""));
    sandbox.write("count.glb", glb(&gltf(1 << 31, 36), &floats(&CORNERS)));
    for file in ["vertices.ply", "count.glb"] {
        // The address space of 400 MB is much smaller than the announcement of either file.
        let program = sightline_tests::program().display();
        let shell = format!("ulimit -v 400000; exec '{program}' mesh {file} -o out.ply");
        let run = std::process::Command::new("sh")
            .args(["-c", &shell])
            .current_dir(sandbox.path(""))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(3), "{file}: {said}");
        assert!(said.contains(file), "{said}");
    }
}

#[test]
fn wrong_usage_and_bad_input_have_different_codes() {
    let sandbox = Sandbox::new();
    sandbox.write("box.obj", "v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 3\n");
    let table = [
        "",
        "unknown",
        "bake",
        "bake box.obj",
        "bake box.obj -o out.pvs --cells 2x2",
        "bake box.obj -o out.pvs --cells 0x1x1",
        "bake box.obj -o out.pvs --cells 4294967295x4294967295x4294967295",
        "bake box.obj -o out.pvs --cells 2x2x2 --triangle-budget 10",
        "bake box.obj -o out.pvs --max-depth 3",
        "bake box.obj -o out.pvs --triangle-budget 10 --max-depth 4000000000",
        "bake box.obj -o out.pvs --resolution 4",
        "bake box.obj -o out.pvs --resolution 1000000",
        "bake box.obj -o out.pvs --error-threshold 2",
        "bake box.obj -o out.pvs --error-threshold nan",
        "bake box.obj -o out.pvs --backend quantum",
        "bake box.obj -o out.pvs --method exactly",
        "bake box.obj -o out.pvs --workers 0 --data-dir data --cells 1x1x1",
        "bake box.obj -o out.pvs --seed -1",
        "submit",
        "show",
        "show one",
        "fetch 1",
        "generate castle -o out.glb",
        "generate maze",
        "generate maze --grid 3 -o out.glb",
        "generate maze --grid 0x0 -o out.glb",
        "generate forest --trees 4294967295 --triangles-per-tree 4294967295 -o out.glb",
        "generate slits --slit-width 5 -o out.glb",
        "generate slits --slit-width nan -o out.glb",
        "coordinator --listen somewhere",
        "query out.pvs",
    ];
    for line in table {
        let run = sandbox.run(line).code(2);
        assert!(
            run.err.len() > 20,
            "sightline {line} says too little: {}",
            run.err
        );
        assert_eq!(run.out, "", "sightline {line}");
    }
    assert!(!sandbox.path("out.pvs").exists() && !sandbox.path("out.glb").exists());
    for line in ["--help", "--version", "bake --help", "help generate"] {
        assert!(sandbox.ok(line).contains("sightline"), "sightline {line}");
    }
}

#[test]
fn generated_scenes_depend_only_on_parameters() {
    let sandbox = Sandbox::new();
    let kinds = [
        "forest --trees 3 --triangles-per-tree 200",
        "town --triangles 2000",
        "rooms --triangles 1500",
        "rooms --grid 2x3",
        "maze --grid 3x4",
        "slits --grid 2x5 --slit-width 0.001",
    ];
    for kind in kinds {
        let make = |seed: u32, file: &str| {
            let told = sandbox.json(&format!("generate {kind} --seed {seed} -o {file}"));
            assert!(told["triangles"].as_u64().unwrap() > 0, "{told}");
            sandbox.read(file)
        };
        let first = make(1, "first.glb");
        assert_eq!(make(1, "second.glb"), first, "{kind}: the same seed");
        assert_ne!(make(2, "third.glb"), first, "{kind}: another seed");
        // The program can read the file that it wrote.
        sandbox.ok("mesh first.glb -o mesh.ply");
    }
}

#[test]
fn bake_rejects_scenes_that_no_tracer_supports() {
    let sandbox = Sandbox::new();
    let wide = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1e19 0 0\nf 1 2 3\nf 1 2 4\n";
    sandbox.write("wide.obj", wide);
    sandbox
        .run("bake wide.obj -o x.pvs")
        .code(3)
        .says("wide.obj: triangle 1, vertex 2")
        .says("±1e9");
    sandbox.write("tiny.obj", "v 0 0 0\nv 1e-20 0 0\nv 0 1e-20 0\nf 1 2 3\n");
    sandbox
        .run("bake tiny.obj -o x.pvs --backend cpu")
        .code(3)
        .says("tiny.obj")
        .says("1.1e-18");
}
