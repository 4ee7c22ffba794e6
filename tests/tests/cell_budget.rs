//! Tests of `sightline cells`: the division is a partition of the grid, its numbers follow from the unions of
//! the grid's sets, and bad input has an error with a remedy.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::collections::BTreeSet;

use serde_json::Value;
use sightline_model::statistics::VIEWPOINT_WEIGHT;
use sightline_pvs::{Builder, CellTree, Header, Node, Object, Pvs, SET_ASIDE};
use sightline_tests::{Dump, Sandbox};

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap()
}

fn corner(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|axis| value[axis].as_f64().unwrap())
}

/// Returns the union of the sets of the reached cells inside a box of an answer, and the sum of the weights
/// of these cells.
fn union(dump: &Dump, weights: &[u64], of_answer: &Value) -> (BTreeSet<u64>, u64) {
    let (min, max) = (corner(&of_answer["min"]), corner(&of_answer["max"]));
    let (mut union, mut weight) = (BTreeSet::new(), 0);
    for (cell, own) in dump.cells.iter().zip(weights) {
        let middle = cell.middle();
        if cell.reached && (0..3).all(|a| min[a] < middle[a] && middle[a] < max[a]) {
            union.extend(&cell.visible);
            weight += own;
        }
    }
    (union, weight)
}

#[test]
fn division_has_least_expected_set_and_numbers_of_its_unions() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    sandbox.write("eyes.txt", "2 1.5 2\n4 1.5 2\n");
    sandbox.ok(
        "bake rooms.glb -o fine.pvs --backend cpu --cells 6x2x4 --viewpoints eyes.txt --reach 1 \
         --cell-to-cell off --target-error 0.003",
    );
    let dump = sandbox.dump("fine.pvs");
    let reached = dump.cells.iter().filter(|c| c.reached).count() as u64;
    assert!(reached > 4 && reached < 48, "{reached}");
    let columns = Pvs::open(sandbox.path("fine.pvs"))
        .unwrap()
        .columns()
        .unwrap();
    let weights = columns.into_iter().find(|c| c.name == VIEWPOINT_WEIGHT);
    let weights = weights.unwrap().values;
    let whole_weight: u64 = weights.iter().sum();
    let mut last = f64::INFINITY;
    for budget in [1, 2, 5, 48] {
        let found = sandbox.json(&format!("cells fine.pvs --cell-budget {budget}"));
        assert_eq!(number(&found["grid"]["cells"]), reached);
        let (mut sum, mut cells, mut volume) = (0, 0, 0.0);
        for own in found["boxes"].as_array().unwrap() {
            let (set, viewpoints) = union(&dump, &weights, own);
            assert_eq!(own["reached"].as_bool().unwrap(), viewpoints > 0);
            assert_eq!(number(&own["cost"]), set.len() as u64, "{own}");
            sum += viewpoints * set.len() as u64;
            cells += u64::from(viewpoints > 0);
            let (min, max) = (corner(&own["min"]), corner(&own["max"]));
            volume += (0..3).map(|a| max[a] - min[a]).product::<f64>();
        }
        let whole: f64 = dump.cells.iter().map(|c| c.volume()).sum();
        assert!(
            (volume / whole - 1.0).abs() < 1e-6,
            "the boxes are disjoint"
        );
        let expected = found["chosen"]["expected"].as_f64().unwrap();
        assert!((expected - sum as f64 / whole_weight as f64).abs() < 1e-9);
        assert_eq!(number(&found["chosen"]["cells"]), cells);
        assert!(
            cells <= budget && expected <= last,
            "{expected} after {last}"
        );
        last = expected;
        // A larger budget than the number of reached cells gives the expected set of the grid.
        assert!(budget < 48 || expected == found["grid"]["expected"].as_f64().unwrap());
    }
}

#[test]
fn byte_budget_limits_bytes_of_all_kinds_of_costs() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    for granularity in ["triangles", "objects"] {
        sandbox.ok(&format!(
            "bake rooms.glb -o fine.pvs --backend cpu --cells 6x2x4 --granularity {granularity} \
             --cell-to-cell off --target-error 0.003"
        ));
        for cost in ["triangles", "objects", "bytes"] {
            let found = sandbox.json(&format!("cells fine.pvs --byte-budget 1kB --cost {cost}"));
            assert_eq!(found["cost"], cost);
            assert!(number(&found["chosen"]["bytes"]) <= 1000, "{found}");
            assert!(number(&found["chosen"]["cells"]) > 0, "{found}");
            let hull = found["hull"].as_array().unwrap();
            let ascends = |p: &[Value]| {
                number(&p[0]["bytes"]) < number(&p[1]["bytes"])
                    && p[0]["expected"].as_f64() > p[1]["expected"].as_f64()
            };
            assert!(hull.windows(2).all(ascends), "{found}");
        }
    }
    let text = sandbox.ok("cells fine.pvs --cell-budget 8 --cost objects");
    assert!(
        text.contains("of its expected set") && text.contains("other budgets:"),
        "{text}"
    );
}

/// Returns a result of two cells. The second cell has the flags `flags` and this set, of which all items are
/// undecided if the cell is set aside.
fn two_cells(triangles: u32, set: &[u32], flags: u32) -> Vec<u8> {
    let header = Header {
        triangles,
        method: "aggressive".to_owned(),
        tree: CellTree::new(
            [[0.0; 3], [2.0, 1.0, 1.0]],
            vec![Node::Split { axis: 0, at: 1.0 }, Node::Leaf, Node::Leaf],
        )
        .unwrap(),
        objects: vec![Object {
            name: "all".to_owned(),
            first: 0,
            count: triangles,
            source: None,
        }],
        info_json: "{}".to_owned(),
    };
    let mut builder = Builder::new(header).unwrap();
    let undecided = if flags == SET_ASIDE { set } else { &[] };
    builder.push_cell(&[], &[], 0).unwrap();
    builder.push_cell(set, undecided, flags).unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    file
}

#[test]
fn bad_budgets_and_results_have_errors() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 300 -o rooms.glb");
    sandbox.ok("bake rooms.glb -o grid.pvs --backend cpu --cells 2x1x2 --target-error 0.1");
    sandbox.ok("bake rooms.glb -o walls.pvs --backend cpu --cells walls:8 --target-error 0.1");
    for bad in [
        "",
        "--cell-budget 0",
        "--byte-budget 0",
        "--byte-budget 5pounds",
        "--cell-budget 2 --byte-budget 2kB",
        "--cell-budget 2 --cost beauty",
    ] {
        sandbox.run(&format!("cells grid.pvs {bad}")).code(2);
    }
    sandbox
        .run("cells grid.pvs --byte-budget 1")
        .code(2)
        .says("every division has sets of at least");
    // A header of a few hundred bytes with billions of triangles requests no memory for rows of bits.
    sandbox.write("wide.pvs", two_cells(u32::MAX - 1, &[1, 5], 0));
    sandbox.write("aside.pvs", two_cells(2, &[0, 1], SET_ASIDE));
    sandbox.write("empty.pvs", two_cells(2, &[], 0));
    sandbox
        .run("cells aside.pvs --cell-budget 1")
        .code(3)
        .says("cell 1 was set aside");
    let empty = sandbox.ok("cells empty.pvs --cell-budget 1");
    assert!(empty.contains("1.00 of its expected set"), "{empty}");
    for cost in ["triangles", "objects", "bytes"] {
        sandbox
            .run(&format!("cells wide.pvs --cell-budget 1 --cost {cost}"))
            .code(3)
            .says("MB of memory");
    }
    sandbox
        .run("cells walls.pvs --cell-budget 4")
        .code(3)
        .says("--cells NXxNYxNZ");
}
