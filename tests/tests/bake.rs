//! Tests of `sightline bake`: interrupted and continued, on every available backend, and with the options
//! that change its behaviour.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use serde_json::Value;
use sightline_tests::{Dump, Sandbox, assert_same, in_ci, wait_for};

const ROOMS: &str = "generate rooms --triangles 2000 -o rooms.glb";
const MAZE: &str = "generate maze --grid 3x3 -o maze.glb";
/// The arguments of a bake that takes about a second.
const QUICK: &str = "maze.glb --cells 2x2x1 --resolution 32 --backend cpu --data-dir data";

#[test]
fn interrupted_bake_continues_and_gives_same_bytes() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    let job = "rooms.glb --sampler cubes --cells 4x4x2 --resolution 96 --backend cpu";
    let whole = sandbox.json(&format!("bake {job} -o whole.pvs --data-dir whole"));
    // Ctrl-C and a kill, each from a new start.
    for signal in ["INT", "KILL"] {
        let again = format!("bake {job} -o {signal}.pvs --data-dir {signal}");
        let bake = sandbox.start(&again);
        // Wait for the scene and some finished tiles.
        wait_for("finished tiles", || {
            (sandbox.files_below(&format!("{signal}/blobs")) > 8).then_some(())
        });
        bake.signal(signal);
        if signal == "INT" {
            bake.end().code(130).says("the same command continues");
        } else {
            bake.kill();
        }
        let output = format!("{signal}.pvs");
        assert!(!sandbox.path(&output).exists(), "no result before the end");

        let continued = sandbox.run(&again).code(0).says("continuing: ");
        let said = continued.err.split("continuing: ").nth(1).unwrap();
        let mut words = said.split(' ');
        let done: u32 = words.next().unwrap().parse().unwrap();
        let total: u32 = words.nth(1).unwrap().parse().unwrap();
        assert!(
            0 < done && done < total,
            "{done} of {total} tiles were kept"
        );
        assert_same(&sandbox.read(&output), &sandbox.read("whole.pvs"), signal);

        // Another run has no tiles left to compute.
        let stored = sandbox
            .run(&format!("{again} --json"))
            .code(0)
            .says("in the store already");
        let stored: Value = serde_json::from_str(&stored.out).unwrap();
        assert_eq!(stored["from_store"], true);
        assert_eq!(
            stored["samples"], whole["samples"],
            "no sample is taken twice"
        );
        assert_same(
            &sandbox.read(&output),
            &sandbox.read("whole.pvs"),
            "from the store",
        );
    }
    assert_eq!(whole["from_store"], false);
}

#[test]
fn number_of_workers_does_not_affect_bytes() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    for n in [1, 4] {
        let line =
            format!("bake maze.glb --cells 3x3x2 --resolution 32 --backend cpu --workers {n}");
        sandbox.ok(&format!("{line} -o {n}.pvs --data-dir data-{n}"));
    }
    assert_same(
        &sandbox.read("1.pvs"),
        &sandbox.read("4.pvs"),
        "1 and 4 workers",
    );
}

#[test]
fn adaptive_cells_keep_to_budget_or_depth() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    let (budget, depth) = (120, 7);
    let division = format!("--triangle-budget {budget} --max-depth {depth}");
    for sampler in ["--sampler lines", "--sampler cubes --resolution 32"] {
        sandbox.ok(&format!(
            "bake maze.glb {division} {sampler} --backend cpu --data-dir data -o adaptive.pvs"
        ));
        keeps_to(&sandbox.dump("adaptive.pvs"), budget, depth);
    }
    // The default sampler, sight lines, gives the same bytes for any number of workers.
    for workers in [1, 4] {
        let options = format!("--backend cpu --workers {workers} --data-dir data-{workers}");
        sandbox.ok(&format!(
            "bake maze.glb {division} {options} -o {workers}.pvs"
        ));
    }
    assert_same(
        &sandbox.read("1.pvs"),
        &sandbox.read("4.pvs"),
        "1 and 4 workers",
    );
    assert!(sandbox.ok("info 1.pvs").contains("only cells of a grid"));
    let sampling = sampling_of(&sandbox.json("info 1.pvs")).clone();
    assert!(sampling["lines"].is_object(), "{sampling}");
    let measured = sandbox.json("measure maze.glb 1.pvs --viewpoints 20 --seed 3 --resolution 64");
    assert!(
        measured["mean_error"].as_f64().unwrap() < 1e-3,
        "{measured}"
    );
    sandbox
        .run(&format!(
            "bake maze.glb {division} --max-error 0.01 -o no.pvs --data-dir data"
        ))
        .code(2)
        .says("--cells");
}

/// Checks that the cells of an adaptive tree fill the view box, and that only cells at the maximum depth see
/// more triangles than the budget.
fn keeps_to(dump: &Dump, budget: usize, depth: u32) {
    let [low, high] = dump.view_box();
    let whole: f64 = (0..3).map(|axis| high[axis] - low[axis]).product();
    let mut halved = 0;
    for cell in &dump.cells {
        let level = (whole / cell.volume()).log2().round();
        assert!(level <= f64::from(depth), "{cell:?} is at level {level}");
        assert!(
            cell.visible.len() <= budget || level == f64::from(depth),
            "{cell:?} sees {} triangles at level {level}",
            cell.visible.len()
        );
        halved += usize::from(level > 0.0);
    }
    assert!(halved > 1, "the budget makes no difference here");
    let covered: f64 = dump.cells.iter().map(|cell| cell.volume()).sum();
    assert!(
        (covered / whole - 1.0).abs() < 1e-4,
        "the cells cover {covered} of {whole}"
    );
}

/// Returns the sampling of a result's job, from its description.
fn sampling_of(described: &serde_json::Value) -> &serde_json::Value {
    &described["info"]["spec"]["visibility"]["aggressive"]["sampling"]
}

#[test]
fn every_error_measure_and_superset_choice_works() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    for measure in ["sets", "pixels", "strata"] {
        let mut seen = Vec::new();
        for superset in ["on", "off"] {
            let options =
                format!("--sampler cubes --error-measure {measure} --superset {superset}");
            let made = sandbox.json(&format!(
                "bake {QUICK} {options} -o {measure}-{superset}.pvs"
            ));
            assert_eq!(sampling_of(&made)["cubes"]["measure"], measure);
            assert_eq!(sampling_of(&made)["cubes"]["superset"], superset);
            assert_eq!(
                made["from_store"], false,
                "each choice is a bake of its own"
            );
            assert!(made["min_visible"].as_u64().unwrap() > 0, "{made}");
            seen.push(sandbox.dump(&format!("{measure}-{superset}.pvs")).cells);
        }
        assert_eq!(seen[0].len(), seen[1].len());
    }
}

#[test]
fn view_box_is_the_requested_box() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    sandbox.ok(&format!(
        "bake {QUICK} --view-box 0.5,0.25,0.5,1.5,1.25,2.5 -o boxed.pvs"
    ));
    assert_eq!(
        sandbox.dump("boxed.pvs").view_box(),
        [[0.5, 0.25, 0.5], [1.5, 1.25, 2.5]]
    );
    let far = format!("bake {QUICK} --view-box 1000,1000,1000,1001,1001,1001 -o far.pvs");
    sandbox.run(&far).code(0).says("holds nothing of the scene");
    for bad in [
        "0,0,0,0,1,1",
        "1,1,1,0,0,0",
        "0,0,0,1,1,inf",
        "0,0,0,1,nan,1",
        "0,0,0,1,1",
    ] {
        sandbox
            .run(&format!("bake {QUICK} --view-box {bad} -o no.pvs"))
            .code(2);
    }
}

#[test]
fn cell_size_gives_fewest_cells_of_that_size() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    let bake = |flags: &str| {
        sandbox.run(&format!(
            "bake maze.glb --data-dir data -o sized.pvs {flags}"
        ))
    };
    bake("--view-box 0.5,0.25,0.5,1.5,1.25,2.5 --cell-size 0.6 --target-error 0.1").code(0);
    assert_eq!(sandbox.dump("sized.pvs").cells.len(), 2 * 2 * 4);
    for bad in [
        "--cell-size 0",
        "--cell-size -1",
        "--cell-size x",
        "--cell-size 1 --cells 2x2x2",
        "--cell-size 1e-9",
    ] {
        bake(bad).code(2);
    }
}

#[test]
fn unwritable_output_is_rejected_before_work() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    sandbox.write("notes", "keep me\n");
    for output in ["missing/out.pvs", ".", "notes", "/dev/null", "-"] {
        sandbox
            .run(&format!("bake {QUICK} -o {output}"))
            .code(2)
            .says("give -o");
    }
    for output in ["maze.glb", "./maze.glb", "out.obj"] {
        sandbox
            .run(&format!("bake {QUICK} -o {output}"))
            .code(2)
            .says("but the command writes a .");
    }
    assert!(!sandbox.path("data").exists());
    assert_eq!(sandbox.read("notes"), b"keep me\n");
    sandbox
        .run("generate maze -o notes")
        .code(2)
        .says("give -o");
    sandbox
        .run("mesh maze.glb -o maze.glb")
        .code(2)
        .says("but the command writes a .");
    sandbox.ok("mesh maze.glb -o maze.ply");
    sandbox
        .run("mesh maze.ply -o maze.ply")
        .code(2)
        .says("the input itself");
}

#[test]
fn flags_of_other_sampler_are_reported_without_effect() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    let bake = "bake maze.glb --cells 2x2x1 --backend cpu --data-dir data";
    sandbox.ok(&format!("{bake} -o a.pvs"));
    let again = sandbox
        .run(&format!("{bake} --resolution 64 --rays 5 -o b.pvs --json"))
        .code(0);
    again.says("does not use --rays, --resolution");
    assert_eq!(
        sandbox.json(&format!("{bake} --min-distance 1 -o c.pvs"))["from_store"],
        true
    );
    // Invalid values are rejected even for flags without effect.
    sandbox
        .run(&format!("{bake} --resolution 4 -o d.pvs"))
        .code(2);
    let cubes = format!("{bake} --sampler cubes --resolution 32 -o e.pvs");
    sandbox.ok(&cubes);
    assert_eq!(
        sandbox.json(&format!("{cubes} --block-cells 64"))["from_store"],
        true
    );
}

#[test]
fn smaller_tiles_use_more_workers_and_keep_target_error() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    let bake = "bake maze.glb --cells 4x4x4 --backend cpu --target-error 0.001";
    let make = |flags: &str, name: &str| {
        sandbox.ok(&format!("{bake} {flags} --data-dir {name} -o {name}.pvs"));
    };
    // The mean over seeds keeps the target error; one seed may miss it.
    for (flags, name) in [("", "whole"), ("--block-cells 8 --workers 1", "cut")] {
        let mut sum = 0.0;
        for seed in 1..=4 {
            make(&format!("{flags} --seed {seed}"), name);
            let measured = sandbox.json(&format!("measure maze.glb {name}.pvs --viewpoints 200"));
            sum += measured["mean_error"].as_f64().unwrap();
        }
        assert!(sum / 4.0 <= 0.001, "{name}: {}", sum / 4.0);
    }
    assert_ne!(
        sandbox.read("whole.pvs"),
        sandbox.read("cut.pvs"),
        "lines are shared within a tile only"
    );
    make("--block-cells 8 --workers 3 --seed 4", "more");
    assert_same(
        &sandbox.read("cut.pvs"),
        &sandbox.read("more.pvs"),
        "one worker and three",
    );
    sandbox
        .run(&format!("{bake} --block-cells 4097 -o no.pvs"))
        .code(2);
}

#[test]
fn bake_reports_cut_by_time_budget() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    let bake = "bake maze.glb --backend cpu --time-budget 1ms";
    sandbox.ok(&format!("{bake} --data-dir a -o a.pvs"));
    assert!(
        sandbox
            .ok("info a.pvs")
            .contains("NOT FINISHED: 512 of 512 cells: the time budget ended first")
    );
    sandbox.ok(&format!("{bake} --max-error 0.01 --data-dir b -o b.pvs"));
    assert!(
        sandbox
            .ok("info b.pvs")
            .contains("no cell reached the requested bound")
    );
    sandbox.ok(&format!("{bake} --sampler guided --data-dir d -o d.pvs"));
    assert!(
        sandbox
            .ok("info d.pvs")
            .contains("NOT FINISHED: 512 of 512")
    );
    // Cells that reach the target error count as finished, even if the bound asked for more lines.
    sandbox
        .ok("bake maze.glb --backend cpu --cells 2x2x2 --target-error 0.0003 --max-error 0.01 --data-dir \
        e -o e.pvs");
    assert!(!sandbox.ok("info e.pvs").contains("NOT FINISHED"));
    sandbox
        .run("bake maze.glb --max-error 2 -o f.pvs")
        .code(2)
        .says("max-error is 2");
    sandbox
        .ok("bake maze.glb --backend cpu --target-error 0.03 --cells 2x2x2 --data-dir c -o c.pvs");
    assert!(!sandbox.ok("info c.pvs").contains("NOT FINISHED"));
}

#[test]
fn flat_scene_needs_view_box() {
    let sandbox = Sandbox::new();
    sandbox.write(
        "flat.obj",
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n",
    );
    let bake =
        "bake flat.obj --cells 1x1x1 --resolution 32 --backend cpu --data-dir data -o flat.pvs";
    sandbox
        .run(bake)
        .code(3)
        .says("flat along z")
        .says("--view-box x0");
    sandbox.ok(&format!("{bake} --view-box 0,0,1,1,1,2"));
    assert_eq!(sandbox.dump("flat.pvs").cells[0].visible, [0, 1]);
}

#[test]
fn gpu_backend_bakes_with_vulkan() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    let job = "bake maze.glb --cells 1x1x1 --resolution 32 --backend gpu -o gpu.pvs --json";
    let run = sandbox.run(&format!("{job} --data-dir data"));
    if run.err.contains("no backend can sample") && !in_ci() {
        run.code(1).says("gpu backend: ");
        eprintln!("skipped: there is no Vulkan here");
        return;
    }
    let made: Value = serde_json::from_str(&run.code(0).out).unwrap();
    assert!(
        made["info"]["profile"]
            .as_str()
            .unwrap()
            .starts_with("gpu/"),
        "{made}"
    );
    let first = sandbox.read("gpu.pvs");
    sandbox.ok(&format!("{job} --data-dir other"));
    assert_same(&sandbox.read("gpu.pvs"), &first, "two bakes on one adapter");
}

#[test]
fn default_backend_bakes_like_named_backend() {
    let sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    let job = "bake maze.glb --cells 2x2x1";
    let made = sandbox.json(&format!("{job} --data-dir unasked -o unasked.pvs"));
    let profile = made["info"]["profile"].as_str().unwrap();
    let named = profile.split('/').next().unwrap();
    assert!(["cpu", "gpu"].contains(&named), "{profile}");
    sandbox.ok(&format!(
        "{job} --backend {named} --data-dir named -o named.pvs"
    ));
    assert_same(
        &sandbox.read("unasked.pvs"),
        &sandbox.read("named.pvs"),
        profile,
    );
}

#[cfg(target_os = "linux")]
#[test]
fn missing_embree_is_reported_and_not_needed() {
    let mut sandbox = Sandbox::new();
    sandbox.ok(MAZE);
    // The loader finds these files first and cannot load them, as if Embree were missing.
    std::fs::create_dir(sandbox.path("hidden")).unwrap();
    for name in [
        "libembree4.so.4",
        "libembree3.so.3",
        "libembree4.so",
        "libembree3.so",
    ] {
        sandbox.write(&format!("hidden/{name}"), "not a library");
    }
    sandbox.set("LD_LIBRARY_PATH", sandbox.path("hidden"));
    let job = "bake maze.glb --cells 1x1x1 --resolution 32 --data-dir data -o out.pvs";
    sandbox
        .run(&format!("{job} --backend embree"))
        .code(1)
        .says("embree backend: Embree is not installed")
        .says("apt-get install");
    let made = sandbox.json(&format!("{job} --backend cpu"));
    assert_eq!(made["info"]["profile"], "cpu/1");
}

/// Checks that one worker gives the same bytes as three workers that are killed in the middle and started
/// again. Sight lines cross cells, and different workers bake different blocks.
#[test]
fn sight_lines_give_same_bytes_with_any_workers() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    let job = "rooms.glb --cells 12x8x8 --backend cpu --max-error 0.003";
    let one = sandbox.json(&format!("bake {job} -o one.pvs --data-dir one --workers 1"));
    assert_eq!(one["cells_bounded"], 768, "{one}");
    assert!(one["greatest_bound"].as_f64().unwrap() <= 0.003, "{one}");
    let bake = sandbox.start(&format!(
        "bake {job} -o three.pvs --data-dir three --workers 3"
    ));
    wait_for("work under way", || {
        (sandbox.files_below("three/blobs") > 0).then_some(())
    });
    bake.kill();
    sandbox.ok(&format!(
        "bake {job} -o three.pvs --data-dir three --workers 3"
    ));
    assert_same(
        &sandbox.read("one.pvs"),
        &sandbox.read("three.pvs"),
        "one worker, and three of which all were killed",
    );

    let shown = sandbox.json("info one.pvs --cells");
    let cells = shown["per_cell"].as_array().unwrap();
    assert_eq!(cells.len(), 768);
    for cell in cells {
        assert!(cell["rays_uniform"].as_u64().unwrap() > 0, "{cell}");
        assert!(cell["bound"].as_f64().unwrap() <= 0.003, "{cell}");
    }
}

#[test]
fn time_budget_ends_with_result() {
    let sandbox = Sandbox::new();
    sandbox.ok(ROOMS);
    let start = std::time::Instant::now();
    let made = sandbox.json(
        "bake rooms.glb --cells 8x8x8 --backend cpu --target-error 1e-6 --time-budget 1500ms -o out.pvs \
            --data-dir data",
    );
    // Without the budget this takes minutes. The limit leaves time for slow machines.
    assert!(start.elapsed() < std::time::Duration::from_secs(30));
    assert!(made["min_visible"].as_u64().unwrap() > 0, "{made}");
    sandbox
        .run("bake rooms.glb --time-budget 0s -o no.pvs --data-dir data")
        .code(2);
    sandbox
        .run("bake rooms.glb --sampler cubes --max-error 0.1 -o no.pvs --data-dir data")
        .code(2)
        .says("--sampler lines");
    sandbox
        .run("bake rooms.glb --sampler cubes --time-budget 1s -o no.pvs --data-dir data")
        .code(2);
    sandbox
        .run("bake rooms.glb --triangle-budget 9 --sampler guided -o no.pvs --data-dir data")
        .code(2)
        .says("lines or cubes");
}

#[test]
fn completion_adds_few_undecided_triangles() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 6x6 -o maze.glb");
    let job = "maze.glb --cells 6x2x6 --target-error 0.01 --backend cpu";
    let bake = |name: &str, options: &str| {
        let files = format!("-o {name}.pvs --data-dir {name}");
        sandbox.ok(&format!("bake {job} {options} {files}"));
        let dump = sandbox.dump(&format!("{name}.pvs"));
        let drawn: usize = dump.cells.iter().map(|c| c.visible.len()).sum();
        let undecided: usize = dump.cells.iter().map(|c| c.undecided.len()).sum();
        (drawn - undecided, undecided)
    };
    let (seen, likely) = bake("auto", "--complete auto");
    assert!(
        0 < likely && 20 * likely <= seen,
        "{likely} likely triangles, {seen} seen"
    );
    assert_eq!(bake("default", ""), (seen, likely));
    assert_eq!(bake("off", "--complete off").1, 0);
    assert_eq!(bake("exact", "--complete off --method exact").1, 0);
    for wrong in ["--method exact", "--sampler cubes", "--min-share 0.01"] {
        sandbox
            .run(&format!("bake {job} {wrong} --complete auto -o wrong.pvs"))
            .code(2)
            .says("--complete needs --method aggressive with --sampler lines");
    }
    // The bound counts lines that end on a triangle outside the drawn set.
    let bounded = "--complete auto --max-error 0.02";
    assert!(bake("bounded", bounded).1 > 0);
}
