//! Tests of the monitoring of a farm: metrics, readiness, logs, and workers whose results are checked.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

use std::collections::BTreeMap;

use serde_json::Value;
use sightline_tests::{Sandbox, ask, assert_same, wait_for};

const JOB: &str = "town.glb --cells 4x4x2 --block-cells 4 --target-error 0.1 --backend cpu";

/// Returns the address after `metrics on` in the output of a process.
fn metrics_of(out: &str) -> Option<String> {
    let line = out.lines().find(|line| line.starts_with("metrics on "))?;
    Some(address_of(line.trim_start_matches("metrics on ")))
}

fn address_of(metrics: &str) -> String {
    metrics
        .trim_start_matches("http://")
        .trim_end_matches("/metrics")
        .to_owned()
}

/// Returns the samples of a page of metrics, by name with labels.
fn samples(at: &str) -> BTreeMap<String, f64> {
    let (status, body) = ask(at, "GET /metrics", "", "");
    assert_eq!(status, 200);
    let text = String::from_utf8(body).unwrap();
    assert!(text.ends_with("# EOF\n"));
    let sample = |line: &str| {
        let (name, value) = line.rsplit_once(' ').unwrap();
        (name.to_owned(), value.parse().unwrap())
    };
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .map(sample)
        .collect()
}

#[test]
fn metrics_follow_job_and_log_is_json() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    let arguments =
        "--listen 127.0.0.1:0 --metrics-listen 127.0.0.1:0 --log-format json --spot-check 1";
    let coordinator = sandbox.serve("data", arguments);
    let at = address_of(&coordinator.metrics);
    assert_eq!(ask(&at, "GET /readyz", "", "").0, 200);
    assert_eq!(ask(&at, "GET /livez", "", "").0, 200);
    assert_eq!(ask(&at, "GET /nothing", "", "").0, 404);
    let worker = "worker --backend cpu --threads 1 --metrics-listen 127.0.0.1:0 --log-format json";
    let workers = [coordinator.start(worker), coordinator.start(worker)];
    let of_worker = wait_for("a worker's metrics", || metrics_of(&workers[0].out()));
    wait_for("a ready worker", || {
        (ask(&of_worker, "GET /readyz", "", "").0 == 200).then_some(())
    });
    let job = coordinator.submit(JOB);
    let bytes = coordinator.finish(job);
    sandbox.ok(&format!("bake {JOB} -o alone.pvs"));
    assert_same(&bytes, &sandbox.read("alone.pvs"), "checked and alone");
    let now = samples(&at);
    let sum = |name: &str| {
        now.iter()
            .filter(|(n, _)| n.starts_with(name))
            .map(|(_, v)| v)
            .sum::<f64>()
    };
    let tiles = coordinator.count(job, "tiles_done") as f64;
    assert!(tiles > 1.0);
    assert_eq!(sum("sightline_tile_seconds_count"), tiles);
    assert_eq!(now["sightline_jobs_ended_total{state=\"done\"}"], 1.0);
    // Every tile was computed twice, each time by another worker.
    assert_eq!(now["sightline_spot_checks_total{outcome=\"same\"}"], tiles);
    assert!(sum("sightline_workers{") >= 2.0 && now["sightline_ready"] == 1.0);
    assert!(now["sightline_requests_total{method=\"Jobs/Submit\",code=\"OK\"}"] >= 1.0);
    let done = samples(&of_worker)["sightline_worker_tiles_total{outcome=\"done\"}"];
    let other = wait_for("the other's metrics", || metrics_of(&workers[1].out()));
    let all = done + samples(&other)["sightline_worker_tiles_total{outcome=\"done\"}"];
    assert_eq!(all, 2.0 * tiles);
    for text in [coordinator.process.err(), workers[0].err()] {
        let lines: Vec<Value> = text
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect();
        assert!(lines.iter().any(|line| line["level"] == "INFO"), "{text}");
    }
    let log = coordinator.process.err();
    let submitted = log
        .lines()
        .find(|line| line.contains("is submitted"))
        .unwrap();
    let submitted: Value = serde_json::from_str(submitted).unwrap();
    assert_eq!(submitted["span"]["method"], "Jobs/Submit");
    assert!(!submitted["span"]["id"].as_str().unwrap().is_empty());
    // The time line contains each tile twice.
    let trace: Value =
        serde_json::from_str(&coordinator.ok(&format!("logs {job} --trace"))).unwrap();
    let spans = trace["traceEvents"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|event| event["ph"] == "X");
    assert!(spans.count() as f64 >= tiles);
}

#[test]
fn store_is_verified_moved_and_compacted() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    let bytes = {
        let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
        let _worker = coordinator.worker();
        let job = coordinator.submit(JOB);
        let bytes = coordinator.finish(job);
        // The directory is in use, so the command fails.
        sandbox
            .run("store verify --data-dir data")
            .code(3)
            .says("in use by another coordinator");
        // Invalidated tiles are computed again, with the same bytes.
        coordinator.ok(&format!("invalidate {job}"));
        assert_same(&coordinator.finish(job), &bytes, "computed again");
        coordinator.run("invalidate").code(2);
        coordinator
            .run("invalidate 77")
            .code(4)
            .says("job 77 does not exist");
        // The number 0 is not a job, and does not mean all jobs.
        coordinator
            .run("invalidate 0 --worker any")
            .code(4)
            .says("job 0 does not exist");
        coordinator
            .run("logs 0")
            .code(4)
            .says("job 0 does not exist");
        coordinator
            .run("workers --release nobody")
            .code(3)
            .says("no worker named nobody is quarantined");
        bytes
    };
    let found = sandbox.json("store verify --data-dir data");
    assert_eq!((&found["scenes"], &found["jobs"]), (&1.into(), &1.into()));
    assert_eq!(found["lost"].as_array().unwrap().len(), 0);
    sandbox.ok("store compact --data-dir data");
    // A store that was moved by export, import and a copy of the blobs continues.
    sandbox.ok("store export --data-dir data -o records.json");
    sandbox.ok("store import records.json --data-dir moved");
    sandbox
        .run("store import records.json --data-dir moved")
        .code(3)
        .says("cannot import another store");
    std::fs::rename(sandbox.path("data/blobs"), sandbox.path("moved/blobs")).unwrap();
    {
        let coordinator = sandbox.coordinator("moved", "127.0.0.1:0");
        coordinator.ok("fetch 1 -o moved.pvs");
        assert_same(&sandbox.read("moved.pvs"), &bytes, "moved");
    }
    // A flipped bit in the result is detected, and the result is computed again.
    let result = std::fs::read_dir(sandbox.path("moved/blobs")).unwrap();
    let files: Vec<_> = result.flatten().flat_map(|d| walk(&d.path())).collect();
    let of_result = files
        .iter()
        .find(|path| std::fs::read(path).unwrap() == bytes)
        .unwrap();
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    std::fs::write(of_result, damaged).unwrap();
    sandbox
        .run("store verify --data-dir moved")
        .code(3)
        .says("the first is the result of job 1");
    sandbox.ok("store verify --data-dir moved --repair");
    let coordinator = sandbox.coordinator("moved", "127.0.0.1:0");
    let _worker = coordinator.worker();
    assert_same(&coordinator.finish(1), &bytes, "repaired");
    // Altered exports are rejected.
    let text = String::from_utf8(sandbox.read("records.json")).unwrap();
    sandbox.write("cut.json", &text[..text.len() / 2]);
    sandbox
        .run("store import cut.json --data-dir other")
        .code(3);
    sandbox.write(
        "other.json",
        text.replacen("sightline.store", "something else", 1),
    );
    sandbox
        .run("store import other.json --data-dir other")
        .code(3)
        .says("not an export of a store");
    sandbox
        .run("store verify --data-dir nowhere")
        .code(3)
        .says("not a data directory");
}

/// Returns the files below a folder.
fn walk(path: &std::path::Path) -> Vec<std::path::PathBuf> {
    if !path.is_dir() {
        return vec![path.to_owned()];
    }
    std::fs::read_dir(path)
        .unwrap()
        .flatten()
        .flat_map(|entry| walk(&entry.path()))
        .collect()
}

#[test]
fn copy_from_middle_of_job_continues() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    sandbox.ok(&format!("bake {JOB} -o alone.pvs"));
    let backup = sandbox.path("backup");
    {
        let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
        let _worker = coordinator.worker();
        let job = coordinator.submit(JOB);
        coordinator.until(job, "a tile", |now| now["tiles_done"].as_u64() > Some(0));
        std::fs::create_dir_all(backup.join("state")).unwrap();
        for name in ["journal.mark", "journal"] {
            std::fs::copy(
                sandbox.path("data/state").join(name),
                backup.join("state").join(name),
            )
            .unwrap();
        }
        // The end of the job removes outputs that the copied journal references.
        coordinator.finish(job);
        copy(&sandbox.path("data/blobs"), &backup.join("blobs"));
    }
    // The loss can be repaired, because the scene exists.
    sandbox.ok("store verify --repair --data-dir backup");
    let coordinator = sandbox.coordinator("backup", "127.0.0.1:0");
    let _worker = coordinator.worker();
    assert_same(
        &coordinator.finish(1),
        &sandbox.read("alone.pvs"),
        "from the copy",
    );
}

fn copy(from: &std::path::Path, to: &std::path::Path) {
    for path in walk(from) {
        let target = to.join(path.strip_prefix(from).unwrap());
        std::fs::create_dir_all(target.parent().unwrap()).unwrap();
        std::fs::copy(&path, target).unwrap();
    }
}
