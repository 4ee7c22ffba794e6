//! Tests of `sightline plan`, `tile` and `assemble`: a bake without a coordinator, with the bytes of `bake`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::Value;
use sightline_test_s3::{KEY, S3Server, SECRET};
use sightline_tests::{Sandbox, assert_same};

const ROOMS: &str = "generate rooms --triangles 700 -o rooms.glb";

/// The jobs cover every kind of plan: tiles that depend on each other, several tiles, exact tiles, and tiles
/// without a tracer.
const JOBS: [(&str, &str); 6] = [
    (
        "lines",
        "--cells 4x2x2 --block-cells 4 --target-error 0.01 --backend cpu",
    ),
    (
        "tree",
        "--triangle-budget 100 --max-depth 5 --target-error 0.01 --backend cpu",
    ),
    (
        "cubes",
        "--sampler cubes --cells 2x2x2 --resolution 32 --backend cpu",
    ),
    (
        "objects",
        "--cells 2x2x2 --block-cells 4 --granularity objects --contributions --backend cpu",
    ),
    (
        "exact",
        "--cells 2x1x1 --method exact --certificates --block-cells 1 --backend cpu",
    ),
    ("portals", "--cells 2x2x2 --method portals --block-cells 4"),
];

/// Returns the dependencies of the tiles of a plan.
fn needs(sandbox: &Sandbox, plan: &str) -> Vec<Vec<usize>> {
    let plan: Value = serde_json::from_slice(&sandbox.read(&format!("{plan}/plan.json"))).unwrap();
    let tiles = plan["tiles"].as_array().unwrap();
    let numbers = |tile: &Value| {
        let needs = tile["needs"].as_array().unwrap();
        needs.iter().map(|n| n.as_u64().unwrap() as usize).collect()
    };
    tiles.iter().map(numbers).collect()
}

/// Returns the last order that the dependencies permit, from which each tile is computed as late as possible.
fn backwards(needs: &[Vec<usize>]) -> Vec<usize> {
    let (mut order, mut done) = (Vec::new(), vec![false; needs.len()]);
    while order.len() < needs.len() {
        let ready = |tile: &usize| !done[*tile] && needs[*tile].iter().all(|need| done[*need]);
        let next = (0..needs.len()).rev().find(ready).unwrap();
        done[next] = true;
        order.push(next);
    }
    order
}

#[test]
fn tiles_in_any_order_give_bytes_of_bake() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    for (name, options) in JOBS {
        sandbox.ok(&format!(
            "bake rooms.glb {options} -o {name}.pvs --data-dir data-{name}"
        ));
        sandbox.ok(&format!("plan rooms.glb {options} -o {name}"));
        let needs = needs(&sandbox, name);
        assert!(needs.len() > 1, "{name} has one tile");
        for tile in backwards(&needs) {
            sandbox.ok(&format!("tile {name} {tile}"));
        }
        sandbox.ok(&format!("assemble {name} -o {name}-joined.pvs"));
        let [baked, joined] = [format!("{name}.pvs"), format!("{name}-joined.pvs")];
        assert_same(&sandbox.read(&joined), &sandbox.read(&baked), name);
    }
}

#[test]
fn tiles_are_computed_once_and_by_any_process() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    let options = "--cells 2x2x1 --block-cells 2 --target-error 0.01 --backend cpu";
    sandbox.ok(&format!("plan rooms.glb {options} -o plan"));
    // Two processes at the same time write the same file.
    let both = [
        sandbox.start("tile plan 0 --json"),
        sandbox.start("tile plan 0 --json"),
    ];
    for process in both {
        process.end().code(0);
    }
    let first = sandbox.read("plan/tiles/0.tile");
    let again = sandbox.json("tile plan 0");
    assert_eq!(
        (&again["computed"], &again["tile"]),
        (&false.into(), &0.into())
    );
    sandbox.ok("tile plan 1");
    // The folder can be moved, and the file of the scene is no longer needed.
    std::fs::rename(sandbox.path("plan"), sandbox.path("moved")).unwrap();
    std::fs::remove_file(sandbox.path("rooms.glb")).unwrap();
    std::fs::remove_file(sandbox.path("moved/tiles/0.tile")).unwrap();
    sandbox.ok("tile moved 0");
    assert_same(
        &sandbox.read("moved/tiles/0.tile"),
        &first,
        "the same tile once more",
    );
    sandbox.ok("assemble moved -o moved.pvs");
    assert_eq!(sandbox.json("info moved.pvs")["cells"], 4);
}

#[test]
fn damaged_absent_and_foreign_tiles_are_named() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    for (name, seed) in [("one", 1), ("two", 2)] {
        let options = "--cells 2x2x1 --block-cells 1 --target-error 0.05 --backend cpu";
        sandbox.ok(&format!("plan rooms.glb {options} --seed {seed} -o {name}"));
        for tile in 0..4 {
            sandbox.ok(&format!("tile {name} {tile}"));
        }
    }
    let assemble = || sandbox.run("assemble one -o one.pvs");
    assemble().code(0);
    let whole = sandbox.read("one/tiles/2.tile");
    let mut flipped = whole.clone();
    *flipped.last_mut().unwrap() ^= 1;
    sandbox.write("one/tiles/2.tile", flipped);
    assemble().code(3).says("2.tile").says("damaged");
    sandbox.write("one/tiles/2.tile", &whole[..whole.len() - 7]);
    assemble().code(3).says("2.tile").says("damaged");
    sandbox.write("one/tiles/2.tile", sandbox.read("two/tiles/2.tile"));
    assemble().code(3).says("2.tile").says("another job");
    sandbox.write("one/tiles/2.tile", sandbox.read("one/tiles/1.tile"));
    assemble()
        .code(3)
        .says("2.tile")
        .says("the file contains tile 1");
    std::fs::remove_file(sandbox.path("one/tiles/2.tile")).unwrap();
    assemble().code(3).says("missing").says("2");
    // A damaged tile is computed again.
    sandbox.write("one/tiles/2.tile", b"nonsense");
    sandbox
        .run("tile one 2")
        .code(0)
        .says("computes the tile again");
    assert_same(&sandbox.read("one/tiles/2.tile"), &whole, "the tile");
    sandbox.run("tile one 4").code(2).says("numbered from 0");
    sandbox.run("tile nowhere 0").code(3).says("sightline plan");
    // A folder contains one bake.
    let other = "plan rooms.glb --cells 3x1x1 --backend cpu";
    sandbox
        .run(&format!("{other} -o one"))
        .code(3)
        .says("another bake");
    sandbox
        .run(&format!("{other} --time-budget 5s -o three"))
        .code(2)
        .says("--time-budget");
    // The error of a tile names the absent tiles that it depends on.
    sandbox
        .ok("plan rooms.glb --sampler cubes --cells 2x2x2 --resolution 16 --backend cpu -o cubes");
    let needs = needs(&sandbox, "cubes");
    let last = needs.len() - 1;
    sandbox
        .run(&format!("tile cubes {last}"))
        .code(3)
        .says("compute these tiles first");
}

#[test]
fn plan_in_bucket_gives_same_bytes() {
    let mut sandbox = Sandbox::new();
    sandbox.set("AWS_ACCESS_KEY_ID", KEY);
    sandbox.set("AWS_SECRET_ACCESS_KEY", SECRET);
    sandbox.ok(ROOMS);
    let server = S3Server::start(&sandbox.path("s3"), "farm");
    let place = format!("s3://farm/plan?endpoint={}", server.endpoint());
    let options = "--cells 2x2x1 --block-cells 2 --target-error 0.05 --backend cpu";
    sandbox.ok(&format!(
        "bake rooms.glb {options} -o baked.pvs --data-dir data"
    ));
    sandbox.ok(&format!("plan rooms.glb {options} -o {place}"));
    sandbox
        .run(&format!("assemble {place} -o joined.pvs"))
        .code(3)
        .says("missing");
    for tile in 0..2 {
        sandbox.ok(&format!("tile {place} {tile}"));
    }
    sandbox.ok(&format!("assemble {place} -o joined.pvs"));
    assert_same(
        &sandbox.read("joined.pvs"),
        &sandbox.read("baked.pvs"),
        "in a bucket",
    );
    sandbox
        .run("plan rooms.glb --cells 1x1x1 -o gs://farm/plan")
        .code(2)
        .says("gs://farm/plan");
}
