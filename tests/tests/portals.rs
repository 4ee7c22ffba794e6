//! Tests of bakes by portals: in one process and in a cluster with failures, verified, queried from points,
//! and rejected for unsupported options.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::{Value, json};
use sightline_tests::{Sandbox, across, assert_same, house};

const SCENE: &str = "generate rooms --grid 4x3 --triangles 4000 -o rooms.glb";
const JOB: &str = "rooms.glb --cells 8x2x6 --block-cells 2 --method portals";

/// Returns a folder with the scene, and with `alone.pvs`, the result of [`JOB`] in one process.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir data-alone"));
    sandbox
}

#[test]
fn disturbed_cluster_gives_same_bytes() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let victim = coordinator.worker();
    coordinator.until(job, "a first tile", |job| {
        job["tiles_done"].as_u64().unwrap() > 0
    });
    victim.kill();
    let _heirs = [coordinator.worker(), coordinator.worker()];
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "after a worker was killed",
    );
    assert_eq!(coordinator.json(&format!("show {job}"))["profile"], "none");
}

#[test]
fn sets_contain_exact_sets_and_report_missing_witnesses() {
    let sandbox = sandbox();
    let header = &sandbox.dump("alone.pvs").header;
    assert_eq!(header["method"], "portals");
    let words = sandbox.ok("info alone.pvs");
    assert!(
        words.contains("pairs of a cell and a triangle") && words.contains("have no witness"),
        "{words}"
    );
    let report = sandbox.json("verify rooms.glb alone.pvs --sample 200");
    assert_eq!(
        (&report["accepted"], &report["pairs"]),
        (&json!(true), &json!(200))
    );
    sandbox
        .run("verify rooms.glb alone.pvs")
        .code(3)
        .says("--sample");
}

#[test]
fn look_returns_part_of_cell_set_and_rejects_bad_views() {
    let sandbox = sandbox();
    let dump = sandbox.dump("alone.pvs");
    let [lo, hi] = dump.view_box();
    let eye = [0, 1, 2].map(|k| lo[k] + (hi[k] - lo[k]) * [0.3, 0.6, 0.4][k]);
    let view = |change: &dyn Fn(&mut Value)| {
        let mut view =
            json!({"id": "a", "eye": eye, "dir": [1, 0, 0.2], "up": [0, 1, 0], "fov": [90, 60]});
        change(&mut view);
        format!("{view}\n")
    };
    sandbox.write(
        "eyes.jsonl",
        view(&|_| {}) + &view(&|v| v["dir"] = json!([-1, 0, 0.2])),
    );
    let out = sandbox.ok("look alone.pvs --eyes eyes.jsonl");
    let looks: Vec<Value> = out
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(looks.len(), 2);
    assert_ne!(
        looks[0]["visible"], looks[1]["visible"],
        "two directions show different triangles"
    );
    for look in &looks {
        let cell = look["cell"].as_u64().unwrap();
        let of_cell = &dump.cells[cell as usize].visible;
        let seen = look["visible"].as_array().unwrap();
        assert!(!seen.is_empty() && seen.len() < of_cell.len());
        assert!(
            seen.iter()
                .all(|id| of_cell.binary_search(&id.as_u64().unwrap()).is_ok())
        );
    }
    let bad = |change: &dyn Fn(&mut Value), why: &str| {
        sandbox.write("bad.jsonl", view(change));
        sandbox
            .run("look alone.pvs --eyes bad.jsonl")
            .code(3)
            .says(why);
    };
    bad(
        &|v| v["eye"] = json!([1e9, 0, 0]),
        "outside of the view box",
    );
    bad(&|v| v["fov"] = json!([180, 60]), "less than 180");
    bad(&|v| v["up"] = json!([2, 0, 0.4]), "not on one line");
    bad(&|v| v["shut"] = json!(["gate"]), "no door \"gate\"");
    bad(&|v| v["shutt"] = json!(["gate"]), "unknown field");
    sandbox.ok("bake rooms.glb --cells 2x1x2 --backend cpu -o sampled.pvs --data-dir data");
    sandbox
        .run("look sampled.pvs --eyes eyes.jsonl")
        .code(3)
        .says("--method portals");
}

#[test]
fn unsupported_options_of_portals_are_rejected() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let refused = |flags: &str, why: &str| {
        sandbox
            .run(&format!("bake rooms.glb --method portals {flags} -o x.pvs"))
            .code(2)
            .says(why);
    };
    refused("--certificates", "--certificates");
    refused("--triangle-budget 500", "--triangle-budget");
    refused("--max-error 0.01 --contributions", "--contributions needs");
    refused("--max-error 0.01 --contributions", "--max-error needs");
    refused("--backend cpu", "--backend");
    sandbox
        .run("bake rooms.glb --backend none -o x.pvs")
        .code(2)
        .says("backend");
}

/// A job of exact open boxes between walls.
const BOXES: &str =
    "rooms.glb --cells walls:30 --reachable-from 2,1.5,3 --method exact --backend cpu";

#[test]
fn boxes_along_walls_are_reproducible_and_support_look() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    sandbox.ok(&format!("bake {BOXES} -o alone.pvs --data-dir data-alone"));
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(BOXES);
    let victim = coordinator.worker();
    coordinator.until(job, "a first tile", |job| {
        job["tiles_done"].as_u64().unwrap() > 0
    });
    victim.kill();
    let _heirs = [coordinator.worker(), coordinator.worker()];
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "after a worker was killed",
    );
    let dump = sandbox.dump("alone.pvs");
    assert_eq!(
        dump.header["info"]["spec"]["visibility"]["exact"]["sampling"]["lines"]["boxes"]["count"],
        30
    );
    assert_eq!(dump.cells.len(), 30);
    // The sets are exact, and look-ups use the portals.
    let eyes =
        json!({"id": 1, "eye": [2, 1.5, 3], "dir": [1, 0, 0.2], "up": [0, 1, 0], "fov": [90, 60]});
    sandbox.write("eyes.jsonl", format!("{eyes}\n"));
    let look: Value =
        serde_json::from_str(sandbox.ok("look alone.pvs --eyes eyes.jsonl").trim()).unwrap();
    assert!(!look["visible"].as_array().unwrap().is_empty());
    sandbox.ok(&format!(
        "bake {} -o portals.pvs",
        BOXES.replace("exact --backend cpu", "portals")
    ));
    let report = sandbox.json("verify rooms.glb portals.pvs --sample 100");
    assert_eq!(
        (&report["accepted"], &report["pairs"]),
        (&json!(true), &json!(100))
    );
    let walls = &sandbox.dump("portals.pvs").cells;
    for (exact, walls) in dump.cells.iter().zip(walls) {
        assert!(
            exact
                .visible
                .iter()
                .all(|t| walls.visible.binary_search(t).is_ok())
        );
    }
}

#[test]
fn boxes_along_walls_reject_options_for_grids() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let refused = |flags: &str, why: &str| {
        sandbox
            .run(&format!("bake rooms.glb {flags} -o x.pvs"))
            .code(2)
            .says(why);
    };
    refused("--cells walls:0", "1 to 4096");
    refused("--cells wall:5", "walls:N");
    refused(
        "--cells walls:5 --method exact --certificates",
        "certificates",
    );
    refused("--cells walls:5 --cell-to-cell on", "cell-to-cell");
    refused("--cells walls:5 --sampler cubes", "--cells walls:N needs");
    refused(
        "--cells walls:5 --view-box 0,0,0,1,1,1 --view-box 2,0,0,3,1,1",
        "need a grid",
    );
}

#[test]
fn door_can_be_shut_at_run_time() {
    let sandbox = Sandbox::new();
    // A wall at x = 2; a door fills y from 0 to 1.
    let wall = across(2.0, [1.0, 2.0], [0.0, 2.0]);
    let scene = house(&[
        ("wall", wall),
        ("front_door", across(2.0, [0.0, 1.0], [0.0, 2.0])),
    ]);
    sandbox.write("house.obj", scene);
    sandbox.ok(
        "bake house.obj --doors front* --cells 4x1x1 --method portals -o house.pvs --data-dir data",
    );
    // An object that fills no opening cannot be a door.
    let picture = "o picture\nv 1 1.5 1\nv 1 1.6 1\nv 1 1.5 1.1\nf -3 -2 -1\n";
    sandbox.write(
        "art.obj",
        [sandbox.read("house.obj"), picture.into()].concat(),
    );
    let art =
        "bake art.obj --doors pict* --reachable-from 1,0.5,0.5 --cells 1x1x1 --method portals";
    sandbox
        .run(&format!("{art} -o art.pvs --data-dir data"))
        .code(0)
        .says("note: picture cannot be shut at run time");
    // If the door is shut, the rooms are separate, and an eye in the other room is outside the walls.
    sandbox.ok(
        "bake house.obj --cells 1x1x1 --reachable-from 1,0.5,1 --method portals -o one.pvs --data-dir data",
    );
    let other = json!({"eye": [3, 0.5, 1], "dir": [1, 0, 0], "up": [0, 1, 0], "fov": [60, 60]});
    sandbox.write("other.jsonl", format!("{other}\n"));
    sandbox
        .run("look one.pvs --eyes other.jsonl")
        .code(3)
        .says("outside of the walls");
    let view = json!({"eye": [1, 0.5, 1], "dir": [1, 0, 0], "up": [0, 1, 0], "fov": [60, 60]});
    let shut = json!({"eye": [1, 0.5, 1], "dir": [1, 0, 0], "up": [0, 1, 0], "fov": [60, 60],
        "shut": ["front_door"]});
    sandbox.write("eyes.jsonl", format!("{view}\n{shut}\n"));
    let out = sandbox.ok("look house.pvs --eyes eyes.jsonl");
    let seen: Vec<Vec<u64>> = out
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap())
        .map(|look| {
            look["visible"]
                .as_array()
                .unwrap()
                .iter()
                .map(|id| id.as_u64().unwrap())
                .collect()
        })
        .collect();
    // The wall at x = 4 is triangles 10 and 11, the door 14 and 15.
    assert!(seen[0].contains(&10) || seen[0].contains(&11), "{seen:?}");
    assert!(!seen[1].contains(&10) && !seen[1].contains(&11), "{seen:?}");
    assert!(
        seen[1].iter().all(|id| seen[0].contains(id)),
        "shutting reveals nothing: {seen:?}"
    );
    assert!(
        seen[0].iter().all(|id| *id < 14),
        "a door is in no set: {seen:?}"
    );
}
