//! A client in ten lines: a file is sent, a scene is enough for a job, and the result is fetched, with
//! nothing but HTTP. And gRPC's reflection by both of its names, and the interface against its frozen form.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::process::Command;

use sightline_tests::{Sandbox, in_ci};

/// The client of docs/farm.md.
const CLIENT: &str = include_str!("../../docs/examples/client.py");

#[test]
fn ten_lines_of_python_bake_a_file() {
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
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    // The same as what the program gives for the same file.
    sandbox.ok("bake level.glb -o here.pvs --backend cpu");
    assert_eq!(sandbox.dump("level.pvs").cells.len(), 512);
    let [there, here] = ["level.pvs", "here.pvs"].map(|name| sandbox.ok(&format!("dump {name}")));
    assert_eq!(there, here);
    let lines = CLIENT.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).count();
    assert!(lines <= 10, "{lines} lines");
}

#[test]
fn a_file_that_is_no_scene_is_refused_in_words() {
    let sandbox = Sandbox::new();
    let coordinator = sandbox.coordinator_with_pages("data");
    let host = coordinator.pages.trim_start_matches("http://").trim_end_matches('/').to_owned();
    let send = |name: &str, kind: &str, body: &[u8]| {
        use std::io::{Read as _, Write as _};
        let mut stream = std::net::TcpStream::connect(&host).unwrap();
        write!(
            stream,
            "POST /scenes?name={name} HTTP/1.1\r\nHost: {host}\r\nContent-Type: {kind}\r\nConnection: \
             close\r\nContent-Length: {}\r\n\r\n",
            body.len()
        )
        .unwrap();
        stream.write_all(body).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    let bytes = "application/octet-stream";
    let refused = send("level.glb", bytes, b"no scene");
    assert!(refused.starts_with("HTTP/1.1 400") && refused.contains("level.glb"), "{refused}");
    // Another file beside it cannot be named: there is none.
    let outside = br#"{"asset":{"version":"2.0"},"buffers":[{"uri":"../../etc/passwd","byteLength":9}]}"#;
    let refused = send("level.gltf", bytes, outside);
    assert!(refused.starts_with("HTTP/1.1 400"), "{refused}");
    assert!(send("a.obj", "text/plain", b"v 0 0 0").starts_with("HTTP/1.1 400"));
    assert!(send("a.obj", bytes, b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").starts_with("HTTP/1.1 200"));
}
