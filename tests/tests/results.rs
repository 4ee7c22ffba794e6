//! Tests of the content of a result: all commands agree, and a damaged file is rejected.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::collections::BTreeSet;

use serde_json::Value;
use sightline_tests::{Dump, Sandbox};

/// Returns a folder with `maze.glb` and its bake `maze.pvs`.
fn baked() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 3x3 -o maze.glb");
    bake(&sandbox, "maze.glb", "maze.pvs");
    sandbox
}

fn bake(sandbox: &Sandbox, scene: &str, result: &str) {
    let options = "--cells 3x2x2 --resolution 32 --backend cpu --data-dir data";
    sandbox.ok(&format!("bake {scene} {options} -o {result}"));
}

fn ids(value: &Value) -> Vec<u64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|id| id.as_u64().unwrap())
        .collect()
}

#[test]
fn info_dump_and_query_agree() {
    let sandbox = baked();
    let info = sandbox.json("info maze.pvs");
    let dump = sandbox.dump("maze.pvs");
    for key in [
        "format",
        "version",
        "triangles",
        "method",
        "cells",
        "view_box",
        "info",
    ] {
        assert_eq!(info[key], dump.header[key], "{key}");
    }
    assert_eq!(info["cells"], 12);
    assert_eq!(info["file_bytes"], sandbox.read("maze.pvs").len());
    let sizes: Vec<u64> = dump.cells.iter().map(|c| c.visible.len() as u64).collect();
    assert_eq!(info["min_visible"], *sizes.iter().min().unwrap());
    assert_eq!(info["max_visible"], *sizes.iter().max().unwrap());
    let mean = sizes.iter().sum::<u64>() as f64 / sizes.len() as f64;
    assert!((info["mean_visible"].as_f64().unwrap() - mean).abs() < 1e-9);
    assert_eq!(
        info["undecided"],
        dump.cells.iter().map(|c| c.undecided.len()).sum::<usize>()
    );

    for (i, cell) in dump.cells.iter().enumerate() {
        let [x, y, z] = cell.middle();
        let answer = sandbox.json(&format!("query maze.pvs {x} {y} {z}"));
        assert_eq!(answer["cell"], i);
        assert_eq!(answer["items"], "triangles");
        assert_eq!(ids(&answer["visible"]), cell.visible);
        assert_eq!(ids(&answer["undecided"]), cell.undecided);
    }
    // Without --json the ids are the last line.
    let [x, y, z] = dump.cells[0].middle();
    let text = sandbox.ok(&format!("query maze.pvs {x} {y} {z}"));
    let listed: Vec<u64> = text
        .lines()
        .last()
        .unwrap()
        .split(' ')
        .map(|id| id.parse().unwrap())
        .collect();
    assert_eq!(listed, dump.cells[0].visible);
}

#[test]
fn objects_cover_visible_triangles() {
    let sandbox = baked();
    let objects = sandbox.json("info maze.pvs")["objects"]
        .as_array()
        .unwrap()
        .clone();
    let number = |o: &Value, key: &str| o[key].as_u64().unwrap();
    // Objects cover the triangles without a gap, so each triangle belongs to one object.
    let end = objects.iter().fold(0, |next, o| {
        assert_eq!(number(o, "first"), next);
        next + number(o, "count")
    });
    let triangles = sandbox.dump("maze.pvs");
    assert_eq!(end, triangles.header["triangles"]);
    let object_of = |id: &u64| {
        objects.partition_point(|o| number(o, "first") + number(o, "count") <= *id) as u64
    };
    let by_object = Dump::parse(&sandbox.ok("dump maze.pvs --items objects"));
    assert_eq!(by_object.header["objects"], objects.len());
    for (a, b) in triangles.cells.iter().zip(&by_object.cells) {
        assert_eq!((a.min, a.max), (b.min, b.max));
        assert_eq!(
            a.visible.iter().map(object_of).collect::<BTreeSet<_>>(),
            b.visible.iter().copied().collect()
        );
        let [x, y, z] = b.middle();
        let answer = sandbox.json(&format!("query maze.pvs {x} {y} {z} --items objects"));
        assert_eq!(answer["items"], "objects");
        assert_eq!(ids(&answer["visible"]), b.visible);
    }
}

#[test]
fn object_with_witness_is_visible() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 300 -o rooms.glb");
    sandbox.ok("bake rooms.glb --cells 2x1x2 --method portals --data-dir data -o rooms.pvs");
    let objects = sandbox.json("info rooms.pvs")["objects"].clone();
    let object_of = |triangle: u64| {
        let holds = |o: &Value| {
            let first = o["first"].as_u64().unwrap();
            (first..first + o["count"].as_u64().unwrap()).contains(&triangle)
        };
        objects.as_array().unwrap().iter().position(holds).unwrap() as u64
    };
    let by_objects = Dump::parse(&sandbox.ok("dump rooms.pvs --items objects"));
    let mut mixed = 0;
    for (cell, listed) in sandbox
        .dump("rooms.pvs")
        .cells
        .iter()
        .zip(&by_objects.cells)
    {
        let drawn: BTreeSet<u64> = cell.visible.iter().map(|id| object_of(*id)).collect();
        let known = cell
            .visible
            .iter()
            .filter(|id| !cell.undecided.contains(id));
        let seen: BTreeSet<u64> = known.map(|id| object_of(*id)).collect();
        let open: BTreeSet<u64> = cell.undecided.iter().map(|id| object_of(*id)).collect();
        mixed += open.intersection(&seen).count();
        let undecided: Vec<u64> = open.difference(&seen).copied().collect();
        assert_eq!(listed.visible, drawn.into_iter().collect::<Vec<_>>());
        assert_eq!(listed.undecided, undecided);
        let [x, y, z] = cell.middle();
        let answer = sandbox.json(&format!("query rooms.pvs {x} {y} {z} --items objects"));
        assert_eq!(
            (ids(&answer["visible"]), ids(&answer["undecided"])),
            (listed.visible.clone(), undecided)
        );
    }
    assert!(
        mixed > 0,
        "no object has both a witness and an undecided triangle"
    );
}

#[test]
fn smallest_thresholds_reach_result() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 3x3 -o maze.glb");
    let bake = |options: &str| {
        let cubes =
            "--sampler cubes --cells 1x1x1 --view-box 0,0,0,4,4,4 --resolution 16 --backend cpu";
        sandbox.ok(&format!(
            "bake maze.glb {cubes} {options} --data-dir data -o cubes.pvs"
        ));
        sandbox.json("info cubes.pvs")["info"].clone()
    };
    let info = bake("--error-threshold 0 --interior-threshold 0");
    let cubes = &info["spec"]["visibility"]["aggressive"]["sampling"]["cubes"];
    assert_eq!(
        (&cubes["error_threshold"], &cubes["interior_threshold"]),
        (&0.0.into(), &0.0.into())
    );
    // Every face of the cell is split into 4x4 squares, with cubes at their corners. Faces are separate
    // tiles.
    let info = bake("--error-measure uniform --min-distance 0.25");
    assert_eq!(info["samples"], 6 * 5 * 5, "{info}");
}

#[test]
fn point_outside_view_box_has_no_answer() {
    let sandbox = baked();
    for point in ["0 0 1e6", "-1e6 1 1"] {
        sandbox
            .run(&format!("query maze.pvs {point}"))
            .code(3)
            .says("outside the view box")
            .says("maze.pvs");
    }
    for point in ["1 nan 1", "inf 1 1"] {
        sandbox
            .run(&format!("query maze.pvs {point}"))
            .code(3)
            .says("three finite numbers");
    }
    sandbox.run("query maze.pvs 1 2").code(2);
    sandbox
        .run("query maze.pvs 1 2 x")
        .code(2)
        .says("three numbers");
    sandbox
        .run("watch maze")
        .code(2)
        .says("give the number of a job");
}

#[test]
fn damaged_result_is_rejected() {
    let sandbox = baked();
    let whole = sandbox.read("maze.pvs");
    let lengths = (0..64)
        .chain((64..whole.len()).step_by(89))
        .chain([whole.len() - 1]);
    for length in lengths {
        sandbox.write("short.pvs", &whole[..length]);
        sandbox.run("info short.pvs").code(3).says("short.pvs");
    }
    for (i, at) in (0..whole.len()).step_by(97).enumerate() {
        let mut bad = whole.clone();
        bad[at] ^= 0xff;
        sandbox.write("bad.pvs", &bad);
        // The commands take turns.
        let command = ["info bad.pvs", "dump bad.pvs", "query bad.pvs 1 1 1"][i % 3];
        let refused = sandbox.run(command).code(3).says("bad.pvs");
        assert_eq!(
            refused.out, "",
            "nothing is shown of a result damaged at byte {at}"
        );
    }
    sandbox.write("long.pvs", [&whole[..], b"more"].concat());
    sandbox.run("info long.pvs").code(3);
}

#[test]
fn other_files_are_rejected_as_results() {
    let sandbox = baked();
    std::fs::copy(sandbox.path("maze.glb"), sandbox.path("scene.pvs")).unwrap();
    std::fs::create_dir(sandbox.path("folder.pvs")).unwrap();
    for file in ["scene.pvs", "maze.glb", "folder.pvs", "missing.pvs"] {
        for command in ["info", "dump"] {
            sandbox.run(&format!("{command} {file}")).code(3).says(file);
        }
        sandbox
            .run(&format!("query {file} 1 1 1"))
            .code(3)
            .says(file);
    }
}

#[test]
fn scene_and_its_mesh_have_same_triangles() {
    let sandbox = baked();
    sandbox.ok("mesh maze.glb -o mesh.ply");
    let triangles = read_mesh(&sandbox.read("mesh.ply"));
    let dump = sandbox.dump("maze.pvs");
    assert_eq!(triangles.len() as u64, dump.header["triangles"]);
    bake(&sandbox, "mesh.ply", "mesh.pvs");
    assert_eq!(sandbox.dump("mesh.pvs").cells, dump.cells);
    // The mesh of a mesh is the same mesh.
    sandbox.ok("mesh mesh.ply -o again.ply");
    assert_eq!(sandbox.read("again.ply"), sandbox.read("mesh.ply"));
}

#[test]
fn mesh_has_all_faces_in_order_of_file() {
    let sandbox = Sandbox::new();
    // A pentagon, relative indices, a degenerate face, and two groups: all faces become fans in order.
    let corners = [
        [0., 0., 0.],
        [2., 0., 0.25],
        [3., 1., 0.],
        [1., 3., 0.5],
        [-1., 1., 0.],
    ];
    let mut obj = String::from("# test\n");
    for [x, y, z] in corners {
        obj += &format!("v {x} {y} {z}\n");
    }
    obj += "g one\nf 1 2 3 4 5\ng two\nf -5/1 -4/1 -1/1\nf 1 1 2\n";
    sandbox.write("faces.obj", obj);
    sandbox.ok("mesh faces.obj -o faces.ply");
    let expected = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 1, 4], [0, 0, 1]];
    assert_eq!(
        read_mesh(&sandbox.read("faces.ply")),
        expected.map(|f| f.map(|i: usize| corners[i]))
    );
}

/// Returns the triangles of a binary PLY that has three vertices per triangle, with x, y, z as 32-bit floats.
fn read_mesh(bytes: &[u8]) -> Vec<[[f32; 3]; 3]> {
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let header = std::str::from_utf8(&bytes[..body]).unwrap();
    let lines: Vec<&str> = header
        .lines()
        .filter(|l| !l.starts_with("comment"))
        .collect();
    let number = |what: &str| -> usize {
        lines
            .iter()
            .find_map(|l| l.strip_prefix(what))
            .unwrap_or_else(|| panic!("{header}"))
            .trim()
            .parse()
            .unwrap()
    };
    let (vertices, faces) = (number("element vertex"), number("element face"));
    assert_eq!(vertices, faces * 3);
    assert_eq!(lines[..2], ["ply", "format binary_little_endian 1.0"]);
    let position = |p: &str| {
        lines
            .iter()
            .position(|l| l == &p)
            .unwrap_or_else(|| panic!("no '{p}' in {header}"))
    };
    let [x, y, z] = ["property float x", "property float y", "property float z"].map(position);
    assert!(x + 1 == y && y + 1 == z, "{header}");
    let list = lines
        .iter()
        .find(|l| l.starts_with("property list"))
        .unwrap();
    assert!(list.starts_with("property list uchar "), "{header}");

    let word = |at: usize| -> [u8; 4] { bytes[at..at + 4].try_into().unwrap() };
    let corner = |i: usize| -> [f32; 3] {
        std::array::from_fn(|axis| f32::from_le_bytes(word(body + i * 12 + axis * 4)))
    };
    let first = body + vertices * 12;
    assert_eq!(
        bytes.len(),
        first + faces * 13,
        "nothing but vertices and faces"
    );
    (0..faces)
        .map(|f| {
            assert_eq!(bytes[first + f * 13], 3);
            std::array::from_fn(|k| {
                let index = u32::from_le_bytes(word(first + f * 13 + 1 + k * 4));
                assert_eq!(
                    index as usize,
                    f * 3 + k,
                    "each triangle has its own vertices, in order"
                );
                corner(f * 3 + k)
            })
        })
        .collect()
}
