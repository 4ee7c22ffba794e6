//! Tests of blocking and showing kinds of triangles, from the file or the flags to results, measurements and
//! proofs.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::collections::BTreeSet;
use std::fmt::Write as _;

use serde_json::{Value, json};
use sightline_tests::{Dump, Sandbox, assert_same};

/// A builder of OBJ files.
#[derive(Default)]
struct Obj {
    text: String,
    vertices: usize,
}

impl Obj {
    fn quad(&mut self, corners: [[f32; 3]; 4]) {
        for [x, y, z] in corners {
            writeln!(self.text, "v {x} {y} {z}").unwrap();
        }
        let v = self.vertices;
        writeln!(self.text, "f {} {} {} {}", v + 1, v + 2, v + 3, v + 4).unwrap();
        self.vertices += 4;
    }

    fn part(&mut self, name: &str, material: &str) {
        writeln!(self.text, "o {name}\nusemtl {material}").unwrap();
    }

    /// Adds the part of the plane x = `x` between two corners (y, z).
    fn across(&mut self, x: f32, [y0, z0]: [f32; 2], [y1, z1]: [f32; 2]) {
        self.quad([[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]]);
    }

    fn block(&mut self, [x0, y0, z0]: [f32; 3], [x1, y1, z1]: [f32; 3]) {
        for x in [x0, x1] {
            self.across(x, [y0, z0], [y1, z1]);
        }
        for y in [y0, y1] {
            self.quad([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]);
        }
        for z in [z0, z1] {
            self.quad([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]);
        }
    }
}

/// Returns a closed room whose dividing wall has a window with a pane, with a second pane behind it, and a
/// crate behind both. The last twelve triangles are the crate's. The viewpoints are in front of the wall.
fn room() -> (String, u64) {
    let mut o = Obj::default();
    o.text.push_str("mtllib room.mtl\n");
    o.part("room", "wall");
    o.block([0.0, 0.0, 0.0], [8.0, 4.0, 4.0]);
    o.part("divider", "wall");
    for (from, to) in [
        ([0.0, 0.0], [4.0, 1.0]),
        ([0.0, 3.0], [4.0, 4.0]),
        ([0.0, 1.0], [1.0, 3.0]),
        ([3.0, 1.0], [4.0, 3.0]),
    ] {
        o.across(4.0, from, to);
    }
    o.part("pane", "glass");
    o.across(4.0, [1.0, 1.0], [3.0, 3.0]);
    o.part("second pane", "glass");
    o.across(5.0, [0.0, 0.0], [4.0, 4.0]);
    let before = o.vertices as u64 / 4 * 2;
    o.part("crate", "wood");
    // The coordinates are not round numbers, so that rays of cubes do not meet edges exactly.
    o.block([6.03, 1.57, 1.49], [7.01, 2.43, 2.52]);
    (o.text, before)
}

const MTL: &str = "newmtl wall\nnewmtl wood\nnewmtl glass\nd 0.2\n";
const JOB: &str = "room.obj --cells 2x2x2 --view-box 0.5,0.5,0.5,3.5,3.5,3.5";

fn sandbox() -> (Sandbox, u64) {
    let sandbox = Sandbox::new();
    let (text, before) = room();
    sandbox.write("room.obj", text);
    sandbox.write("room.mtl", MTL);
    (sandbox, before)
}

fn shown(dump: &Dump) -> Vec<BTreeSet<u64>> {
    dump.cells
        .iter()
        .map(|c| c.visible.iter().copied().collect())
        .collect()
}

#[test]
fn methods_samplers_and_backends_see_through_glass() {
    let (sandbox, before) = sandbox();
    let bake = |name: &str, flags: &str| {
        sandbox
            .run(&format!(
                "bake {JOB} -o {name}.pvs --data-dir {name} {flags}"
            ))
            .code(0);
        shown(&sandbox.dump(&format!("{name}.pvs")))
    };
    let exact = bake("exact", "--method exact --certificates");
    assert!(
        exact.iter().all(|cell| cell.iter().any(|t| *t >= before)),
        "the crate is seen"
    );
    sandbox.ok("verify room.obj exact.pvs");
    let ways = [
        ("lines", "--complete off --backend cpu"),
        // Along a ray that meets an edge within rounding, either of its faces can be the nearest, also the
        // hidden one. With this seed no ray does.
        ("guided", "--backend cpu --sampler guided --seed 4"),
        ("cubes", "--backend cpu --sampler cubes --resolution 64"),
        ("bound", "--complete off --backend cpu --max-error 0.01"),
        ("lines-gpu", "--complete off --backend gpu"),
        ("cubes-gpu", "--backend gpu --sampler cubes --resolution 32"),
        ("verified", "--method verified"),
    ];
    for (name, flags) in ways {
        let sampled = bake(name, flags);
        for (cell, (sampled, exact)) in sampled.iter().zip(&exact).enumerate() {
            let extra: Vec<_> = sampled.difference(exact).collect();
            assert!(
                extra.is_empty(),
                "{name}, cell {cell}: {extra:?} are hidden"
            );
            let missed: Vec<_> = exact.difference(sampled).collect();
            // All objects are large, but a coarse bound and coarse cubes may miss the crate's thin sides.
            let coarse = name.starts_with("cubes") || name == "bound";
            assert!(
                missed.is_empty() || coarse,
                "{name}, cell {cell}: {missed:?} missed"
            );
            assert!(
                sampled.iter().any(|t| *t >= before),
                "{name}: the crate is seen"
            );
        }
        let report = sandbox.json(&format!(
            "measure room.obj {name}.pvs --viewpoints 8 --resolution 64"
        ));
        assert!(
            report["mean_error"].as_f64().unwrap() < 1e-3,
            "{name}: {report}"
        );
    }
    // The same file with all triangles opaque, by a flag: no triangle behind the window is visible, and the
    // measurement agrees.
    let opaque = bake("opaque", "--complete off --opaque");
    assert!(
        opaque.iter().all(|cell| cell.iter().all(|t| *t < before)),
        "the crate is hidden"
    );
    assert!(
        opaque.iter().zip(&exact).all(|(o, e)| o.is_subset(e)),
        "see-through never hides"
    );
    let report = sandbox.json("measure room.obj opaque.pvs --viewpoints 8 --resolution 64");
    assert_eq!(
        report["mean_error"], 0.0,
        "measured with the flags of the result"
    );
}

#[test]
fn flags_override_file_and_results_name_flags() {
    let (sandbox, before) = sandbox();
    let exact = |name: &str, flags: &str| {
        let line = format!(
            "bake {JOB} -o {name}.pvs --data-dir {name} --method exact --certificates {flags}"
        );
        let run = sandbox.run(&line).code(0);
        (shown(&sandbox.dump(&format!("{name}.pvs"))), run.err)
    };
    // An occluder-only wall blocks and is in no set; a moving pane does not block and is in no set.
    let (sets, said) = exact(
        "proxy",
        "--occluder-only divider --moving pane* --see-through second*",
    );
    assert!(
        said.contains("occluder-only: 8 triangles (8 --occluder-only divider)"),
        "{said}"
    );
    for set in &sets {
        assert!(
            (12..20).all(|t| !set.contains(&t)),
            "the divider is in no set"
        );
        assert!((20..22).all(|t| !set.contains(&t)), "nor the moving pane");
        assert!(
            set.iter().any(|t| *t >= before),
            "the crate is seen through the window"
        );
    }
    sandbox.ok("verify room.obj proxy.pvs");
    let why = sandbox.ok("query proxy.pvs 1 1 1 --why 13 --scene room.obj");
    assert!(
        why.contains("in no set, because it is occluder-only"),
        "{why}"
    );
    let info = sandbox.json("info proxy.pvs");
    assert_eq!(info["info"]["kinds"]["rules"][1]["glob"], "pane*", "{info}");
    // Other flags are another scene, and a result of another scene is rejected.
    sandbox
        .run("verify room.obj proxy.pvs --opaque")
        .code(3)
        .says("other flags");
    // A moving crate is in no set. A glob without a match causes a warning with similar names.
    let (sets, said) = exact("moving", "--moving crate --see-through glas");
    assert!(sets.iter().all(|set| set.iter().all(|t| *t < before)));
    assert!(
        said.contains("\"glas\" matches no object and no material; similar names: glass"),
        "{said}"
    );
    sandbox
        .run(&format!("bake {JOB} -o x.pvs --see-through a["))
        .code(2)
        .says("a[");
    // Sight lines between polygons pass glass, unless a flag makes it opaque.
    let triangle = |x: f32| format!("[[{x},1.9,1.9],[{x},2.1,1.9],[{x},2.1,2.1]]");
    sandbox.write(
        "q.jsonl",
        format!(r#"{{"id":1,"a":{},"b":{}}}"#, triangle(1.0), triangle(5.9)),
    );
    let line = "sightlines room.obj --queries q.jsonl --check";
    assert!(sandbox.ok(line).contains("\"visible\""));
    assert!(
        sandbox
            .ok(&format!("{line} --opaque"))
            .contains("\"hidden\"")
    );
}

/// Returns the JSON and the binary chunk of a GLB.
fn parts(glb: &[u8]) -> (Value, Vec<u8>) {
    let length = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    let end = 20 + length(12);
    (
        serde_json::from_slice(&glb[20..end]).unwrap(),
        glb[end + 8..end + 8 + length(end)].to_vec(),
    )
}

/// Writes a GLB of JSON and a binary chunk, whose length is a multiple of four.
fn glb(json: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + text.len() as u32 + binary.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text[..]), (b"BIN\0", binary)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

#[test]
fn hidden_node_neither_shows_nor_blocks_in_any_method() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 --seed 5 -o town.glb");
    let (mut json, binary) = parts(&sandbox.read("town.glb"));
    let nodes = json["nodes"].as_array_mut().unwrap();
    let house = nodes.iter_mut().find(|n| n["name"] == "house 0").unwrap();
    house["extensions"] = json!({"KHR_node_visibility": {"visible": false}});
    for (list, name) in [
        ("extensionsUsed", "used.glb"),
        ("extensionsRequired", "required.glb"),
    ] {
        let mut json = json.clone();
        json[list] = json!(["KHR_node_visibility"]);
        sandbox.write(name, glb(&json, &binary));
    }
    let bake = |scene: &str, name: &str, flags: &str| {
        let backend = if flags.contains("portals") {
            ""
        } else {
            "--backend cpu"
        };
        let job = format!("--cells 2x1x2 {backend}");
        let run = sandbox
            .run(&format!("bake {scene} -o {name}.pvs {job} {flags}"))
            .code(0);
        (sandbox.dump(&format!("{name}.pvs")), run.err)
    };
    let (plain, _) = bake("town.glb", "plain", "--method exact");
    let info = sandbox.json("info plain.pvs");
    let triangles_of = |o: &Value| {
        o["first"].as_u64().unwrap()..o["first"].as_u64().unwrap() + o["count"].as_u64().unwrap()
    };
    let objects = info["objects"].as_array().unwrap();
    let ids = triangles_of(
        objects
            .iter()
            .find(|o| o["name"].as_str().unwrap().starts_with("house 0/"))
            .unwrap(),
    );
    assert!(
        shown(&plain)
            .iter()
            .any(|set| set.range(ids.clone()).next().is_some()),
        "the house is seen"
    );
    let mut more = 0;
    for (method, flags) in [
        ("exact", "--method exact --certificates"),
        ("lines", "--target-error 0.0001"),
        ("cubes", "--sampler cubes --resolution 32"),
        ("portals", "--method portals"),
    ] {
        let (hidden, said) = bake("used.glb", "hidden", flags);
        assert!(
            said.contains(&format!("hidden: {} triangles", ids.end - ids.start)),
            "{said}"
        );
        assert!(!said.contains("the file uses the extension"), "{said}");
        assert!(
            shown(&hidden)
                .iter()
                .all(|set| set.range(ids.clone()).next().is_none()),
            "{method}"
        );
        // The object as one that neither blocks nor shows, by a flag.
        let (moving, _) = bake("town.glb", "moving", &format!("{flags} --moving house?0"));
        assert_eq!(shown(&hidden), shown(&moving), "{method}");
        let (required, _) = bake("required.glb", "required", flags);
        assert_eq!(shown(&hidden), shown(&required), "{method}");
        if method == "exact" {
            for (with, without) in shown(&plain).iter().zip(shown(&hidden)) {
                let lost: Vec<_> = with
                    .difference(&without)
                    .filter(|t| !ids.contains(t))
                    .collect();
                assert!(lost.is_empty(), "{lost:?} are hidden by a hidden node");
                more += without.difference(with).count();
            }
            sandbox.ok("verify used.glb hidden.pvs");
            let report = sandbox.json("measure used.glb hidden.pvs --viewpoints 8 --resolution 64");
            assert_eq!(report["mean_error"], 0.0, "{report}");
            let why = sandbox.ok(&format!(
                "query hidden.pvs --cell 0 --why {} --scene used.glb",
                ids.start
            ));
            assert!(
                why.contains("switched off by the scene's file (KHR_node_visibility)"),
                "{why}"
            );
            // The ids and the list of objects do not change.
            assert_eq!(sandbox.json("info hidden.pvs")["objects"], info["objects"]);
            sandbox.ok("export hidden.pvs --format gltf --scene used.glb -o seen.glb");
            let (seen, _) = parts(&sandbox.read("seen.glb"));
            assert_eq!(
                seen["nodes"], json["nodes"],
                "the file still hides the node"
            );
            let used = json!(["KHR_node_visibility", "SIGHTLINE_visibility"]);
            assert_eq!(seen["extensionsUsed"], used);
        } else if method == "lines" {
            let report = sandbox.json("measure used.glb hidden.pvs --viewpoints 8 --resolution 64");
            assert!(report["mean_error"].as_f64().unwrap() < 1e-3, "{report}");
        }
    }
    assert!(
        more > 0,
        "the house hides something, so without it more is seen"
    );
    // The node is hidden in point queries, too.
    sandbox.ok("tetra used.glb -o used.tets");
    let [x, y, z] = [0, 1, 2].map(|a| info["view_box"]["max"][a].as_f64().unwrap() / 2.0 + 0.013);
    sandbox.write("p.jsonl", format!("{{\"id\":1,\"point\":[{x},{y},{z}]}}\n"));
    let seen: Value =
        serde_json::from_str(sandbox.ok("look used.tets --points p.jsonl").trim()).unwrap();
    let visible = seen["visible"].as_array().unwrap();
    assert!(
        !visible.is_empty() && visible.iter().all(|t| !ids.contains(&t.as_u64().unwrap())),
        "{seen}"
    );
}

#[test]
fn cluster_gives_bytes_of_bake() {
    let (sandbox, _) = sandbox();
    let flags = "--backend cpu --see-through divider --target-error 0.01";
    sandbox.ok(&format!("bake {JOB} {flags} -o alone.pvs --data-dir alone"));
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let worker = coordinator.worker();
    let job = coordinator.submit(&format!("{JOB} {flags}"));
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "cluster",
    );
    drop(worker);
}

#[test]
fn opaque_scene_is_reported_and_missing_library_is_warning() {
    let (sandbox, _) = sandbox();
    std::fs::remove_file(sandbox.path("room.mtl")).unwrap();
    sandbox
        .run(&format!(
            "bake {JOB} -o a.pvs --data-dir d --target-error 0.05"
        ))
        .code(0)
        .says("room.mtl\" is missing")
        .says("all triangles are opaque");
    assert!(
        sandbox
            .ok("info a.pvs")
            .contains("all triangles are opaque")
    );
}
