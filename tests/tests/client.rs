//! Tests of a client in ten lines: it uploads a file, submits a job with the scene, and downloads the result,
//! only over HTTP. Also tests of the gRPC reflection by both of its names, and of the interface against its
//! frozen form.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::process::Command;

use sightline_tests::{Sandbox, ask, in_ci};

/// The client of docs/farm.md.
const CLIENT: &str = include_str!("../../docs/examples/client.py");

#[test]
fn ten_lines_of_python_bake_file() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 600 -o level.glb");
    let coordinator = sandbox.coordinator_with_pages("data");
    let _worker = coordinator.worker();
    sandbox.write("client.py", CLIENT);
    let python = Command::new("python3")
        .arg(sandbox.path("client.py"))
        .arg(&coordinator.pages)
        .arg(sandbox.path("level.glb"))
        .arg(sandbox.path("level.pvs"))
        .output();
    let run = match python {
        Ok(run) => run,
        Err(e) if !in_ci() => {
            eprintln!("not run: python3 cannot be started ({e})");
            return;
        }
        Err(e) => panic!("python3 cannot be started: {e}"),
    };
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    // The result equals the result of the program for the same file.
    sandbox.ok("bake level.glb -o here.pvs --backend cpu");
    assert_eq!(sandbox.dump("level.pvs").cells.len(), 512);
    let [there, here] = ["level.pvs", "here.pvs"].map(|name| sandbox.ok(&format!("dump {name}")));
    assert_eq!(there, here);
    let lines = CLIENT
        .lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .count();
    // The last line but one prints the reason why a job has no result.
    assert!(lines <= 11, "{lines} lines");
}

#[test]
fn invalid_scene_file_is_rejected_with_message() {
    let sandbox = Sandbox::new();
    let coordinator = sandbox.coordinator_with_pages("data");
    let send = |name: &str, kind: &str, body: &[u8]| {
        let headers = format!("Content-Type: {kind}\r\n");
        let (status, body) = ask(
            &coordinator.pages,
            &format!("POST /scenes?name={name}"),
            &headers,
            body,
        );
        (status, String::from_utf8(body).unwrap())
    };
    let bytes = "application/octet-stream";
    let refused = send("level.glb", bytes, b"no scene");
    assert!(
        refused.0 == 400 && refused.1.contains("level.glb"),
        "{refused:?}"
    );
    // The file cannot reference another file, because an upload is a single file.
    let outside =
        br#"{"asset":{"version":"2.0"},"buffers":[{"uri":"../../etc/passwd","byteLength":9}]}"#;
    let refused = send("level.gltf", bytes, outside);
    assert_eq!(refused.0, 400, "{refused:?}");
    assert_eq!(send("a.obj", "text/plain", b"v 0 0 0").0, 400);
    assert_eq!(
        send("a.obj", bytes, b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").0,
        200
    );
}

#[test]
fn coordinator_answers_result_queries_like_commands() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 400 -o level.glb");
    let coordinator = sandbox.coordinator_with_pages("data");
    let ask = |method: &str, request: &str| {
        let line = format!("POST /sightline.v1.Results/{method}");
        let (_, body) = ask(
            &coordinator.pages,
            &line,
            "Content-Type: application/json\r\n",
            request,
        );
        serde_json::from_slice::<serde_json::Value>(&body).unwrap()
    };
    let job = coordinator.submit("level.glb --cells 2x1x2 --method exact --backend cpu");
    let early = ask("Query", &format!(r#"{{"job":{job},"cell":0}}"#));
    assert_eq!(early["code"], "failed_precondition", "{early}");
    let _worker = coordinator.worker();
    coordinator.finish(job);
    let name = format!("fetched-{job}.pvs");
    let dump = sandbox.dump(&name);
    let set = ask("Query", &format!(r#"{{"job":{job},"cell":1}}"#));
    assert_eq!(set["visible"], serde_json::json!(dump.cells[1].visible));
    let [x, y, z] = dump.cells[3].middle();
    let point = format!(r#"{{"x":{x},"y":{y},"z":{z}}}"#);
    let objects = ask(
        "Query",
        &format!(r#"{{"job":{job},"point":{point},"objects":true}}"#),
    );
    assert_eq!(
        (
            &objects["cell"],
            objects["names"].as_array().unwrap().is_empty()
        ),
        (&3.into(), false)
    );
    // One visible and one hidden triangle, each with its reason.
    let seen = dump.cells[0].visible[0];
    let hidden = (0..400)
        .find(|id| dump.cells[0].visible.binary_search(id).is_err())
        .unwrap();
    let why = |triangle| {
        ask(
            "Why",
            &format!(r#"{{"job":{job},"cell":0,"triangle":{triangle}}}"#),
        )
    };
    assert_eq!(why(seen)["state"], "visible");
    assert_eq!(why(hidden)["state"], "hidden");
    assert_eq!(why(4_000_000)["code"], "invalid_argument");
    assert_eq!(
        ask("Query", &format!(r#"{{"job":{job},"cell":9}}"#))["code"],
        "invalid_argument"
    );
    assert_eq!(ask("Query", r#"{"job":99,"cell":0}"#)["code"], "not_found");
    // The numbers equal the numbers of the command.
    let line =
        format!("measure level.glb {name} --viewpoints 20 --resolution 32 --seed 3 --backend cpu");
    let there = ask(
        "Measure",
        &format!(r#"{{"job":{job},"viewpoints":20,"resolution":32,"seed":3}}"#),
    );
    let here: serde_json::Value = serde_json::from_str(&sandbox.ok(&line)).unwrap();
    let error = |value: &serde_json::Value, key: &str| value[key].as_f64().unwrap_or_default();
    assert_eq!(there["frames"], "20");
    assert_eq!(error(&there, "maxError"), error(&here, "max_error"));
    assert_eq!(error(&there, "meanError"), error(&here, "mean_error"));
    assert_eq!(
        ask("Measure", &format!(r#"{{"job":{job},"viewpoints":2000}}"#))["code"],
        "invalid_argument"
    );
}
