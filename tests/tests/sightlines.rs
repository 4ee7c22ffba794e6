//! Tests of `sightline sightlines`: one output line for each input line, in order. Invalid queries are named,
//! and every answer is checked.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use sightline_tests::{Sandbox, program};

/// A wall 10 × 10 at z = 5 with a slit of width 1e-4 along x at the middle, as an OBJ.
const WALL: &str = "\
v -5 -5 5\nv 5 -5 5\nv 5 0 5\nv -5 0 5
v -5 0.0001 5\nv 5 0.0001 5\nv 5 5 5\nv -5 5 5
f 1 2 3 4\nf 5 6 7 8\n";

fn square(at: [f64; 2], half: f64, z: f64) -> Value {
    let [x, y] = at;
    json!([
        [x - half, y - half, z],
        [x + half, y - half, z],
        [x + half, y + half, z],
        [x - half, y + half, z]
    ])
}

fn lines(text: &str) -> Vec<Value> {
    text.lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect()
}

#[test]
fn queries_are_answered_in_order() {
    let sandbox = Sandbox::new();
    sandbox.write("wall.obj", WALL);
    let queries = [
        // Through the slit.
        json!({"id": "slit", "a": square([0.0, 0.0], 1.0, 0.0), "b": square([0.0, 0.0], 1.0, 10.0)}),
        // Both polygons are above the slit: only lines in one plane could meet it.
        json!({"id": 2, "a": square([0.0, 2.0], 1.0, 0.0), "b": square([0.0, 2.0], 1.0, 10.0)}),
        // Both polygons are on one side of the wall.
        json!({"id": [3], "a": square([0.0, 0.0], 1.0, 0.0), "b": square([0.0, 0.0], 1.0, 4.0)}),
        // The lines pass around the wall.
        json!({"a": square([0.0, 0.0], 20.0, 0.0), "b": square([0.0, 2.0], 1.0, 10.0)}),
        // The polygon b is on the wall, which does not block it.
        json!({"id": 5, "a": square([0.0, 2.0], 1.0, 0.0), "b": square([0.0, 2.0], 1.0, 5.0)}),
    ];
    let text: String = queries.iter().map(|q| format!("{q}\n\n")).collect();
    sandbox.write("q.jsonl", text);
    let out = sandbox.ok("sightlines wall.obj --queries q.jsonl --check");
    let answers = lines(&out);
    assert_eq!(
        answers.iter().map(|a| a["id"].clone()).collect::<Vec<_>>(),
        [json!("slit"), json!(2), json!([3]), json!(null), json!(5)]
    );
    let states: Vec<&str> = answers
        .iter()
        .map(|a| a["state"].as_str().unwrap())
        .collect();
    assert_eq!(
        states,
        ["visible", "hidden", "visible", "visible", "visible"]
    );
    assert_eq!(answers[1]["blockers"], json!([2, 3]));
    // The witness passes through the slit.
    let point = |k: usize| -> Vec<f64> {
        answers[0]["witness"][k]
            .as_array()
            .unwrap()
            .iter()
            .map(|c| c.as_f64().unwrap())
            .collect()
    };
    let (p, q) = (point(0), point(1));
    assert_eq!((p[2], q[2]), (0.0, 10.0));
    let y = (p[1] + q[1]) / 2.0;
    assert!(y > 0.0 && y < 0.0001, "{y}");
    assert!(answers.iter().all(|a| a["micros"].is_u64()));
}

#[test]
fn invalid_query_is_named_after_answers_before_it() {
    let sandbox = Sandbox::new();
    sandbox.write("wall.obj", WALL);
    let good =
        json!({"id": 1, "a": square([0.0, 2.0], 1.0, 0.0), "b": square([0.0, 2.0], 1.0, 10.0)});
    let flat = square([0.0, 0.0], 1.0, 0.0);
    for (bad, why) in [
        (json!({"a": flat}).to_string(), "missing field `b`"),
        ("{".to_owned(), "the line is not a query"),
        (
            json!({"a": flat, "b": [[0, 0, 1], [1, 1, 2], [2, 2, 3]]}).to_string(),
            "polygon b: the polygon has no area",
        ),
        (
            json!({"a": [[0, 0, 0], [4, 0, 0], [1, 1, 0], [0, 4, 0]], "b": flat}).to_string(),
            "polygon a: the polygon is not convex",
        ),
        (
            json!({"a": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1]], "b": flat}).to_string(),
            "not in one plane",
        ),
        (
            json!({"a": [[1e300, 0, 0], [1, 0, 0], [1, 1, 0]], "b": flat}).to_string(),
            "beyond ±1e60",
        ),
        ("x".repeat(1 << 20), "bytes or more; split the query"),
    ] {
        sandbox.write("q.jsonl", format!("{good}\n{bad}\n{good}\n"));
        let run = sandbox.run("sightlines wall.obj --queries q.jsonl").code(3);
        assert_eq!(lines(&run.out).len(), 1, "{why}");
        assert!(
            run.err.contains("q.jsonl, line 2: ") && run.err.contains(why),
            "{why}: {}",
            run.err
        );
    }
    let run = sandbox
        .run("sightlines wall.obj --queries none.jsonl")
        .code(3);
    assert!(run.err.contains("none.jsonl cannot be read"), "{}", run.err);
}

#[test]
fn client_may_wait_for_each_answer() {
    let sandbox = Sandbox::new();
    sandbox.write("wall.obj", WALL);
    let mut child = Command::new(program())
        .args(["sightlines", "wall.obj", "--queries", "-"])
        .current_dir(sandbox.path(""))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut input = child.stdin.take().unwrap();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    for (id, state) in [(1, "hidden"), (2, "visible"), (3, "hidden")] {
        let y = if state == "hidden" { 2.0 } else { 0.0 };
        let query =
            json!({"id": id, "a": square([0.0, y], 1.0, 0.0), "b": square([0.0, y], 1.0, 10.0)});
        writeln!(input, "{query}").unwrap();
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        let answer: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(
            (&answer["id"], &answer["state"]),
            (&json!(id), &json!(state))
        );
    }
    drop(input);
    assert!(child.wait().unwrap().success());
}

#[test]
fn sequences_of_polygons_are_stabbed_or_blocked() {
    let sandbox = Sandbox::new();
    // Two squares at z = 0 and 1, and a third one at z = 2 that is moved along x: by 4 − 2⁻²⁰, and by 4.
    let moved = |far: &str| {
        let x = [
            format!("{}/1048576", far),
            format!("{}/1048576", far.parse::<i64>().unwrap() + 2097152),
        ];
        json!([[x[0], -1, 2], [x[1], -1, 2], [x[1], 1, 2], [x[0], 1, 2]])
    };
    let (first, second) = (square([0.0, 0.0], 1.0, 0.0), square([0.0, 0.0], 1.0, 1.0));
    let queries = [
        json!({"id": "just", "portals": [first, second, moved("3145727")]}),
        json!({"id": "no", "portals": [first, second, moved("3145728")]}),
        json!({"id": null, "portals": [second]}),
    ];
    sandbox.write(
        "q.jsonl",
        queries.iter().map(|q| format!("{q}\n")).collect::<String>(),
    );
    let answers = lines(&sandbox.ok("stab --queries q.jsonl"));
    let states: Vec<&Value> = answers.iter().map(|a| &a["state"]).collect();
    assert_eq!(states, ["stabbed", "blocked", "stabbed"]);
    assert_eq!(answers[0]["id"], "just");
    // The line through the two points is at most 1 from the axis at z = 1, and beyond 3 − 2⁻²⁰ at z = 2.
    let number = |v: &Value| match v.as_str().map(|s| s.split_once('/').unwrap()) {
        None => v.as_f64().unwrap(),
        Some((n, d)) => n.parse::<f64>().unwrap() / d.parse::<f64>().unwrap(),
    };
    let at = |k: usize| [0, 1, 2].map(|i| number(&answers[0]["line"][k][i]));
    let (p, q) = (at(0), at(1));
    let x = |z: f64| p[0] + (q[0] - p[0]) * (z - p[2]) / (q[2] - p[2]);
    assert!(x(1.0) < 1.0 && x(2.0) > 3.0 - 2e-6, "{} {}", x(1.0), x(2.0));
    for (bad, why) in [
        (json!({"portals": []}), "no polygons"),
        (
            json!({"portals": [[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]]]}),
            "not in one plane",
        ),
        (
            json!({"portals": [[[0, 0, "1/0"], [1, 0, 0], [1, 1, 0]]]}),
            "denominator of 0",
        ),
        (
            json!({"portals": [[[0, 0, "x"], [1, 0, 0], [1, 1, 0]]]}),
            "is not a fraction",
        ),
        (
            json!({"portals": [first, [[0, 0, 1e99], [1, 0, 0], [1, 1, 0]]]}),
            "polygon 1: a coordinate",
        ),
        (json!({"polygons": 3}), "the line is not a query"),
    ] {
        sandbox.write("q.jsonl", format!("{bad}\n"));
        let run = sandbox.run("stab --queries q.jsonl").code(3);
        assert!(
            run.err.contains("q.jsonl, line 1: ") && run.err.contains(why),
            "{why}: {}",
            run.err
        );
    }
}
