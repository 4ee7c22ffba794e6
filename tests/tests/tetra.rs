//! Tests of cells between surfaces and of point queries: built, checked, queried, and altered.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::f64::consts::PI;

use base64::Engine as _;
use serde_json::{Value, json};
use sightline_tests::{Sandbox, assert_same};

/// Returns a folder with a town and its cells.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    sandbox.ok("tetra town.glb -o town.tets");
    sandbox
}

fn answers(text: &str) -> Vec<Value> {
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn sum(numbers: &Value) -> f64 {
    numbers
        .as_array()
        .unwrap()
        .iter()
        .map(|x| x.as_f64().unwrap())
        .sum()
}

#[test]
fn cells_are_same_with_any_threads_and_pass_checker() {
    let sandbox = sandbox();
    let one = sandbox.json("tetra town.glb -o one.tets --threads 1 --export town.vtu");
    assert_same(
        &sandbox.read("one.tets"),
        &sandbox.read("town.tets"),
        "on one thread",
    );
    assert_eq!(one["bytes"], sandbox.read("one.tets").len());
    assert!(
        one["cells"].as_u64() > one["tetrahedra"].as_u64() && one["added"].as_u64() > Some(0),
        "{one}"
    );
    let report = sandbox.json("tetra --check town.glb town.tets");
    assert_eq!(
        (&report["accepted"], &report["cells"]),
        (&json!(true), &one["cells"])
    );
    // The number of entries of every array in the exported file equals the number in the file.
    let text = String::from_utf8(sandbox.read("town.vtu")).unwrap();
    let number = |name: &str| -> usize {
        text.split(&format!("{name}=\""))
            .nth(1)
            .unwrap()
            .split('"')
            .next()
            .unwrap()
            .parse()
            .unwrap()
    };
    let (points, cells) = (number("NumberOfPoints"), number("NumberOfCells"));
    let solid = one["exported"].as_u64().unwrap() as usize;
    let sizes = [
        ("Points", points * 24),
        ("connectivity", (solid * 4 + (cells - solid) * 3) * 8),
        ("offsets", cells * 8),
        ("types", cells),
        ("cell", cells * 8),
        ("solids", cells * 8),
        ("triangle", cells * 8),
    ];
    for (name, size) in sizes {
        let array = text
            .split(&format!("Name=\"{name}\""))
            .nth(1)
            .unwrap()
            .split('>')
            .nth(1)
            .unwrap();
        let bytes = array.split('<').next().unwrap().trim();
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(bytes)
            .unwrap();
        let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        assert_eq!((length, bytes.len() - 8), (size, size), "{name}");
    }
}

#[test]
fn engines_agree_and_parts_add_up() {
    let sandbox = sandbox();
    let target = json!([{"id": "door", "min": [10, 0, 4], "max": [11, 2, 5]}]);
    let mut lines = String::new();
    for (id, point) in [
        [1.0, 1.7, 3.0],
        [20.0, 9.0, 8.0],
        [-90.0, 40.0, 7.0],
        [10.5, 1.0, 4.5],
    ]
    .iter()
    .enumerate()
    {
        lines += &format!("{}\n", json!({"id": id, "point": point, "targets": target}));
    }
    lines += &format!(
        "{}\n",
        json!({"id": "cone", "point": [1, 1.7, 3], "direction": [2, 0, 0.5], "fov": 70})
    );
    lines += &format!(
        "{}\n",
        json!({"id": "near", "point": [1, 1.7, 3], "distance": 6})
    );
    sandbox.write("points.jsonl", &lines);
    let look = |flags: &str| {
        answers(&sandbox.ok(&format!("look town.tets --points points.jsonl {flags}")))
    };
    let exact = look("--areas --witnesses");
    assert_eq!(exact.len(), 6);
    for answer in &exact {
        let whole = if answer["id"] == "cone" {
            2.0 * PI * (1.0 - (35f64.to_radians()).cos())
        } else {
            4.0 * PI
        };
        let parts = sum(&answer["areas"])
            + answer["sky"].as_f64().unwrap()
            + answer["dropped"].as_f64().unwrap();
        assert!((parts - whole).abs() < 1e-9, "{parts} of {whole}");
        let visible = answer["visible"].as_array().unwrap();
        assert!(!visible.is_empty());
        for list in ["areas", "witnesses"] {
            assert_eq!(answer[list].as_array().unwrap().len(), visible.len());
        }
        assert_eq!(answer["inside"], false);
    }
    // The last point is inside the box.
    assert_eq!(
        exact[3]["targets"],
        json!([{"id": "door", "fraction": 1.0}])
    );
    assert!(
        exact[5]["visible"].as_array().unwrap().len()
            < exact[0]["visible"].as_array().unwrap().len()
    );
    let ids = |answers: &[Value]| -> Vec<Value> {
        answers.iter().map(|a| a["visible"].clone()).collect()
    };
    for flags in [
        "--engine tetra",
        "--engine bvh",
        "--engine auto --threads 3",
    ] {
        let other = look(flags);
        assert_eq!(ids(&other), ids(&exact), "{flags}");
        assert!(other[0].get("areas").is_none() && other[0].get("witnesses").is_none());
        let share = |a: &Value| a["targets"][0]["fraction"].as_f64().unwrap();
        for (a, b) in other.iter().zip(&exact).take(4) {
            assert!((share(a) - share(b)).abs() < 1e-9);
        }
    }
    let less = look("--mode aggressive --angle 1 --areas");
    let more = look("--mode conservative --angle 1 --areas");
    for ((less, exact), more) in less.iter().zip(&exact).zip(&more) {
        let visible_ids = |a: &Value| -> Vec<u64> {
            a["visible"]
                .as_array()
                .unwrap()
                .iter()
                .map(|id| id.as_u64().unwrap())
                .collect()
        };
        let (less, exact, more) = (visible_ids(less), visible_ids(exact), visible_ids(more));
        assert!(
            less.iter().all(|id| exact.contains(id)) && exact.iter().all(|id| more.contains(id))
        );
    }
    assert!(less.iter().any(|a| a["dropped"].as_f64().unwrap() > 0.0));
    // The command also accepts the other name of the option, and several threads.
    let other = answers(&sandbox.ok("look town.tets --eyes points.jsonl --threads 2"));
    assert_eq!(ids(&other), ids(&exact));
}

#[test]
fn bad_points_angles_and_files_are_rejected() {
    let sandbox = sandbox();
    sandbox.write("good.jsonl", "{\"point\":[1,2,3]}\n");
    let bad = |line: &str, why: &str| {
        // Blank lines are skipped, but they count in line numbers.
        sandbox.write("bad.jsonl", format!("{{\"point\":[1,2,3]}}\n \n{line}\n\n"));
        sandbox
            .run("look town.tets --points bad.jsonl")
            .code(3)
            .says("line 3")
            .says(why);
    };
    bad(r#"{"point":[NaN,0,0]}"#, "not a query");
    bad(r#"{"point":[1e39,0,0]}"#, "not a finite number below");
    bad(r#"{"point":[0,0]}"#, "not a query");
    bad(r#"{"point":[0,0,0],"eye":[0,0,0]}"#, "unknown field");
    bad(r#"{"point":[0,0,0],"direction":[0,0,0]}"#, "no length");
    bad(
        r#"{"point":[0,0,0],"direction":[1,0,0],"fov":0}"#,
        "degrees",
    );
    bad(
        r#"{"point":[0,0,0],"direction":[1,0,0],"fov":361}"#,
        "degrees",
    );
    bad(r#"{"point":[0,0,0],"fov":90}"#, "direction");
    bad(r#"{"point":[0,0,0],"distance":-1}"#, "positive");
    bad(
        r#"{"point":[0,0,0],"targets":[{"min":[1,0,0],"max":[0,1,1]}]}"#,
        "above its max",
    );
    bad(
        r#"{"point":[0,0,0],"direction":[1,0,0],"fov":1e-6}"#,
        "from 0.0001",
    );
    bad(
        r#"[1,[0,0,1],null,null,null,[]]"#,
        "the line is a JSON list",
    );
    sandbox.write("marked.jsonl", "\u{feff}{\"point\":[1,2,3]}\n");
    sandbox.ok("look town.tets --points marked.jsonl");
    sandbox
        .run("look town.tets --points .")
        .code(3)
        .says("cannot be read")
        .says("give --points a file");
    sandbox
        .run("tetra town.glb -o town.tets --export .")
        .code(2)
        .says("give --export the name");
    sandbox
        .run("tetra town.glb -o same --export ./same")
        .code(2)
        .says("--export");
    sandbox
        .run("tetra --check town.glb .")
        .code(3)
        .says("directory");
    sandbox.run("info .").code(3).says("directory");
    sandbox.write("line.obj", "v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n");
    sandbox.ok("tetra line.obj -o line.tets");
    assert!(
        sandbox
            .ok("tetra --check line.obj line.tets")
            .contains("each of 0 triangles")
    );
    // Each number is parsed as the nearest double, and is printed as the same number.
    sandbox.write(
        "ulp.jsonl",
        "{\"id\":0.9970588684082031,\"point\":[1,2,3]}\n",
    );
    let out = sandbox.ok("look town.tets --points ulp.jsonl");
    assert!(
        out.starts_with("{\"id\":0.9970588684082031,\"visible\":"),
        "{out}"
    );
    for angle in ["0", "-1", "nan", "181"] {
        let line = format!("look town.tets --points good.jsonl --mode aggressive --angle {angle}");
        sandbox.run(&line).code(3).says("--angle");
    }
    sandbox
        .run("look town.tets --points good.jsonl --angle 1")
        .code(2)
        .says("--mode");
    let file = sandbox.read("town.tets");
    let refused = |bytes: &[u8], why: &str| {
        sandbox.write("x.tets", bytes);
        sandbox
            .run("look x.tets --points good.jsonl")
            .code(3)
            .says(why);
        sandbox
            .run("tetra --check town.glb x.tets")
            .code(3)
            .says(why);
    };
    refused(&[], "not a .tets file");
    refused(&file[..file.len() - 1], "cut short");
    refused(&file[..3], "cut short");
    let mut altered = file.clone();
    altered[file.len() / 2] ^= 1;
    refused(&altered, "altered");
    sandbox
        .run("look none.tets --points good.jsonl")
        .code(3)
        .says("none.tets");
    // A file that is neither cells nor a result.
    sandbox
        .run("look good.jsonl --points good.jsonl")
        .code(3)
        .says("sightline tetra")
        .says(".pvs");
    sandbox.ok("generate town --triangles 2000 --seed 2 -o other.glb");
    sandbox
        .run("tetra --check other.glb town.tets")
        .code(3)
        .says("another scene");
    let refusal: Value = {
        let run = sandbox
            .run("--json tetra --check other.glb town.tets")
            .code(3);
        serde_json::from_str(run.out.trim()).unwrap()
    };
    assert_eq!(refusal["accepted"], false);
    sandbox.run("tetra town.glb").code(2).says("--output");
    sandbox
        .run("tetra town.glb -o town.glb")
        .code(2)
        .says(".glb");
    sandbox
        .run("tetra town.glb town.tets -o x.tets")
        .code(2)
        .says("--check");
    sandbox.run("tetra town.glb town.tets").code(2);
    sandbox.run("tetra --check town.glb").code(2);
    sandbox
        .run("tetra town.glb -o x.tets --cull-back-faces")
        .code(2)
        .says("--cull-back-faces");
    // A result has no such cells, and its input lines have another format.
    sandbox.ok("bake town.glb -o town.pvs --cells 2x1x2 --backend cpu --data-dir data");
    sandbox
        .run("look town.pvs --points good.jsonl --areas")
        .code(2)
        .says("--areas")
        .says("sightline tetra");
    sandbox
        .run("look town.pvs --points good.jsonl")
        .code(3)
        .says("no portals");
}

#[test]
fn exact_sets_contain_triangles_visible_from_points() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --grid 2x2 -o rooms.glb");
    sandbox.ok(
        "bake rooms.glb -o exact.pvs --method exact --cells 3x1x3 --backend cpu --data-dir data",
    );
    let exact = sandbox.json("measure rooms.glb exact.pvs --exact --viewpoints 60");
    assert_eq!(
        (&exact["frames"], &exact["frames_with_error"]),
        (&json!(60), &json!(0)),
        "{exact}"
    );
    assert!(exact["mean_seen"].as_f64().unwrap() > 100.0, "{exact}");
    sandbox.ok(
        "bake rooms.glb -o few.pvs --sampler lines --rays 20000 --cells 3x1x3 --backend cpu --data-dir data",
    );
    let few = sandbox.json("measure rooms.glb few.pvs --exact --viewpoints 60");
    assert!(
        few["mean_error"].as_f64().unwrap() > 0.0 && few["triangles_missed"].as_u64() > Some(0),
        "{few}"
    );
    let worst = &few["worst"][0];
    assert_eq!(worst["error"], few["max_error"]);
    let missed = worst["missed"].as_array().unwrap();
    let dump = sandbox.dump("few.pvs");
    let set = &dump.cells[worst["cell"].as_u64().unwrap() as usize].visible;
    assert!(
        !missed.is_empty()
            && missed
                .iter()
                .all(|id| set.binary_search(&id.as_u64().unwrap()).is_err())
    );
    sandbox
        .run("measure rooms.glb few.pvs --exact --resolution 64")
        .code(2)
        .says("--exact");
}
