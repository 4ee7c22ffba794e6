//! Tests of `sightline ambient` as a user runs it: answers for points, and a copy of the scene's file with
//! its occlusion.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::Value;
use sightline_tests::{Sandbox, assert_same};

/// A floor of 8 × 8 and a ceiling of the same size at the height 1, as OBJ. Their fronts face each other.
const HALL: &str = "o floor\nv -4 -4 0\nv 4 -4 0\nv 4 4 0\nv -4 4 0\nf 1 2 3 4\n\
                    o ceiling\nv -4 -4 1\nv -4 4 1\nv 4 4 1\nv 4 -4 1\nf 5 6 7 8\n";

const MIDDLE: &str = r#"{"id":"middle","point":[0,0,0],"normal":[0,0,2],"triangle":0}"#;

fn hall() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write("hall.obj", HALL);
    sandbox.write("points.jsonl", format!("{MIDDLE}\n"));
    sandbox
}

#[test]
fn points_are_answered_in_order() {
    let sandbox = hall();
    let above = r#"{"id":2,"point":[0.5,0.5,1.5],"normal":[0,0,1]}"#;
    sandbox.write("points.jsonl", format!("{MIDDLE}\n{above}\n"));
    sandbox.write(
        "lights.jsonl",
        r#"{"id":"lamp","polygon":[[-1,-1,2],[1,-1,2],[1,1,2],[-1,1,2]]}"#,
    );
    let out = sandbox.ok(
        "ambient hall.obj --points points.jsonl --lights lights.jsonl --distance 2 --fragments --threads 1",
    );
    let lines: Vec<Value> = out
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let [middle, above] = &lines[..] else {
        panic!("{out}")
    };
    // The ceiling hides a disc of the hemisphere, with the share sin² of its angle.
    assert!(
        (middle["open"].as_f64().unwrap() - 0.25).abs() < 1e-9,
        "{middle}"
    );
    assert!(middle["bound"].as_f64().unwrap() < 1e-9);
    assert_eq!(
        (&middle["id"], &middle["lights"]["lamp"], &middle["inside"]),
        (&"middle".into(), &0.0.into(), &false.into())
    );
    let factors = middle["fragments"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["factor"].as_f64().unwrap());
    assert!((factors.sum::<f64>() - 0.75).abs() < 1e-9, "{middle}");
    assert!(
        middle["fragments"]
            .as_array()
            .unwrap()
            .iter()
            .all(|f| f["triangle"].as_u64().unwrap() > 1)
    );
    assert_eq!(
        (&above["id"], above["open"].as_f64().unwrap()),
        (&2.into(), 1.0)
    );
    assert!(above["lights"]["lamp"].as_f64().unwrap() > 0.3, "{above}");
    assert_eq!(above["fragments"], Value::Array(Vec::new()));
}

#[test]
fn unanswerable_points_are_rejected_with_reason() {
    let sandbox = hall();
    let ambient = |flags: &str| sandbox.run(&format!("ambient hall.obj {flags}"));
    for (distance, text) in [
        ("0", "not a number above 0"),
        ("-1", "not a number above 0"),
        ("far", "not a number above 0"),
    ] {
        ambient(&format!("--points points.jsonl --distance {distance}"))
            .code(3)
            .says(text);
    }
    ambient("--points points.jsonl --distance inf --falloff sqrt")
        .code(3)
        .says("finite");
    for (line, text) in [
        (r#"{"point":[0,0,0],"normal":[0,0,0]}"#, "no direction"),
        (r#"{"point":[0,0,0]}"#, "normal"),
        (r#"{"point":[0,0,null],"normal":[0,0,1]}"#, "line 2"),
        (
            r#"{"point":[0,0,1e300],"normal":[0,0,1]}"#,
            "is out of range",
        ),
        (
            r#"{"point":[0,0,0],"normal":[0,0,1],"triangle":4}"#,
            "no triangle 4",
        ),
        (
            r#"{"point":[0,0,0],"normal":[0,0,1],"tringle":4}"#,
            "tringle",
        ),
    ] {
        sandbox.write("bad.jsonl", format!("{MIDDLE}\n{line}\n"));
        let run = ambient("--points bad.jsonl")
            .code(3)
            .says(text)
            .says("before the bad line");
        assert_eq!(
            run.out.lines().count(),
            1,
            "the point before it is answered"
        );
    }
    for (line, text) in [
        (r#"{"id":"a","polygon":[[0,0,2],[1,0,2]]}"#, "2 corners"),
        (
            r#"{"id":"a","polygon":[[0,0,2],[1,0,2],[2,0,2]]}"#,
            "no area",
        ),
        (
            r#"{"id":"a","polygon":[[0,0,2],[1,0,2],[1,1,2.5],[0,1,2]]}"#,
            "not in the plane",
        ),
        (
            r#"{"id":"a","polygon":[[0,0,2],[4,0,2],[1,1,2],[0,4,2]]}"#,
            "not convex",
        ),
        (
            r#"{"id":[],"polygon":[[0,0,2],[4,0,2],[0,4,2]]}"#,
            "name or a number",
        ),
    ] {
        sandbox.write("lights.jsonl", line);
        ambient("--points points.jsonl --lights lights.jsonl")
            .code(3)
            .says(text);
    }
    ambient("").code(2);
    ambient("-o hall.glb --fragments").code(2);
    ambient("-o out.glb --texel 0").code(3).says("--texel");
    ambient("-o out.glb --resolution 20000")
        .code(3)
        .says("16384");
    ambient("-o out.glb --texel 0.00001")
        .code(3)
        .says("--texel");
    ambient("-o out.glb --uv keep").code(3).says("TEXCOORD_1");
    ambient("-o hall.obj").code(3);
    ambient("--points points.jsonl --cull-back-faces")
        .code(2)
        .says("both sides");
    ambient("-o out.glb --cull-back-faces")
        .code(2)
        .says("both sides");
    ambient("--points .").code(3).says("give --points a file");
    sandbox.write("none.jsonl", "");
    let none = ambient("--points none.jsonl").code(0);
    assert_eq!(none.err.lines().last(), Some("0 points"), "{}", none.err);
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    sandbox
        .run("ambient town.glb -o town.glb")
        .code(3)
        .says("input itself");
}

/// Bakes the occlusion into a file. Returns the report.
fn bake(sandbox: &Sandbox, flags: &str) -> Value {
    sandbox.json(&format!("ambient hall.obj -o out.glb --distance 2 {flags}"))
}

#[test]
fn scene_file_gets_occlusion() {
    let sandbox = hall();
    let told = bake(&sandbox, "--resolution 64 --workers 1 --data-dir one");
    let written = sandbox.read("out.glb");
    assert_eq!(told["texture"]["width"], 64, "{told}");
    assert!(
        told["points"].as_u64() >= told["receivers"].as_u64() && told["inside"] == 0,
        "{told}"
    );
    // The mean is a quarter in the middle, and more at the borders.
    let mean = told["mean_open"].as_f64().unwrap();
    assert!((0.25..0.6).contains(&mean), "{told}");
    // Two workers, and stored tiles, give the same bytes.
    for flags in ["--workers 2 --data-dir two", "--workers 1 --data-dir one"] {
        bake(&sandbox, &format!("--resolution 64 {flags}"));
        assert_same(&written, &sandbox.read("out.glb"), flags);
    }
    // A cluster gives the same bytes, too.
    let coordinator = sandbox.coordinator("cluster", "127.0.0.1:0");
    let _worker = coordinator.worker();
    bake(
        &sandbox,
        &format!("--resolution 64 --coordinator {}", coordinator.url),
    );
    assert_same(&written, &sandbox.read("out.glb"), "a cluster");
    let scene = |name: &str| sightline_scene::load(&sandbox.path(name)).unwrap();
    assert_eq!(scene("out.glb").triangles(), scene("hall.obj").triangles());
    let told = bake(&sandbox, "--to vertices --data-dir one");
    assert_eq!(
        (&told["texture"], told["receivers"].as_u64().unwrap() >= 8),
        (&Value::Null, true),
        "{told}"
    );
    assert_eq!(scene("out.glb").triangles(), scene("hall.obj").triangles());
}
