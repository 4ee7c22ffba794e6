//! Tests of bakes with cells by cost: the sets are unions of the sets of the fine grid for every method, and
//! the same bytes come from one worker, several workers, single tiles and a finished fine result.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::collections::BTreeSet;

use serde_json::Value;
use sightline_model::statistics::VIEWPOINT_WEIGHT;
use sightline_pvs::Pvs;
use sightline_tests::{Dump, Sandbox, assert_same};

const ROOMS: &str = "generate rooms --triangles 2000 -o rooms.glb";
/// The places of two visitors and of a guard, whose place has a large weight.
const EYES: &str = "2 1.5 2 1\n4 1.5 2 1\n3 1.5 3 20\n";

/// Returns the weights of the viewpoints in the cells of a result.
fn weights(sandbox: &Sandbox, result: &str) -> Option<Vec<u64>> {
    let columns = Pvs::open(sandbox.path(result)).unwrap().columns().unwrap();
    let weights = columns.into_iter().find(|c| c.name == VIEWPOINT_WEIGHT);
    weights.map(|column| column.values)
}

/// Checks that the set of each cell is the union of the sets of the fine cells in it, and that an item is
/// undecided if no fine cell saw it. Returns the number of cells with viewpoints.
fn assert_unions(fine: &Dump, chosen: &Dump) -> usize {
    let mut found = 0;
    for cell in &chosen.cells {
        let is_inside =
            |middle: [f64; 3]| (0..3).all(|a| cell.min[a] < middle[a] && middle[a] < cell.max[a]);
        let (mut visible, mut seen) = (BTreeSet::new(), BTreeSet::new());
        let mut reached = false;
        for part in fine.cells.iter().filter(|part| is_inside(part.middle())) {
            found += 1;
            reached |= part.reached;
            visible.extend(&part.visible);
            seen.extend(
                part.visible
                    .iter()
                    .filter(|id| !part.undecided.contains(id)),
            );
        }
        let undecided: Vec<u64> = visible.difference(&seen).copied().copied().collect();
        let visible: Vec<u64> = visible.into_iter().copied().collect();
        assert_eq!((&cell.visible, &cell.undecided), (&visible, &undecided));
        assert_eq!(cell.reached, reached);
    }
    assert_eq!(found, fine.cells.len(), "every fine cell is in one cell");
    chosen.cells.iter().filter(|cell| cell.reached).count()
}

#[test]
fn sets_of_every_method_are_unions_of_fine_sets() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    for (name, options) in [
        ("lines", "--backend cpu --target-error 0.003"),
        (
            "objects",
            "--backend cpu --target-error 0.003 --granularity objects",
        ),
        ("cubes", "--backend cpu --sampler cubes --resolution 32"),
        ("guided", "--backend cpu --sampler guided --rays 300"),
        ("exact", "--backend cpu --method exact --target-error 0.01"),
        ("portals", "--method portals"),
    ] {
        sandbox.ok(&format!(
            "bake rooms.glb -o fine.pvs --cells 4x2x3 {options}"
        ));
        sandbox.ok(&format!(
            "bake rooms.glb -o {name}.pvs --cell-budget 7 --fine 4x2x3 {options}"
        ));
        let (fine, chosen) = (
            sandbox.dump("fine.pvs"),
            sandbox.dump(&format!("{name}.pvs")),
        );
        let cells = assert_unions(&fine, &chosen);
        assert!((1..=7).contains(&cells), "{name}: {cells}");
        let tried = sandbox.json("cells fine.pvs --cell-budget 7");
        let info = sandbox.json(&format!("info {name}.pvs"));
        assert_eq!(
            info["info"]["cells_by_cost"]["chosen"], tried["chosen"],
            "{name}"
        );
        assert!(info["from"].is_null() && info["reached"] == 1.0);
        if name != "objects" {
            assert_eq!(info["expected"], tried["chosen"]["expected"], "{name}");
        }
        // The same sets come from the finished fine result.
        sandbox.ok("bake rooms.glb -o united.pvs --from fine.pvs --cell-budget 7");
        assert_eq!(sandbox.dump("united.pvs").cells, chosen.cells, "{name}");
        assert_eq!(
            sandbox.json("info united.pvs")["from"]
                .as_str()
                .unwrap()
                .len(),
            64
        );
    }
}

#[test]
fn pairs_of_cells_are_pairs_of_their_parts() {
    let sandbox = Sandbox::new();
    // Two walls across the view box.
    let wall = |x: f32| format!("v {x} -9 -9\nv {x} 9 -9\nv {x} 9 9\nv {x} -9 9\n");
    let faces = "f 1 2 3 4\nf 5 6 7 8\n";
    sandbox.write(
        "walls.obj",
        [wall(2.0), wall(4.0), faces.to_owned()].concat(),
    );
    let options = "--view-box 0,0,0,6,1,3 --backend cpu --target-error 0.01 --cell-to-cell on";
    sandbox.ok(&format!(
        "bake walls.obj -o fine.pvs --cells 6x1x3 {options}"
    ));
    sandbox.ok(&format!(
        "bake walls.obj -o chosen.pvs --cell-budget 3 --fine 6x1x3 {options}"
    ));
    let [fine, chosen] =
        ["fine.pvs", "chosen.pvs"].map(|name| Pvs::open(sandbox.path(name)).unwrap());
    let inside = |cell: u32| {
        let [min, max] = chosen.cell_bounds(cell).unwrap();
        let is_inside = |part: &u32| {
            let [lo, hi] = fine.cell_bounds(*part).unwrap();
            (0..3).all(|a| min[a] <= lo[a] && hi[a] <= max[a])
        };
        (0..fine.cells()).filter(is_inside).collect::<Vec<u32>>()
    };
    let mut hidden = 0;
    for a in 0..chosen.cells() {
        for b in 0..chosen.cells() {
            let (parts, others) = (inside(a), inside(b));
            let sees = parts
                .iter()
                .any(|p| others.iter().any(|q| fine.sees(*p, *q).unwrap()));
            assert_eq!(chosen.sees(a, b).unwrap(), sees || a == b, "{a} and {b}");
            hidden += u32::from(!sees);
        }
    }
    assert!(
        hidden > 0 && chosen.cells() > 1,
        "the walls hide a pair of cells"
    );
}

#[test]
fn one_worker_farm_and_tiles_give_same_bytes() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    sandbox.write("eyes.txt", EYES);
    let options = "rooms.glb --byte-budget 3kB --fine 6x2x4 --viewpoints eyes.txt --reach 1 --backend cpu \
                   --target-error 0.003 --block-cells 8";
    sandbox.ok(&format!("bake {options} -o one.pvs --workers 1"));
    let one = sandbox.read("one.pvs");
    sandbox.ok(&format!("plan {options} -o plan"));
    let plan: Value = serde_json::from_slice(&sandbox.read("plan/plan.json")).unwrap();
    for tile in 0..plan["tiles"].as_array().unwrap().len() {
        sandbox.ok(&format!("tile plan {tile}"));
    }
    sandbox.ok("assemble plan -o tiles.pvs");
    assert_same(&one, &sandbox.read("tiles.pvs"), "single tiles");
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let _workers = [coordinator.worker(), coordinator.worker()];
    let job = coordinator.submit(options);
    assert_same(&one, &coordinator.finish(job), "two workers");
    let pvs = sandbox.json("info one.pvs");
    assert!(
        pvs["info"]["cells_by_cost"]["chosen"]["bytes"]
            .as_u64()
            .unwrap()
            <= 3000
    );
}

/// Uses triangles that no set contains, and a single cell with done and open tiles.
#[test]
fn partial_result_has_undecided_cells() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(
        "rooms.glb --cell-budget 1 --fine 6x2x4 --backend cpu --block-cells 1 --target-error 0.00002 \
         --occluder-only wall*",
    );
    let worker = coordinator.worker();
    coordinator.until(job, "a tile", |job| job["tiles_done"].as_u64() > Some(2));
    coordinator.ok(&format!("pause {job}"));
    worker.kill();
    coordinator.ok(&format!("fetch {job} --partial -o some.pvs"));
    let pvs = Pvs::open(sandbox.path("some.pvs")).unwrap();
    let aside = (0..pvs.cells()).filter(|cell| pvs.is_set_aside(*cell).unwrap());
    let cells: Vec<u32> = aside.collect();
    assert!(!cells.is_empty(), "the job was over before the pause");
    for cell in cells {
        let [visible, undecided] = [pvs.visible_count(cell), pvs.undecided_count(cell)];
        let shown = visible.unwrap();
        assert!(0 < shown && shown < pvs.triangle_count());
        assert_eq!(shown, undecided.unwrap());
    }
    coordinator.ok(&format!("resume {job}"));
    let _worker = coordinator.worker();
    coordinator.finish(job);
}

#[test]
fn weights_of_viewpoints_choose_cells() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    sandbox.write("eyes.txt", EYES);
    let options =
        "--viewpoints eyes.txt --reach 3 --backend cpu --target-error 0.003 --cell-to-cell off";
    sandbox.ok(&format!(
        "bake rooms.glb -o fine.pvs --cells 8x2x6 {options}"
    ));
    // Without a budget, the weight of a cell is the number of its marked parts.
    let parts = weights(&sandbox, "fine.pvs").unwrap();
    let marked = sandbox.json("info fine.pvs")["info"]["viewpoints"]["parts"].clone();
    assert_eq!(parts.iter().sum::<u64>(), marked.as_u64().unwrap());
    let reached = sandbox.json("info fine.pvs")["reached"].as_f64().unwrap();
    assert!((reached - parts.iter().sum::<u64>() as f64 / (64.0 * 96.0)).abs() < 1e-12);

    sandbox.ok(&format!(
        "bake rooms.glb -o weighted.pvs --cell-budget 3 --fine 8x2x6 {options}"
    ));
    let of_points = weights(&sandbox, "weighted.pvs").unwrap();
    assert!(
        of_points.iter().sum::<u64>().abs_diff(1 << 24) < 100,
        "{of_points:?}"
    );
    // The cell of the guard has the weight of the guard.
    let pvs = Pvs::open(sandbox.path("weighted.pvs")).unwrap();
    let guard = pvs.find_cell([3.0, 1.5, 3.0]).unwrap() as usize;
    assert!(of_points[guard] as f64 >= 20.0 / 22.0 * f64::from(1 << 24) - 100.0);
    // Every reached fine cell lies in a cell with a set.
    assert_unions(&sandbox.dump("fine.pvs"), &sandbox.dump("weighted.pvs"));
    // With the weights, no other choice has a smaller expected set.
    sandbox.ok("bake rooms.glb -o plain.pvs --from fine.pvs --cell-budget 3");
    sandbox
        .ok("bake rooms.glb -o united.pvs --from fine.pvs --cell-budget 3 --viewpoints eyes.txt");
    assert_eq!(
        sandbox.dump("united.pvs").cells,
        sandbox.dump("weighted.pvs").cells
    );
    let set_of_guard = |name: &str| {
        let pvs = Pvs::open(sandbox.path(name)).unwrap();
        pvs.visible_count(pvs.find_cell([3.0, 1.5, 3.0]).unwrap())
            .unwrap()
    };
    assert!(set_of_guard("weighted.pvs") <= set_of_guard("plain.pvs"));
}

#[test]
fn bad_combinations_have_errors() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 300 -o rooms.glb");
    sandbox.write("eyes.txt", EYES);
    sandbox.write("far.txt", "900 900 900\n");
    sandbox.write("words.txt", "one two three\n");
    for (options, says) in [
        ("--cell-budget 0", "0"),
        ("--byte-budget 0", "at least 1"),
        ("--cell-budget 4 --byte-budget 4kB", "--byte-budget needs"),
        ("--cell-budget 4 --cells 8x8x8", "--cells needs"),
        ("--cell-budget 4 --cell-size 1", "--cell-size needs"),
        ("--cell-budget 4 --triangle-budget 9", "--cell-budget needs"),
        ("--fine 4x4x4", "--fine needs"),
        ("--cost bytes", "--cost needs"),
        ("--cell-budget 4 --fine 40x4x4", "40x4x4 fine cells"),
        ("--cell-budget 4 --viewpoints eyes.txt", "--reach"),
        (
            "--cell-budget 4 --contributions",
            "contributions cannot be combined",
        ),
        (
            "--cell-budget 4 --max-error 0.1",
            "max-error cannot be combined",
        ),
        (
            "--cell-budget 4 --method exact --certificates",
            "certificates cannot be combined",
        ),
        ("--from fine.pvs", "--from needs --cell-budget"),
        (
            "--from fine.pvs --cell-budget 4 --seed 3",
            "--seed and --from",
        ),
        (
            "--from fine.pvs --cell-budget 4 --workers 2",
            "--workers and --from",
        ),
    ] {
        let run = sandbox.run(&format!("bake rooms.glb -o out.pvs {options}"));
        run.code(2).says(says);
    }
    for (options, says) in [
        ("--cell-budget 4 --viewpoints far.txt --reach 1", "far.txt"),
        (
            "--cell-budget 4 --viewpoints words.txt --reach 1",
            "words.txt",
        ),
        (
            "--cell-budget 4 --viewpoints none.txt --reach 1",
            "none.txt",
        ),
        ("--from none.pvs --cell-budget 4", "none.pvs"),
    ] {
        let run = sandbox.run(&format!("bake rooms.glb -o out.pvs {options}"));
        run.code(3).says(says);
    }
    let bake = "bake rooms.glb --backend cpu --target-error 0.1";
    sandbox.ok(&format!("{bake} -o fine.pvs --cells 2x1x2"));
    sandbox.ok("generate slits -o slits.glb");
    sandbox
        .run("bake slits.glb -o out.pvs --from fine.pvs --cell-budget 2")
        .code(3)
        .says("another scene");
    sandbox
        .run("bake rooms.glb -o out.pvs --from fine.pvs --cell-budget 2 --viewpoints far.txt")
        .code(3)
        .says("far.txt");
    // A budget below every division gives the smallest one, with a warning in the result.
    let text = sandbox.ok(&format!("{bake} -o small.pvs --byte-budget 1 --fine 2x1x2"));
    assert!(text.contains("NOT WITHIN THE BUDGET"), "{text}");
    assert_eq!(sandbox.dump("small.pvs").cells.len(), 1);
}
