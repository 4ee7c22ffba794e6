//! Tests of alpha textures from the file to results and measurements, with a fence of which half the texels
//! are open.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::collections::BTreeSet;

use serde_json::{Value, json};
use sightline_tests::{Sandbox, assert_same};

/// The job. Its viewpoints are in front of the closed half of the fence.
const JOB: &str = "room.gltf --cells 2x1x2 --view-box 0.5,2.4,0.5,3.5,3.6,3.5";

/// The ids of the triangles, in the order of [`room`]. Behind the fence are the far wall and two plates. One
/// plate is behind the open half of the fence, where y is below 2. The other one is close behind the closed
/// half, so that no line from the viewpoints through the open half reaches it.
const ROOM: u64 = 10;
const FENCE: std::ops::Range<u64> = 10..12;
const FAR: std::ops::Range<u64> = 12..14;
const LOW: std::ops::Range<u64> = 14..16;
const HIGH: std::ops::Range<u64> = 16..18;

/// Writes a closed room that a fence divides, as a glTF file with a separate buffer and texture.
fn room(sandbox: &Sandbox, alpha: &[u8]) {
    let across = |x: f32, [y0, y1]: [f32; 2], [z0, z1]: [f32; 2]| {
        [[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]]
    };
    let (all, inside) = ([0.0, 4.0], [1.0, 3.0]);
    let near: Vec<[[f32; 3]; 4]> = vec![
        across(0.0, all, all),
        [
            [0.0, 0.0, 0.0],
            [8.0, 0.0, 0.0],
            [8.0, 0.0, 4.0],
            [0.0, 0.0, 4.0],
        ],
        [
            [0.0, 4.0, 0.0],
            [8.0, 4.0, 0.0],
            [8.0, 4.0, 4.0],
            [0.0, 4.0, 4.0],
        ],
        [
            [0.0, 0.0, 0.0],
            [8.0, 0.0, 0.0],
            [8.0, 4.0, 0.0],
            [0.0, 4.0, 0.0],
        ],
        [
            [0.0, 0.0, 4.0],
            [8.0, 0.0, 4.0],
            [8.0, 4.0, 4.0],
            [0.0, 4.0, 4.0],
        ],
    ];
    let fence = vec![across(4.0, all, all)];
    let behind = vec![
        across(8.0, all, all),
        across(4.1, [0.5, 1.5], inside),
        across(4.1, [2.5, 3.5], inside),
    ];
    let mut bytes: Vec<u8> = Vec::new();
    let (mut views, mut accessors, mut nodes, mut meshes) = (vec![], vec![], vec![], vec![]);
    let mut accessor = |numbers: &[f32], shape: &str, each: usize| {
        views
            .push(json!({"buffer": 0, "byteOffset": bytes.len(), "byteLength": 4 * numbers.len()}));
        bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        let (view, count) = (views.len() - 1, numbers.len() / each);
        accessors.push(
            json!({"bufferView": view, "componentType": 5126, "count": count, "type": shape}),
        );
        accessors.len() - 1
    };
    for (name, material, quads) in [
        ("near", 0, near),
        ("fence", 1, fence),
        ("behind", 0, behind),
    ] {
        let corners: Vec<[f32; 3]> = quads
            .iter()
            .flat_map(|q| [0, 1, 2, 0, 2, 3].map(|c| q[c]))
            .collect();
        let uv: Vec<f32> = corners
            .iter()
            .flat_map(|p| [p[1] / 4.0, p[2] / 4.0])
            .collect();
        let (position, uv) = (
            accessor(corners.as_flattened(), "VEC3", 3),
            accessor(&uv, "VEC2", 2),
        );
        let attributes = json!({"POSITION": position, "TEXCOORD_0": uv});
        nodes.push(json!({"name": name, "mesh": meshes.len()}));
        meshes.push(json!({"primitives": [{"attributes": attributes, "material": material}]}));
    }
    let file: Value = json!({
        "asset": {"version": "2.0"}, "nodes": nodes, "meshes": meshes, "accessors": accessors,
        "materials": [
            {"name": "brick"},
            {"name": "wire", "alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
        ],
        "textures": [{"source": 0}], "images": [{"uri": "fence.png"}],
        "bufferViews": views, "buffers": [{"uri": "room.bin", "byteLength": bytes.len()}],
    });
    let mut image = Vec::new();
    let mut encoder = png::Encoder::new(&mut image, alpha.len() as u32, 1);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    let texels: Vec<u8> = alpha.iter().flat_map(|a| [0, *a]).collect();
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&texels)
        .unwrap();
    sandbox.write("room.gltf", file.to_string());
    sandbox.write("room.bin", &bytes);
    sandbox.write("fence.png", image);
}

/// Bakes the job. Returns the set of each cell.
fn bake(sandbox: &Sandbox, name: &str, flags: &str) -> Vec<BTreeSet<u64>> {
    sandbox
        .run(&format!(
            "bake {JOB} -o {name}.pvs --data-dir {name} {flags}"
        ))
        .code(0);
    let dump = sandbox.dump(&format!("{name}.pvs"));
    dump.cells
        .iter()
        .map(|c| c.visible.iter().copied().collect())
        .collect()
}

fn set(parts: &[std::ops::Range<u64>]) -> BTreeSet<u64> {
    (0..ROOM).chain(parts.iter().cloned().flatten()).collect()
}

#[test]
fn fence_shows_triangles_behind_open_half() {
    let sandbox = Sandbox::new();
    room(&sandbox, &[0, 0, 255, 255]);
    let truth = set(&[FENCE, FAR, LOW]);
    let ways = [
        ("lines", "--backend cpu"),
        ("guided", "--backend cpu --sampler guided"),
        ("cubes", "--backend cpu --sampler cubes --resolution 64"),
        ("bound", "--backend cpu --max-error 0.01"),
        ("tree", "--backend cpu --triangle-budget 1000"),
        ("lines-gpu", "--backend gpu"),
        ("cubes-gpu", "--backend gpu --sampler cubes --resolution 32"),
    ];
    for (name, flags) in ways {
        let job = if name == "tree" {
            JOB.replace("--cells 2x1x2 ", "")
        } else {
            JOB.to_owned()
        };
        let run = format!("bake {job} -o {name}.pvs --data-dir {name} --alpha-textures {flags}");
        sandbox
            .run(&run)
            .code(0)
            .says("masked: 2 triangles (2 alphaMode MASK)");
        for (at, cell) in sandbox
            .dump(&format!("{name}.pvs"))
            .cells
            .iter()
            .enumerate()
        {
            let set: BTreeSet<u64> = cell.visible.iter().copied().collect();
            assert_eq!(set, truth, "{name}, cell {at}");
        }
        // The measurement reads the scene like the bake, and agrees.
        let report = sandbox.json(&format!(
            "measure room.gltf {name}.pvs --viewpoints 8 --resolution 64"
        ));
        assert_eq!(report["mean_error"], 0.0, "{name}: {report}");
    }
    assert!(
        sandbox
            .ok("info lines.pvs")
            .contains("masked: 2 triangles (2 alphaMode MASK)")
    );
    // Without the flag the whole fence is see-through, and its texture is not read.
    std::fs::remove_file(sandbox.path("fence.png")).unwrap();
    let whole = bake(&sandbox, "whole", "--backend cpu");
    assert!(
        whole
            .iter()
            .all(|cell| *cell == set(&[FENCE, FAR, LOW, HIGH])),
        "{whole:?}"
    );
    sandbox
        .run(&format!(
            "bake {JOB} -o x.pvs --data-dir x --alpha-textures"
        ))
        .code(3)
        .says("material 1 (wire), texture 0, image 0 (fence.png)")
        .says("omit --alpha-textures");
}

#[test]
fn closed_fence_blocks_and_open_fence_is_invisible() {
    let sandbox = Sandbox::new();
    room(&sandbox, &[255; 4]);
    let closed = bake(&sandbox, "closed", "--backend cpu --alpha-textures");
    assert!(
        closed.iter().all(|cell| *cell == set(&[FENCE])),
        "{closed:?}"
    );
    assert!(
        sandbox
            .ok("info closed.pvs")
            .contains("2 alphaMode MASK, opaque everywhere")
    );
    // No texture has to be read, so exact methods accept the fence like any wall.
    let exact = bake(
        &sandbox,
        "exact",
        "--method exact --certificates --alpha-textures",
    );
    assert_eq!(exact, closed);
    for name in ["closed", "exact"] {
        let report = sandbox.json(&format!(
            "measure room.gltf {name}.pvs --viewpoints 8 --resolution 64"
        ));
        assert_eq!(report["mean_error"], 0.0, "{report}");
    }
    sandbox.ok("verify room.gltf exact.pvs");
    room(&sandbox, &[0; 4]);
    let open = bake(&sandbox, "open", "--backend cpu --alpha-textures");
    assert!(
        open.iter().all(|cell| *cell == set(&[FAR, LOW, HIGH])),
        "{open:?}"
    );
    let report = sandbox.json("measure room.gltf open.pvs --viewpoints 8 --resolution 64");
    assert_eq!(report["mean_error"], 0.0, "{report}");
    // A result belongs to one texture.
    sandbox
        .run("measure room.gltf closed.pvs --viewpoints 1")
        .code(3)
        .says("another scene");
    // A flag about a name overrides the texture.
    let ruled = bake(
        &sandbox,
        "ruled",
        "--backend cpu --alpha-textures --opaque wire",
    );
    assert!(ruled.iter().all(|cell| *cell == set(&[FENCE])), "{ruled:?}");
}

#[test]
fn same_job_gives_same_bytes_in_process_and_cluster() {
    let sandbox = Sandbox::new();
    room(&sandbox, &[0, 255, 0, 255]);
    let flags = "--backend cpu --alpha-textures --target-error 0.01 --block-cells 1";
    sandbox.ok(&format!(
        "bake {JOB} {flags} -o one.pvs --data-dir one --workers 1"
    ));
    sandbox.ok(&format!(
        "bake {JOB} {flags} -o four.pvs --data-dir four --workers 4"
    ));
    let one = sandbox.read("one.pvs");
    assert_same(&one, &sandbox.read("four.pvs"), "workers");
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let worker = coordinator.worker();
    let job = coordinator.submit(&format!("{JOB} {flags}"));
    assert_same(&coordinator.finish(job), &one, "cluster");
    drop(worker);
}

#[test]
fn exact_queries_reject_masks_with_remedy() {
    let sandbox = Sandbox::new();
    room(&sandbox, &[0, 0, 255, 255]);
    for method in ["exact", "verified"] {
        sandbox
            .run(&format!(
                "bake {JOB} -o x.pvs --data-dir x --alpha-textures --method {method}"
            ))
            .code(2)
            .says("exact queries do not read alpha textures; omit --alpha-textures");
    }
    sandbox.write("q.jsonl", "");
    sandbox
        .run("sightlines room.gltf --queries q.jsonl --alpha-textures")
        .code(2)
        .says("exact queries");
    bake(
        &sandbox,
        "a",
        "--backend cpu --alpha-textures --target-error 0.05",
    );
    sandbox
        .run("query a.pvs 1 3 1 --why 12 --scene room.gltf")
        .code(2)
        .says("exact queries");
    sandbox
        .run("verify room.gltf a.pvs")
        .code(3)
        .says("has no certificates");
    // A scene without masks causes a warning, and has the same bytes as without the flag.
    sandbox.ok("generate rooms -o plain.glb --triangles 1000");
    let line = "bake plain.glb --cells 1x1x1 --target-error 0.05 --backend cpu --data-dir";
    sandbox
        .run(&format!("{line} p -o p.pvs --alpha-textures"))
        .code(0)
        .says("--alpha-textures has no effect");
    sandbox.ok(&format!("{line} q -o q.pvs"));
    assert_same(
        &sandbox.read("p.pvs"),
        &sandbox.read("q.pvs"),
        "without masks",
    );
}
