//! Tests of `sightline diff`: it separates changes of sets from the noise of sampling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::json;
use sightline_tests::{Sandbox, across, house};

/// Returns two rooms with a wall at x = 2 that leaves z from 0 to `door` open, and an object in the second
/// room.
fn rooms(door: f32, thing: &str) -> String {
    let board = [
        [3.0, 0.5, 0.5],
        [3.5, 0.5, 0.5],
        [3.5, 0.5, 1.0],
        [3.0, 0.5, 1.0],
    ];
    house(&[
        ("wall", across(2.0, [0.0, 2.0], [door, 2.0])),
        (thing, board),
    ])
}

const CELLS: &str = "--backend cpu --view-box 0.25,0.25,0.25,3.65,1.75,1.75 --cells 2x1x1";

#[test]
fn changes_are_counted_and_can_fail() {
    let sandbox = Sandbox::new();
    for (name, door) in [("shut", 0.0), ("open", 1.0)] {
        sandbox.write(&format!("{name}.obj"), rooms(door, "shelf"));
        sandbox.ok(&format!(
            "bake {name}.obj -o {name}.pvs --method exact {CELLS}"
        ));
    }
    let same = sandbox.json("diff shut.pvs shut.pvs --fail-above 0");
    assert_eq!(
        (&same["changed_cells"], &same["changed_fraction"]),
        (&json!(0), &json!(0.0))
    );
    let changed = sandbox.json("diff shut.pvs open.pvs");
    // The shelf and the far end of the wall are now in the set of the first room.
    assert_eq!(
        (&changed["cells"], &changed["changed_cells"]),
        (&json!(2), &json!(1))
    );
    let shelf = changed["objects"]
        .as_array()
        .unwrap()
        .iter()
        .find(|o| o["object"] == "shelf")
        .unwrap();
    assert_eq!(
        (&shelf["came_in_cells"], &shelf["went_in_cells"]),
        (&json!(1), &json!(0))
    );
    let back = sandbox.json("diff open.pvs shut.pvs");
    assert_eq!(
        (&back["came"], &back["went"]),
        (&changed["went"], &changed["came"])
    );
    sandbox
        .run("diff shut.pvs open.pvs --fail-above 0.5")
        .code(0);
    sandbox
        .run("diff shut.pvs open.pvs --fail-above 0.001")
        .code(6)
        .says("--fail-above");
    let words = sandbox.ok("diff shut.pvs open.pvs");
    assert!(
        words.contains("1 of 2 cells changed") && words.contains("both results miss nothing"),
        "{words}"
    );
    let markdown = sandbox.ok("diff shut.pvs open.pvs --markdown");
    assert!(markdown.contains("| shelf | 1 | 0 |"), "{markdown}");
    // The difference as a page with heat maps.
    sandbox.ok("diff shut.pvs open.pvs -o diff.html --scene open.obj");
    let page = String::from_utf8(sandbox.read("diff.html")).unwrap();
    assert!(page.contains("items gained") && page.contains("1 of 2 cells changed"));
    sandbox
        .run("diff shut.pvs open.pvs -o other.html --scene shut.obj")
        .code(3);
    // Objects are compared by name if the triangles differ.
    sandbox.write("other.obj", rooms(1.0, "board"));
    sandbox.ok(&format!(
        "bake other.obj -o other.pvs --method exact {CELLS}"
    ));
    let named = sandbox.json("diff open.pvs other.pvs");
    assert_eq!(named["items"], "objects");
    let names: Vec<&str> = named["objects"]
        .as_array()
        .unwrap()
        .iter()
        .map(|o| o["object"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["board", "shelf"]);
    sandbox.ok("bake open.obj -o fine.pvs --backend cpu --cells 2x2x1");
    sandbox
        .run("diff open.pvs fine.pvs")
        .code(3)
        .says("different cells");
}

#[test]
fn sampling_noise_is_distinguished_from_change() {
    let sandbox = Sandbox::new();
    let sampled = "--max-error 0.002 --contributions --cells 3x1x2 --backend cpu";
    sandbox.ok("generate rooms --grid 3x2 --triangles 3000 -o rooms.glb");
    for seed in [1, 2] {
        sandbox.ok(&format!(
            "bake rooms.glb -o seed-{seed}.pvs --seed {seed} {sampled}"
        ));
    }
    let noise = sandbox.json("diff seed-1.pvs seed-2.pvs");
    assert!(
        noise["changed_cells"].as_u64().unwrap() > 0,
        "two seeds differ: {noise}"
    );
    assert_eq!(noise["cells_beyond_noise"], 0, "{noise}");
    // Through see-through walls, everything behind them is visible.
    sandbox.ok(&format!(
        "bake rooms.glb -o glass.pvs --see-through *wall* --seed 1 {sampled}"
    ));
    let change = sandbox.json("diff seed-1.pvs glass.pvs");
    assert!(
        change["cells_beyond_noise"].as_u64().unwrap() > 0,
        "{change}"
    );
    sandbox.ok("bake rooms.glb -o plain.pvs --cells 3x1x2 --backend cpu");
    let words = sandbox.ok("diff plain.pvs seed-1.pvs");
    assert!(
        words.contains("sampling alone may explain the differences"),
        "{words}"
    );
}
