//! Tests of culled back faces, from the flag to results, measurements and rejections.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::collections::BTreeSet;
use std::fmt::Write as _;

use sightline_tests::{Sandbox, assert_same};

/// Appends a block to an OBJ file, with faces counter-clockwise as seen from outside or from inside.
fn block(text: &mut String, name: &str, [lo, hi]: [[f32; 3]; 2], inside: bool) {
    writeln!(text, "o {name}").unwrap();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (at, outwards) in [(lo[axis], false), (hi[axis], true)] {
            let mut corners = [
                [lo[u], lo[v]],
                [hi[u], lo[v]],
                [hi[u], hi[v]],
                [lo[u], hi[v]],
            ];
            if outwards == inside {
                corners.reverse();
            }
            for corner in corners {
                let mut p = [at; 3];
                [p[u], p[v]] = corner;
                writeln!(text, "v {} {} {}", p[0], p[1], p[2]).unwrap();
            }
            writeln!(text, "f -4 -3 -2 -1").unwrap();
        }
    }
}

/// Returns a folder with a room whose walls are visible from inside, a crate in the room, and a post outside,
/// with twelve triangles each. Of three cells, the first is in the room and the last is outside.
fn sandbox() -> Sandbox {
    let mut text = String::new();
    block(&mut text, "room", [[0.0; 3], [4.0; 3]], true);
    block(
        &mut text,
        "crate",
        [[1.53, 1.57, 1.49], [2.51, 2.43, 2.52]],
        false,
    );
    block(
        &mut text,
        "post",
        [[9.0, 1.0, 1.0], [10.0, 3.0, 3.0]],
        false,
    );
    let sandbox = Sandbox::new();
    sandbox.write("room.obj", text);
    sandbox
}

const JOB: &str = "room.obj --cells 3x1x1 --view-box 0.5,0.5,0.5,7.7,3.5,3.5";

fn bake(sandbox: &Sandbox, name: &str, flags: &str) -> Vec<BTreeSet<u64>> {
    sandbox
        .run(&format!(
            "bake {JOB} -o {name}.pvs --data-dir {name} {flags}"
        ))
        .code(0);
    let dump = sandbox.dump(&format!("{name}.pvs"));
    dump.cells
        .iter()
        .map(|c| c.visible.iter().copied().collect())
        .collect()
}

#[test]
fn walls_culled_from_outside_show_room_behind_them() {
    let sandbox = sandbox();
    let sees =
        |set: &BTreeSet<u64>, ids: std::ops::Range<u64>| ids.clone().any(|t| set.contains(&t));
    for (name, flags) in [
        ("lines", "--backend cpu"),
        ("guided", "--backend cpu --sampler guided"),
        ("cubes", "--backend cpu --sampler cubes --resolution 64"),
        ("lines-gpu", "--backend gpu"),
        ("cubes-gpu", "--backend gpu --sampler cubes --resolution 32"),
    ] {
        let sets = bake(&sandbox, name, &format!("--cull-back-faces {flags}"));
        assert!(
            (0..12).all(|t| sets[0].contains(&t)),
            "{name}: the walls are seen from inside"
        );
        assert!(
            sees(&sets[0], 12..24) && !sees(&sets[0], 24..36),
            "{name}: and nothing outside"
        );
        assert!(
            sees(&sets[2], 12..24) && sees(&sets[2], 24..36),
            "{name}: from outside the crate is seen"
        );
        assert!(
            sees(&sets[2], 0..2) && !sees(&sets[2], 2..4),
            "{name}: and the far wall, not the near one"
        );
        // This side of the post faces away.
        assert!(!sees(&sets[2], 26..28), "{name}");
        // The measurement culls like the result.
        let report = sandbox.json(&format!(
            "measure room.obj {name}.pvs --viewpoints 8 --resolution 64"
        ));
        assert!(
            report["mean_error"].as_f64().unwrap() < 1e-3,
            "{name}: {report}"
        );
    }
    let info = sandbox.json("info lines.pvs");
    assert_eq!(info["info"]["cull_back_faces"], true, "{info}");
    assert!(
        sandbox
            .ok("info lines.pvs")
            .contains("back faces are culled")
    );
    // Without the flag, the walls block from both sides.
    let plain = bake(&sandbox, "plain", "--backend cpu");
    assert!(!sees(&plain[2], 12..24) && sees(&plain[2], 2..4));
    assert!(sandbox.json("info plain.pvs")["info"]["cull_back_faces"].is_null());
    sandbox
        .run("measure room.obj plain.pvs --cull-back-faces")
        .code(3)
        .says("other flags");
}

#[test]
fn workers_do_not_affect_bytes_of_culled_bake() {
    let sandbox = sandbox();
    for (sampler, more) in [
        ("lines", "--block-cells 1 --cell-to-cell on"),
        ("cubes", "--resolution 32"),
    ] {
        let bytes = [1, 4].map(|workers| {
            let name = format!("{sampler}{workers}");
            let flags = format!("--cull-back-faces --backend cpu --sampler {sampler} {more}");
            bake(&sandbox, &name, &format!("{flags} --workers {workers}"));
            sandbox.read(&format!("{name}.pvs"))
        });
        assert_same(&bytes[0], &bytes[1], sampler);
    }
}

#[test]
fn exact_commands_reject_culled_scenes_with_remedy() {
    let sandbox = sandbox();
    for method in ["exact", "verified"] {
        sandbox
            .run(&format!(
                "bake {JOB} -o x.pvs --cull-back-faces --method {method}"
            ))
            .code(2)
            .says("give aggressive, or omit --cull-back-faces");
    }
    bake(
        &sandbox,
        "a",
        "--cull-back-faces --backend cpu --target-error 0.01",
    );
    sandbox
        .run("verify room.obj a.pvs")
        .code(3)
        .says("without --cull-back-faces");
    sandbox
        .run("query a.pvs 1 1 1 --why 3 --scene room.obj")
        .code(3)
        .says("was baked with --cull-back-faces");
    let triangle = |x: f32| format!("[[{x},1.9,1.9],[{x},2.1,1.9],[{x},2.1,2.1]]");
    sandbox.write(
        "q.jsonl",
        format!(r#"{{"id":1,"a":{},"b":{}}}"#, triangle(1.0), triangle(5.9)),
    );
    sandbox
        .run("sightlines room.obj --queries q.jsonl --cull-back-faces")
        .code(3)
        .says("culls back faces");
}
