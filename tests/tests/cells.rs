//! Tests of cell-to-cell visibility: against brute force, by every sampler, exactly with proofs, and in
//! queries.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::collections::BTreeSet;

use serde_json::Value;
use sightline_tests::{Sandbox, assert_same};

/// Returns the visible and the undecided cells of each cell, from `dump --items cells`.
fn cells(sandbox: &Sandbox, file: &str) -> Vec<(BTreeSet<u64>, BTreeSet<u64>)> {
    let text = sandbox.ok(&format!("dump {file} --items cells"));
    let ids = |v: &Value| {
        v.as_array()
            .unwrap()
            .iter()
            .map(|id| id.as_u64().unwrap())
            .collect()
    };
    let lines = text
        .lines()
        .skip(1)
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines
        .map(|line| (ids(&line["visible"]), ids(&line["undecided"])))
        .collect()
}

/// Returns the fraction of random unobstructed pairs of points whose cells are not a pair in the result.
fn missed(sandbox: &Sandbox, scene: &str, file: &str) -> f64 {
    let report = sandbox.json(&format!(
        "measure {scene} {file} --viewpoints 1 --resolution 8 --pairs 300000"
    ));
    assert!(report["cell_to_cell"]["free"].as_u64().unwrap() > 1000);
    report["cell_to_cell"]["missed_fraction"].as_f64().unwrap()
}

fn maze() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --triangles 1500 -o maze.glb");
    sandbox
}

#[test]
fn samplers_find_cells_that_random_segments_join() {
    let sandbox = maze();
    let ways = [
        ("lines", "--cells 6x2x6", 1e-3),
        ("blocks", "--cells 6x2x6 --block-cells 12", 1e-3),
        ("bound", "--cells 6x2x6 --max-error 0.02", 1e-2),
        (
            "guided",
            "--cells 4x2x4 --sampler guided --rays 2000 --backend cpu",
            1e-3,
        ),
        (
            "cubes",
            "--cells 2x2x2 --sampler cubes --resolution 16 --backend cpu",
            1e-3,
        ),
        (
            "gpu",
            "--cells 3x2x3 --backend gpu --target-error 0.01",
            1e-2,
        ),
        ("tree", "--triangle-budget 200 --max-depth 6", 1e-3),
    ];
    for (name, flags, most) in ways {
        // The view box is above the inside of the floor, which is a thin gap between two planes.
        let air = "--view-box 0,0.05,0,16,2.3,16";
        sandbox.ok(&format!(
            "bake maze.glb -o {name}.pvs --data-dir {name} {air} {flags}"
        ));
        let found = cells(&sandbox, &format!("{name}.pvs"));
        for (a, (visible, undecided)) in found.iter().enumerate() {
            let a = a as u64;
            assert!(visible.contains(&a), "{name}: cell {a} sees itself");
            assert!(undecided.is_empty());
            assert!(
                visible.iter().all(|b| found[*b as usize].0.contains(&a)),
                "{name}: symmetric"
            );
        }
        let missed = missed(&sandbox, "maze.glb", &format!("{name}.pvs"));
        assert!(missed <= most, "{name}: {missed}");
    }
    let info = sandbox.json("info bound.pvs");
    assert!(info["cell_to_cell"]["greatest_bound"].as_f64().unwrap() <= 0.02);
}

#[test]
fn exact_pairs_contain_sampled_pairs_with_proofs() {
    let sandbox = maze();
    let job = "bake maze.glb --cells 3x2x3 --view-box 0,0,0,8,2.4,8";
    sandbox.ok(&format!("{job} -o lines.pvs --data-dir lines"));
    sandbox.ok(&format!(
        "{job} -o exact.pvs --data-dir exact --method exact --certificates --workers 1"
    ));
    sandbox.ok(&format!(
        "{job} -o four.pvs --data-dir four --method exact --certificates --workers 4"
    ));
    assert_same(
        &sandbox.read("exact.pvs"),
        &sandbox.read("four.pvs"),
        "one worker and four",
    );
    let [sampled, exact] = ["lines.pvs", "exact.pvs"].map(|file| cells(&sandbox, file));
    for (a, ((sampled, _), (exact, open))) in sampled.iter().zip(&exact).enumerate() {
        assert!(sampled.is_subset(exact) && open.is_empty(), "cell {a}");
    }
    let hidden: usize = exact
        .iter()
        .map(|(visible, _)| exact.len() - visible.len())
        .sum();
    assert!(hidden > 0, "walls of the maze are between some cells");
    let report = sandbox.json("verify maze.glb exact.pvs");
    assert_eq!(
        report["cell_pairs_hidden"].as_u64().unwrap() as usize,
        hidden / 2
    );
    assert_eq!(report["cell_boxes"], report["cell_boxes_checked"]);
}

#[test]
fn wall_separates_cells_of_two_rooms() {
    let sandbox = Sandbox::new();
    // Two closed rooms of 2×2×2 next to each other, with a common wall at x = 2.
    let mut text = String::new();
    let mut vertices = 0;
    let mut quad = |corners: [[f32; 3]; 4]| {
        corners
            .iter()
            .for_each(|[x, y, z]| text.push_str(&format!("v {x} {y} {z}\n")));
        text.push_str(&format!(
            "f {} {} {} {}\n",
            vertices + 1,
            vertices + 2,
            vertices + 3,
            vertices + 4
        ));
        vertices += 4;
    };
    for x in [0.0, 2.0, 4.0] {
        quad([[x, 0.0, 0.0], [x, 2.0, 0.0], [x, 2.0, 2.0], [x, 0.0, 2.0]]);
    }
    for y in [0.0, 2.0] {
        quad([[0.0, y, 0.0], [4.0, y, 0.0], [4.0, y, 2.0], [0.0, y, 2.0]]);
    }
    for z in [0.0, 2.0] {
        quad([[0.0, 0.0, z], [4.0, 0.0, z], [4.0, 2.0, z], [0.0, 2.0, z]]);
    }
    sandbox.write("rooms.obj", text);
    for (file, flags, state) in [
        ("lines", "", "not seen"),
        ("exact", "--method exact --certificates", "hidden"),
    ] {
        sandbox.ok(&format!(
            "bake rooms.obj -o {file}.pvs --cells 8x2x2 --data-dir {file} {flags}"
        ));
        let ask = |what: &str| sandbox.json(&format!("query {file}.pvs {what}"));
        // Two separate cells, on opposite sides of the wall.
        let across = ask("1 1 1 --sees 3 1 1");
        assert_eq!(
            (across["sees"].as_bool(), across["state"].as_str()),
            (Some(false), Some(state))
        );
        assert_eq!(ask("0.2 1 1 --sees 1.8 1 1")["state"], "visible");
        assert_eq!(ask("1 1 1 --box 2.9,0.5,0.5,3.1,1,1")["sees"], false);
        assert_eq!(ask("1 1 1 --box 1.1,0.5,0.5,3.1,1,1")["sees"], true);
        // Beyond the view box, visibility is unknown.
        assert_eq!(ask("1 1 1 --box 3,0.5,0.5,9,1,1")["sees"], true);
        let here = ask("1 1 1")["cell"].as_u64().unwrap();
        assert_eq!(ask(&format!("3 1 1 --cell {here}"))["sees"], false);
        assert_eq!(ask(&format!("--cell {here}"))["cell"], here);
        sandbox
            .run(&format!("query {file}.pvs 1 1 1 --cell 99"))
            .code(3);
        sandbox
            .run(&format!("query {file}.pvs 1 1 1 --sees 9 9 9"))
            .code(3);
        sandbox
            .run(&format!("query {file}.pvs --sees 1 1 1"))
            .code(2);
    }
    sandbox.ok("verify rooms.obj exact.pvs");
    sandbox.ok("bake rooms.obj -o off.pvs --cells 2x2x2 --data-dir off --cell-to-cell off");
    sandbox
        .run("dump off.pvs --items cells")
        .code(3)
        .says("--cell-to-cell");
    sandbox
        .run("query off.pvs 1 1 1 --sees 3 1 1")
        .code(3)
        .says("--cell-to-cell");
    sandbox
        .run("bake rooms.obj -o x.pvs --cells 64x64x16 --cell-to-cell on")
        .code(2)
        .says("32768");
}

#[test]
fn exact_pairs_end_at_distance_of_lines() {
    let sandbox = maze();
    let job = "bake maze.glb --cells 4x2x4 --view-box 0,0.05,0,16,2.3,16 --far 3";
    sandbox.ok(&format!("{job} -o lines.pvs --data-dir lines"));
    sandbox.ok(&format!(
        "{job} -o exact.pvs --data-dir exact --method exact"
    ));
    let dump = sandbox.dump("exact.pvs");
    let [sampled, exact] = ["lines.pvs", "exact.pvs"].map(|file| cells(&sandbox, file));
    let mut apart = 0;
    for (a, ((sampled, _), (exact, _))) in sampled.iter().zip(&exact).enumerate() {
        assert!(sampled.is_subset(exact), "cell {a}");
        for (b, other) in dump.cells.iter().enumerate() {
            let gap = |k: usize| {
                (other.min[k] - dump.cells[a].max[k])
                    .max(dump.cells[a].min[k] - other.max[k])
                    .max(0.0)
            };
            if (0..3).map(|k| gap(k).powi(2)).sum::<f64>().sqrt() > 3.0 {
                assert!(
                    !exact.contains(&(b as u64)),
                    "cells {a} and {b} are farther apart"
                );
                apart += 1;
            }
        }
    }
    assert!(apart > 0);
}
