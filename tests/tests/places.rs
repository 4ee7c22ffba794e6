//! Tests of the restrictions of viewpoints: boxes, meshes, points and the space that points reach, from the
//! flags to results and measurements.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::fmt::Write as _;

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

    /// Adds the surface of a box, with the fronts outside.
    fn block(&mut self, name: &str, [x0, y0, z0]: [f32; 3], [x1, y1, z1]: [f32; 3]) {
        writeln!(self.text, "o {name}").unwrap();
        self.quad([[x0, y0, z0], [x0, y0, z1], [x0, y1, z1], [x0, y1, z0]]);
        self.quad([[x1, y0, z0], [x1, y1, z0], [x1, y1, z1], [x1, y0, z1]]);
        self.quad([[x0, y0, z0], [x1, y0, z0], [x1, y0, z1], [x0, y0, z1]]);
        self.quad([[x0, y1, z0], [x0, y1, z1], [x1, y1, z1], [x1, y1, z0]]);
        self.quad([[x0, y0, z0], [x0, y1, z0], [x1, y1, z0], [x1, y0, z0]]);
        self.quad([[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]]);
    }
}

/// Returns a closed hall of 8×2×2 with a thick wall across it at x = 3.6 to 4.4, with or without a door.
fn hall(door: bool) -> String {
    let mut o = Obj::default();
    o.block("hall", [0.0, 0.0, 0.0], [8.0, 2.0, 2.0]);
    match door {
        false => o.block("wall", [3.6, 0.0, 0.0], [4.4, 2.0, 2.0]),
        true => {
            o.block("wall", [3.6, 0.0, 0.0], [4.4, 2.0, 0.8]);
            o.block("other wall", [3.6, 0.0, 1.2], [4.4, 2.0, 2.0]);
        }
    }
    o.text
}

const CELLS: &str = "--cells 8x2x2 --view-box 0,0,0,8,2,2";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write("shut.obj", hall(false));
    sandbox.write("open.obj", hall(true));
    sandbox
}

/// Returns for each of the eight columns of cells along x true if any of its cells is reached.
fn columns(dump: &Dump) -> Vec<bool> {
    let column = |x: usize| dump.cells.iter().filter(move |c| c.min[0] as usize == x);
    (0..8).map(|x| column(x).any(|c| c.reached)).collect()
}

#[test]
fn only_reached_cells_are_baked() {
    let sandbox = sandbox();
    let reach = "--reachable-from 1,1,1";
    sandbox.ok(&format!(
        "bake shut.obj -o shut.pvs --data-dir a {CELLS} {reach} --workers 1"
    ));
    sandbox.ok(&format!(
        "bake shut.obj -o four.pvs --data-dir b {CELLS} {reach} --workers 4"
    ));
    assert_same(
        &sandbox.read("shut.pvs"),
        &sandbox.read("four.pvs"),
        "one worker and four",
    );
    sandbox.ok(&format!(
        "bake open.obj -o open.pvs --data-dir c {CELLS} {reach}"
    ));
    let [shut, open] = ["shut.pvs", "open.pvs"].map(|file| sandbox.dump(file));
    assert_eq!(
        columns(&shut),
        [true, true, true, true, false, false, false, false]
    );
    assert_eq!(columns(&open), [true; 8]);
    let info = sandbox.json("info shut.pvs");
    assert_eq!(
        (info["cells"].as_u64(), info["cells_reached"].as_u64()),
        (Some(32), Some(16))
    );
    sandbox
        .run("query shut.pvs 7 1 1")
        .code(3)
        .says("no viewpoint");
    // The viewpoints of a measurement are inside the hall and not in its wall.
    let report = sandbox.json("measure shut.obj shut.pvs --viewpoints 40 --resolution 32");
    assert_eq!(report["frames"], 40);
    assert!(report["mean_error"].as_f64().unwrap() < 1e-3, "{report}");
    // A cell may see cells without viewpoints, but not through the wall.
    let pairs = sandbox.json("query shut.pvs 1 1 1 --sees 7 1 1");
    assert_eq!(pairs["sees"], false);
    for (seed, why) in [
        ("4,1,1", "inside the closed surface"),
        ("9,1,1", "outside the view box"),
    ] {
        sandbox
            .run(&format!(
                "bake shut.obj -o x.pvs {CELLS} --reachable-from {seed}"
            ))
            .code(3)
            .says(why);
    }
}

#[test]
fn walls_restrict_viewpoints_within_cells() {
    let sandbox = sandbox();
    // The wall fills a part of both cells.
    let job = |file: &str, more: &str| {
        format!(
            "{file} --cells 2x1x1 --view-box 0,0,0,8,2,2 --reachable-from 1,1,1 --method exact {more}"
        )
    };
    let said = sandbox
        .run(&format!(
            "bake {} -o walls.pvs --data-dir a",
            job("shut.obj", "")
        ))
        .code(0);
    said.says("walls enclose the points");
    sandbox.ok(&format!(
        "bake {} -o whole.pvs --data-dir b",
        job("shut.obj", "--certificates")
    ));
    let [walls, whole] = ["walls.pvs", "whole.pvs"].map(|file| sandbox.dump(file));
    assert_eq!(
        [walls.cells[0].reached, walls.cells[1].reached],
        [true, false]
    );
    // The set contains five walls of the hall and one side of the wall across, with two triangles each.
    assert_eq!(
        walls.cells[0].visible.len(),
        12,
        "{:?}",
        walls.cells[0].visible
    );
    assert!(
        whole.cells[0].visible.len() > 12,
        "{:?}",
        whole.cells[0].visible
    );
    // The faces of the cells are in the planes of walls, and behind the walls is another triangle.
    let sky = "v 0 0 5\nv 8 0 5\nv 8 2 5\nv 0 2 5\nf -4 -3 -2 -1\n";
    // The fronts of the hall are inside. Otherwise its inside would count as the inside of a solid.
    let turned = |line: &str| match line.strip_prefix("f ") {
        Some(face) => format!("f {}", face.split(' ').rev().collect::<Vec<_>>().join(" ")),
        None => line.to_owned(),
    };
    let hall_text: Vec<String> = hall(false).lines().map(turned).collect();
    sandbox.write("sky.obj", hall_text.join("\n") + "\n" + sky);
    sandbox.ok(&format!(
        "bake {} -o sky.pvs --data-dir s",
        job("sky.obj", "")
    ));
    assert_eq!(
        sandbox.dump("sky.pvs").cells[0].visible,
        walls.cells[0].visible
    );
    sandbox
        .run("query walls.pvs 1 1 1")
        .code(0)
        .says("viewpoints that walls enclose");
    sandbox.ok("query walls.pvs 1 1 1 --scene shut.obj");
    sandbox
        .run("query walls.pvs 3.8 1 1 --scene shut.obj")
        .code(3)
        .says("outside the walls");
    let behind = sandbox.json("query walls.pvs 1 1 1 --why 15 --scene shut.obj");
    let front = sandbox.json("query walls.pvs 1 1 1 --why 12 --scene shut.obj");
    assert_eq!([&front["state"], &behind["state"]], ["visible", "hidden"]);
    let report = sandbox.json("measure shut.obj walls.pvs --viewpoints 40 --resolution 32");
    assert_eq!(
        (report["frames"].as_u64(), report["mean_error"].as_f64()),
        (Some(40), Some(0.0))
    );

    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let (_one, _two) = (coordinator.worker(), coordinator.worker());
    let id = coordinator.submit(&job("shut.obj", ""));
    assert_same(
        &coordinator.finish(id),
        &sandbox.read("walls.pvs"),
        "a cluster",
    );

    // Without the face at z = 2 a way out exists.
    let mut open: Vec<&str> = Vec::new();
    let text = hall(false);
    let roof = text
        .lines()
        .filter(|l| l.starts_with('f'))
        .nth(5)
        .unwrap()
        .to_owned();
    open.extend(text.lines().filter(|l| *l != roof));
    sandbox.write("roofless.obj", open.join("\n"));
    let said = sandbox
        .run(&format!(
            "bake {} -o out.pvs --data-dir c",
            job("roofless.obj", "")
        ))
        .code(0);
    said.says("no walls enclose the points")
        .says("narrowest opening, 2 wide");
}

#[test]
fn portals_command_reports_enclosure_and_way_out() {
    let sandbox = sandbox();
    let reach = "--reachable-from 1,1,1";
    let shut = sandbox.json(&format!("portals shut.obj {reach} -o cells.glb"));
    assert_eq!(
        (&shut["closed"], shut["reached"].as_u64()),
        (&true.into(), Some(1)),
        "{shut}"
    );
    assert!(
        (shut["share"].as_f64().unwrap() - 3.6 / 8.0).abs() < 1e-6,
        "{shut}"
    );
    assert!(shut["way_out"].is_null());
    let open = sandbox.json(&format!("portals open.obj {reach} -o cells.glb"));
    // The share excludes only the wall below and above the door.
    assert!(
        (open["share"].as_f64().unwrap() - (1.0 - 0.1 * 0.8)).abs() < 1e-6,
        "{open}"
    );
    assert!(open["portals"].as_u64().unwrap() >= 2, "{open}");
    sandbox.ok("bake cells.glb -o look.pvs --cells 1x1x1");
    let info = sandbox.ok("info look.pvs");
    assert!(info.contains("cell ") && info.contains("portal "), "{info}");
    // Without a point, the command finds both rooms and the inside of the wall.
    let spaces = sandbox.json("portals shut.obj");
    let shares: Vec<f64> = spaces["enclosed"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["share"].as_f64().unwrap())
        .collect();
    assert!(
        shares.len() >= 2 && (shares[0] - 0.45).abs() < 1e-6 && (shares[1] - 0.45).abs() < 1e-6
    );

    let mut roofless = Obj::default();
    roofless.quad([
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ]);
    roofless.quad([
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 0.0, 1.0],
        [0.0, 0.0, 1.0],
    ]);
    sandbox.write("roofless.obj", roofless.text);
    let found = sandbox.json("portals roofless.obj --reachable-from 0.5,0.5,0.5 -o cells.glb");
    assert_eq!(
        (&found["closed"], &found["share"]),
        (&false.into(), &serde_json::Value::Null)
    );
    assert!(
        found["reached"].as_u64() <= found["leaves"].as_u64(),
        "{found}"
    );
    assert!(
        found["way_out"]["narrowest"]["width"].as_f64().unwrap() > 0.5,
        "{found}"
    );
    sandbox
        .run("portals roofless.obj --reachable-from 5,5,5")
        .code(3)
        .says("outside the scene");
    sandbox.run("portals roofless.obj -o roofless.obj").code(2);
}

#[test]
fn exact_cells_without_viewpoints_are_empty_and_verified() {
    let sandbox = sandbox();
    let flags = format!("{CELLS} --reachable-from 1,1,1 --method exact --certificates");
    sandbox.ok(&format!("bake shut.obj -o exact.pvs --data-dir a {flags}"));
    let dump = sandbox.dump("exact.pvs");
    assert_eq!(
        columns(&dump),
        [true, true, true, true, false, false, false, false]
    );
    let report = sandbox.ok("verify shut.obj exact.pvs");
    assert!(
        report.contains("16 of the cells contain no viewpoint"),
        "{report}"
    );
}

#[test]
fn boxes_meshes_and_points_restrict_viewpoints() {
    let sandbox = sandbox();
    let bake = |name: &str, flags: &str| -> Vec<bool> {
        sandbox.ok(&format!(
            "bake open.obj -o {name}.pvs --data-dir {name} {flags}"
        ));
        columns(&sandbox.dump(&format!("{name}.pvs")))
    };
    let two = bake(
        "boxes",
        "--cells 8x2x2 --view-box 0,0,0,1,2,2 --view-box 7,0,0,8,2,2",
    );
    assert_eq!(two, [true, false, false, false, false, false, false, true]);
    // A closed volume in the fourth and fifth column, and an open one.
    let mut volume = Obj::default();
    volume.block("volume", [3.1, 0.2, 0.2], [4.9, 1.8, 1.8]);
    sandbox.write("volume.obj", &volume.text);
    let in_mesh = bake("mesh", &format!("{CELLS} --view-mesh volume.obj"));
    assert_eq!(
        in_mesh,
        [false, false, false, true, true, false, false, false]
    );
    let without_side = volume.text.rsplit_once("\nf ").unwrap().0;
    sandbox.write("unclosed.obj", format!("{without_side}\n"));
    sandbox
        .run(&format!(
            "bake open.obj -o x.pvs {CELLS} --view-mesh unclosed.obj"
        ))
        .code(3)
        .says("not closed");
    // A floor for walking in the first two columns. The eyes are in the upper half.
    let mut floor = Obj::default();
    floor.quad([
        [0.1, 0.0, 0.1],
        [1.9, 0.0, 0.1],
        [1.9, 0.0, 1.9],
        [0.1, 0.0, 1.9],
    ]);
    sandbox.write("floor.obj", floor.text);
    let walk = bake(
        "walk",
        &format!("{CELLS} --view-mesh floor.obj --eye-heights 1.3,1.6 --up y"),
    );
    assert_eq!(walk, [true, true, false, false, false, false, false, false]);
    let upper = sandbox
        .dump("walk.pvs")
        .cells
        .iter()
        .all(|c| !c.reached || c.min[1] >= 1.0);
    assert!(upper, "eyes are above the middle");
    assert_eq!(
        sandbox.json("info walk.pvs")["info"]["spec"]["visibility"]["up"],
        "y"
    );
    // Telemetry with one frequent, one rare and one unused viewpoint.
    sandbox.write("eyes.txt", "0.5 0.5 0.5 9\n2.5 0.5 0.5 1\n6.5 0.5 0.5 0\n");
    let points = bake("points", &format!("{CELLS} --viewpoints eyes.txt"));
    assert_eq!(
        points,
        [true, false, true, false, false, false, false, false]
    );
    let around = bake(
        "around",
        &format!("{CELLS} --viewpoints eyes.txt --reach 1.2"),
    );
    assert_eq!(around, [true, true, true, true, false, false, false, false]);
    let report =
        sandbox.json("measure open.obj around.pvs --viewpoints-file eyes.txt --resolution 32");
    assert_eq!(report["frames"], 2);
    assert!(report["mean_error"].as_f64().unwrap() < 1e-3);
    sandbox
        .run("measure open.obj points.pvs --viewpoints-file eyes.txt --resolution 16")
        .code(0);
    sandbox.write("far.txt", "99 0 0\n");
    sandbox
        .run(&format!(
            "bake open.obj -o x.pvs {CELLS} --viewpoints far.txt"
        ))
        .code(3)
        .says("view box");
    sandbox.write("bad.txt", "1 2\n");
    sandbox
        .run(&format!(
            "bake open.obj -o x.pvs {CELLS} --viewpoints bad.txt"
        ))
        .code(3)
        .says("line 1");
    sandbox
        .run("bake open.obj -o x.pvs --triangle-budget 10 --reachable-from 1,1,1")
        .code(2)
        .says("need a grid");
    let empty = sandbox
        .run("bake open.obj -o empty.pvs --data-dir e --cells 1x1x1 --view-box 20,20,20,21,21,21");
    empty.code(0).says("holds nothing");
}

#[test]
fn lines_end_at_maximum_distance() {
    let sandbox = sandbox();
    let seen = |name: &str, flags: &str| -> Vec<usize> {
        sandbox.ok(&format!(
            "bake open.obj -o {name}.pvs --data-dir {name} {CELLS} {flags}"
        ));
        sandbox
            .dump(&format!("{name}.pvs"))
            .cells
            .iter()
            .map(|c| c.visible.len())
            .collect()
    };
    let all = seen("all", "");
    for (name, sampler) in [
        ("lines", ""),
        ("guided", "--sampler guided"),
        ("cubes", "--sampler cubes --resolution 16"),
    ] {
        let near = seen(name, &format!("--far 0.9 {sampler}"));
        assert!(
            near.iter().zip(&all).all(|(near, all)| near <= all),
            "{name}"
        );
        // The distance between the first column of cells and the wall at the far end exceeds the limit.
        assert!(
            near.iter().sum::<usize>() < all.iter().sum::<usize>(),
            "{name}"
        );
        let report = sandbox.json(&format!(
            "measure open.obj {name}.pvs --viewpoints 40 --resolution 32"
        ));
        assert!(
            report["mean_error"].as_f64().unwrap() < 5e-3,
            "{name}: {report}"
        );
    }
    sandbox
        .run(&format!(
            "bake open.obj -o x.pvs {CELLS} --far 1 --method exact --certificates"
        ))
        .code(2)
        .says("certificates cannot be combined with far");
}

/// Tests marks of many cells, which exceed the maximum size of a job's record.
#[test]
fn scattered_viewpoints_are_baked_and_solids_hold_no_viewpoints() {
    let sandbox = sandbox();
    let points: String = (0..900)
        .map(|i| {
            format!(
                "{} {} {}\n",
                (i * 37 % 801) as f32 / 100.0,
                (i * 53 % 199) as f32 / 100.0,
                (i * 71 % 197) as f32 / 100.0
            )
        })
        .collect();
    sandbox.write("points.txt", points);
    let bake = "bake open.obj --view-box 0,0,0,8,2,2 --cells 16x8x8 --viewpoints points.txt \
                --target-error 0.01";
    sandbox.ok(&format!("{bake} -o many.pvs --data-dir many"));
    let dump = sandbox.dump("many.pvs");
    assert!(dump.cells.iter().any(|c| !c.visible.is_empty()));
    // Two boxes share a face, so that neither is a closed surface by itself.
    let mut o = Obj::default();
    o.block("hall", [0.0, 0.0, 0.0], [8.0, 2.0, 2.0]);
    o.block("pier", [3.0, 0.5, 0.5], [4.0, 1.5, 1.5]);
    o.block("lintel", [4.0, 0.5, 0.5], [5.0, 1.5, 1.5]);
    sandbox.write("piers.obj", o.text);
    let inside = sandbox
        .run(&format!(
            "bake piers.obj -o x.pvs {CELLS} --reachable-from 3.5,1,1"
        ))
        .code(3);
    inside.says("\"pier\"");
    sandbox.ok(&format!(
        "bake piers.obj -o y.pvs {CELLS} --reachable-from 1,1,1 --data-dir y"
    ));
}
