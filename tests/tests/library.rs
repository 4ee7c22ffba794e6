//! Tests of the library's examples on small scenes, and of the same bytes from library and command.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use sightline::{CellIndex, Error, ErrorKind, MeasureReport, Observer, TriangleId};
use sightline_tests::Sandbox;

#[path = "../../sightline/examples/bake.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod bake;

#[path = "../../sightline/examples/check.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod check;

#[path = "../../sightline/examples/submit.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod submit;

#[path = "../../sightline/examples/tiles.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod tiles;

/// Generates a scene of 400 triangles.
fn rooms() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 400 -o rooms.glb");
    sandbox
}

#[test]
fn examples_bake_bytes_of_command() {
    let sandbox = rooms();
    let path = |name: &str| sandbox.path(name);
    sandbox.ok("bake rooms.glb --cells 4x2x4 --backend cpu -o command.pvs --data-dir command");
    let expected = sandbox.read("command.pvs");

    let local = sightline::Local {
        output: Some(path("local.pvs")),
        data_dir: Some(path("local")),
        ..Default::default()
    };
    bake::bake_file(&path("rooms.glb"), &local).unwrap();
    assert!(
        sandbox.read("local.pvs") == expected,
        "the library's bytes differ"
    );

    let coordinator = sandbox.coordinator("farm", "127.0.0.1:0");
    let _worker = coordinator.worker();
    let job = submit::bake_at(&coordinator.url, &path("rooms.glb"), &path("farm.pvs")).unwrap();
    assert_eq!(
        (job.state_name(), job.message().name.as_str()),
        ("done", "example")
    );
    assert!(
        sandbox.read("farm.pvs") == expected,
        "the farm's bytes differ"
    );

    sandbox.ok(
        "bake rooms.glb --cells 4x2x4 --block-cells 8 --backend cpu -o blocks.pvs --data-dir command",
    );
    let folder = path("plan").display().to_string();
    let count = tiles::bake_in_tiles(&path("rooms.glb"), &folder, &path("tiles.pvs")).unwrap();
    assert_eq!(count, 4);
    assert!(
        sandbox.read("tiles.pvs") == sandbox.read("blocks.pvs"),
        "the tiles' bytes differ"
    );
}

#[test]
fn example_measures_verifies_and_explains() {
    let sandbox = rooms();
    sandbox.ok(
        "bake rooms.glb --cells 2x1x1 --backend cpu --method exact --certificates -o rooms.pvs \
         --data-dir data",
    );
    let checked =
        check::check_files(&sandbox.path("rooms.glb"), &sandbox.path("rooms.pvs")).unwrap();
    assert!(checked.verdict.is_accepted(), "{}", checked.verdict);
    let MeasureReport::Frames(frames) = checked.report else {
        unreachable!("frames were asked for");
    };
    assert_eq!((frames.report.frames, frames.report.max_error), (20, 0.0));
    let state = checked.reason["state"].as_str().unwrap();
    assert!(["visible", "hidden"].contains(&state), "{}", checked.reason);
}

#[test]
fn explain_rejects_another_scene() {
    let sandbox = rooms();
    sandbox.ok("generate rooms --triangles 300 -o other.glb");
    sandbox.ok("bake rooms.glb --cells 2x1x1 --backend cpu -o rooms.pvs --data-dir data");
    let (file, path) = (sandbox.path("other.glb"), sandbox.path("rooms.pvs"));
    let source = sightline::SceneSource::File(file);
    let other = sightline::read_scene(&source, &Default::default(), &sightline::Silent).unwrap();
    let pvs = sightline::open(&path).unwrap();
    let result = sightline::NamedResult::new(&pvs, &path);
    let last = pvs.triangle_count() - 1;
    let error = sightline::explain(
        result,
        Some(&other),
        CellIndex(0),
        TriangleId(last),
        &sightline::Silent,
    )
    .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert!(error.to_string().contains("another scene"), "{error}");
}

#[test]
fn cancelled_explain_returns_no_answer() {
    let sandbox = rooms();
    sandbox.ok("bake rooms.glb --cells 2x1x1 --backend cpu -o rooms.pvs --data-dir data");
    let path = sandbox.path("rooms.pvs");
    let source = sightline::SceneSource::File(sandbox.path("rooms.glb"));
    let scene = sightline::read_scene(&source, &Default::default(), &sightline::Silent).unwrap();
    let pvs = sightline::open(&path).unwrap();
    let result = sightline::NamedResult::new(&pvs, &path);
    let error = sightline::explain(result, Some(&scene), CellIndex(0), TriangleId(0), &Cancels)
        .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled);
}

#[test]
fn resolve_rejects_numbers_out_of_range_and_cancels() {
    let sandbox = rooms();
    let source = sightline::SceneSource::File(sandbox.path("rooms.glb"));
    let scene = sightline::read_scene(&source, &Default::default(), &sightline::Silent).unwrap();
    let rejected = |json: &str| {
        let options: sightline::JobOptions = serde_json::from_str(json).unwrap();
        let error = options.resolve(&scene, &sightline::Silent).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage, "{error}");
        error.option()
    };
    let heights = r#"{"eye_heights": [1.8, 1.2], "view_mesh": "absent.glb"}"#;
    assert_eq!(rejected(heights), Some("eye-heights"));
    let reach = r#"{"reach": -1.0, "viewpoints": "absent.txt"}"#;
    assert_eq!(rejected(reach), Some("reach"));

    let options = sightline::JobOptions {
        cells: Some(sightline::Cells::Walls(64)),
        viewpoints: sightline::ViewpointOptions {
            reachable_from: vec![[2.0, 1.5, 2.0]],
            ..Default::default()
        },
        ..Default::default()
    };
    let error = options.resolve(&scene, &Cancels).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled, "{error}");
}

/// An observer that cancels immediately.
struct Cancels;

impl Observer for Cancels {
    fn is_cancelled(&self) -> bool {
        true
    }
}

#[test]
fn observer_cancels_bake_that_continues_later() {
    let sandbox = rooms();
    let local = sightline::Local {
        data_dir: Some(sandbox.path("data")),
        ..Default::default()
    };
    let source = sightline::SceneSource::File(sandbox.path("rooms.glb"));
    let scene = sightline::read_scene(&source, &Default::default(), &sightline::Silent).unwrap();
    let options = sightline::JobOptions {
        cells: Some(sightline::Cells::Grid([16, 8, 16])),
        max_error: Some(1e-4),
        ..Default::default()
    };
    let job = options.resolve(&scene, &sightline::Silent).unwrap();
    let error: Error = sightline::bake(&scene, &job, &local, &Cancels).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled);
    assert!(error.to_string().contains("data"), "{error}");
    let smaller = sightline::JobOptions {
        cells: Some(sightline::Cells::Grid([2, 1, 2])),
        ..Default::default()
    };
    let job = smaller.resolve(&scene, &sightline::Silent).unwrap();
    let first = sightline::bake(&scene, &job, &local, &sightline::Silent).unwrap();
    let second = sightline::bake(&scene, &job, &local, &sightline::Silent).unwrap();
    assert_eq!((first.from_store, second.from_store), (false, true));
    assert!(first.pvs.bytes() == second.pvs.bytes());
}
