//! `sightline diff`: what came into sets and what went, told from the noise of sampling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::json;
use sightline_tests::Sandbox;

/// Two rooms with a wall at x = 2 that has a door of the given width, and a shelf in the second.
fn house(door: f32) -> String {
    let mut out = String::new();
    let mut count = 0;
    let mut quad = |name: &str, corners: [[f32; 3]; 4]| {
        out.push_str(&format!("o {name}\n"));
        corners.iter().for_each(|[x, y, z]| out.push_str(&format!("v {x} {y} {z}\n")));
        let [a, b, c, d] = [1, 2, 3, 4].map(|k| count + k);
        out.push_str(&format!("f {a} {b} {c}\nf {a} {c} {d}\n"));
        count += 4;
    };
    for (name, y) in [("floor", 0.0), ("ceiling", 2.0)] {
        quad(name, [[0.0, y, 0.0], [4.0, y, 0.0], [4.0, y, 2.0], [0.0, y, 2.0]]);
    }
    for (name, z) in [("north", 0.0), ("south", 2.0)] {
        quad(name, [[0.0, 0.0, z], [4.0, 0.0, z], [4.0, 2.0, z], [0.0, 2.0, z]]);
    }
    for (name, x) in [("west", 0.0), ("east", 4.0)] {
        quad(name, [[x, 0.0, 0.0], [x, 2.0, 0.0], [x, 2.0, 2.0], [x, 0.0, 2.0]]);
    }
    quad("wall", [[2.0, 0.0, door], [2.0, 2.0, door], [2.0, 2.0, 2.0], [2.0, 0.0, 2.0]]);
    quad("shelf", [[3.0, 0.5, 0.5], [3.5, 0.5, 0.5], [3.5, 0.5, 1.0], [3.0, 0.5, 1.0]]);
    out
}

const CELLS: &str = "--backend cpu --view-box 0.25,0.25,0.25,3.65,1.75,1.75 --cells 2x1x1";

#[test]
fn what_came_and_went_is_counted_and_can_fail() {
    let sandbox = Sandbox::new();
    for (name, door) in [("shut", 0.0), ("open", 1.0)] {
        sandbox.write(&format!("{name}.obj"), house(door));
        sandbox.ok(&format!("bake {name}.obj -o {name}.pvs --method exact {CELLS}"));
    }
    let same = sandbox.json("diff shut.pvs shut.pvs --fail-above 0");
    assert_eq!((&same["changed_cells"], &same["changed_fraction"]), (&json!(0), &json!(0.0)));
    let changed = sandbox.json("diff shut.pvs open.pvs");
    // The shelf and the wall's far end come into the first room's set.
    assert_eq!((&changed["cells"], &changed["changed_cells"]), (&json!(2), &json!(1)));
    let shelf = changed["objects"].as_array().unwrap().iter().find(|o| o["object"] == "shelf").unwrap();
    assert_eq!((&shelf["came_in_cells"], &shelf["went_in_cells"]), (&json!(1), &json!(0)));
    let back = sandbox.json("diff open.pvs shut.pvs");
    assert_eq!((&back["came"], &back["went"]), (&changed["went"], &changed["came"]));
    sandbox.run("diff shut.pvs open.pvs --fail-above 0.5").code(0);
    sandbox.run("diff shut.pvs open.pvs --fail-above 0.001").code(6).says("--fail-above");
    let words = sandbox.ok("diff shut.pvs open.pvs");
    assert!(words.contains("1 of 2 cells changed") && words.contains("both results are exact"), "{words}");
    let markdown = sandbox.ok("diff shut.pvs open.pvs --markdown");
    assert!(markdown.contains("| shelf | 1 | 0 |"), "{markdown}");
    // By name, when the triangles are others.
    let without = house(1.0).replace("o shelf", "o board");
    sandbox.write("other.obj", without);
    sandbox.ok(&format!("bake other.obj -o other.pvs --method exact {CELLS}"));
    let named = sandbox.json("diff open.pvs other.pvs");
    assert_eq!(named["items"], "objects");
    let names: Vec<&str> =
        named["objects"].as_array().unwrap().iter().map(|o| o["object"].as_str().unwrap()).collect();
    assert_eq!(names, ["board", "shelf"]);
    sandbox.ok("bake open.obj -o fine.pvs --backend cpu --cells 2x2x1");
    sandbox.run("diff open.pvs fine.pvs").code(3).says("other cells");
}

#[test]
fn the_noise_of_sampling_is_told_from_a_change() {
    let sandbox = Sandbox::new();
    let sampled = "--max-error 0.002 --contributions --cells 3x1x2 --backend cpu";
    sandbox.ok("generate rooms --grid 3x2 --triangles 3000 -o rooms.glb");
    for seed in [1, 2] {
        sandbox.ok(&format!("bake rooms.glb -o seed-{seed}.pvs --seed {seed} {sampled}"));
    }
    let noise = sandbox.json("diff seed-1.pvs seed-2.pvs");
    assert!(noise["changed_cells"].as_u64().unwrap() > 0, "two seeds differ: {noise}");
    assert_eq!(noise["cells_beyond_noise"], 0, "{noise}");
    // Furniture that shows everything behind it.
    sandbox.ok(&format!("bake rooms.glb -o glass.pvs --see-through *wall* --seed 1 {sampled}"));
    let change = sandbox.json("diff seed-1.pvs glass.pvs");
    assert!(change["cells_beyond_noise"].as_u64().unwrap() > 0, "{change}");
    sandbox.ok("bake rooms.glb -o plain.pvs --cells 3x1x2 --backend cpu");
    let words = sandbox.ok("diff plain.pvs seed-1.pvs");
    assert!(words.contains("sampling alone may explain it"), "{words}");
}
