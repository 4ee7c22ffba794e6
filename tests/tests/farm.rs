//! Tests of the farm's display (workers, tiles and events) and of user actions on jobs: pause, delete, and
//! download of partial results.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::Value;
use sightline_tests::{Coordinator, Sandbox, wait_for};

/// The job has 64 tiles of tens of milliseconds each.
const JOB: &str = "rooms.glb --cells 8x8x8 --block-cells 8 --target-error 0.0003 --backend cpu";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    sandbox
}

/// Returns the lines of a command that prints JSON Lines.
fn lines(coordinator: &Coordinator<'_>, line: &str) -> Vec<Value> {
    let out = coordinator.ok(&format!("{line} --json"));
    out.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn number(value: &Value) -> u64 {
    value
        .as_u64()
        .unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn workers_tiles_and_events_describe_job() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    assert!(
        coordinator
            .ok("workers")
            .contains("no workers are connected")
    );
    let job = coordinator.submit(JOB);
    let tiles = lines(&coordinator, &format!("show {job} --tiles"));
    assert_eq!(tiles.len(), 64);
    assert!(
        tiles
            .iter()
            .all(|t| t["state"] == "ready" && t["cells"] == 8),
        "{}",
        tiles[0]
    );
    // The boxes of the tiles belong to a grid: they fill the view box.
    let volume = |t: &Value| {
        let at = |i: usize| t["box"][i].as_f64().unwrap();
        (0..3).map(|axis| at(axis + 3) - at(axis)).product::<f64>()
    };
    let first = volume(&tiles[0]);
    assert!(first > 0.0 && tiles.iter().all(|t| (volume(t) / first - 1.0).abs() < 1e-3));
    let worker = coordinator.start("worker --backend cpu --threads 1 --name ann");
    let busy = wait_for("a worker at work", || {
        coordinator
            .json("workers")
            .as_array()
            .unwrap()
            .first()
            .filter(|w| w["tiles"][0].is_object())
            .cloned()
    });
    assert_eq!(
        (&busy["name"], &busy["draining"]),
        (&"ann".into(), &false.into())
    );
    assert_eq!(number(&busy["tiles"][0]["job"]), job);
    coordinator.finish(job);
    let tiles = lines(&coordinator, &format!("show {job} --tiles"));
    assert!(
        tiles
            .iter()
            .all(|t| t["state"] == "done" && t["workers"] == serde_json::json!(["ann"]))
    );
    assert_eq!(
        tiles.iter().map(|t| number(&t["cells_done"])).sum::<u64>(),
        512
    );
    let idle = coordinator.json("workers")[0].clone();
    assert_eq!(
        (number(&idle["tiles_done"]), number(&idle["cells_done"])),
        (64, 512)
    );
    assert!(coordinator.ok("workers").starts_with("ann ("));

    let events = lines(&coordinator, &format!("logs {job}"));
    let count_of = |kind: &str| events.iter().filter(|e| e["kind"] == kind).count();
    assert_eq!(
        (count_of("submitted"), count_of("leased"), count_of("done")),
        (1, 64, 64)
    );
    assert!(events.iter().all(|e| number(&e["job"]) == job));
    let numbers: Vec<u64> = events.iter().map(|e| number(&e["number"])).collect();
    assert!(numbers.is_sorted() && events.is_sorted_by_key(|e| number(&e["at_ms"])));
    let last = &events[events.len() - 1];
    assert!(
        last["text"]
            .as_str()
            .unwrap()
            .starts_with("the job is done"),
        "{last}"
    );
    // Events of the farm contain the worker, and the events after a number can be requested.
    let all = lines(&coordinator, "logs");
    assert!(
        all.iter()
            .any(|e| e["kind"] == "worker" && e["worker"] == "ann")
    );
    let half = numbers[numbers.len() / 2];
    let rest = lines(&coordinator, &format!("logs {job} --after {half}"));
    assert_eq!(rest.len(), numbers.iter().filter(|n| **n > half).count());
    // The specification has the names of the interface, and jobs have ages.
    assert_eq!(
        coordinator.json(&format!("show {job}"))["spec"]["visibility"]["aggressive"]["sampling"]["lines"]
            ["grid"]["x"],
        8
    );
    assert!(coordinator.ok("jobs").contains("ended "));

    // The events survive the coordinator.
    let address = coordinator.address();
    worker.kill();
    wait_for("the worker's end in the log", || {
        lines(&coordinator, "logs")
            .iter()
            .any(|e| e["text"] == "worker ann has disconnected")
            .then_some(())
    });
    // Events are written a moment later.
    std::thread::sleep(std::time::Duration::from_millis(500));
    coordinator.process.kill();
    let coordinator = sandbox.coordinator("data", &address);
    let again = lines(&coordinator, &format!("logs {job}"));
    assert_eq!(again, events);
    coordinator
        .run("logs 99")
        .code(4)
        .says("job 99 does not exist");
    coordinator
        .run("show 99 --tiles")
        .code(4)
        .says("job 99 does not exist");
}

#[test]
fn paused_job_finishes_its_tiles_or_stops_now() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let _worker = coordinator.worker();
    let at_work = |job: &Value| number(&job["tiles_done"]) > 0 && number(&job["tiles_running"]) > 0;
    coordinator.until(job, "the job's middle", at_work);
    assert_eq!(coordinator.json(&format!("pause {job}"))["state"], "paused");
    let rests = |job: &Value| number(&job["tiles_running"]) == 0;
    let paused = coordinator.until(job, "the end of tiles at work", rests);
    assert_eq!(paused["state"], "paused");
    let texts = |coordinator: &Coordinator<'_>| {
        let all = lines(coordinator, &format!("logs {job}"));
        all.iter().filter(|e| e["kind"] == "taken_back").count()
    };
    assert_eq!(texts(&coordinator), 0, "a tile at work was taken back");
    coordinator.ok(&format!("resume {job}"));
    let more = number(&paused["tiles_done"]);
    coordinator.until(job, "more tiles", |j| {
        number(&j["tiles_done"]) > more && at_work(j)
    });
    let stopped = coordinator.json(&format!("pause {job} --now"));
    assert_eq!(
        (&stopped["state"], &stopped["tiles_running"]),
        (&"paused".into(), &0.into())
    );
    coordinator.ok(&format!("resume {job}"));
    let alone = sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir alone"));
    assert!(alone.contains("alone.pvs"));
    sightline_tests::assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "after pauses",
    );
}

#[test]
fn partial_result_hides_only_done_cells() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let refused = coordinator
        .run(&format!("fetch {job} --partial -o some.pvs"))
        .code(4);
    assert!(refused.err.contains("no finished tile"), "{}", refused.err);
    let worker = coordinator.worker();
    coordinator.until(job, "the job's middle", |job| {
        number(&job["tiles_done"]) > 3
    });
    coordinator.ok(&format!("pause {job}"));
    coordinator.until(job, "a rest", |job| number(&job["tiles_running"]) == 0);
    // The worker may have started a tile when the coordinator revoked it, and such a tile counts.
    worker.kill();
    let paused = coordinator.until(job, "the end of the worker", |job| {
        number(&job["workers"]) == 0
    });
    let fetched = coordinator
        .run(&format!("fetch {job} --partial -o some.pvs"))
        .code(0);
    assert!(
        fetched
            .err
            .contains("the sets of all other cells contain every triangle"),
        "{}",
        fetched.err
    );
    let some = sandbox.dump("some.pvs");
    let info = sandbox.ok("info some.pvs");
    assert!(info.contains("were not done"), "{info}");
    coordinator.ok(&format!("resume {job}"));
    let _worker = coordinator.worker();
    coordinator.finish(job);
    let whole = sandbox.dump(&format!("fetched-{job}.pvs"));
    let triangles = some.header["triangles"].as_u64().unwrap() as usize;
    let (mut same, mut open) = (0, 0);
    for (a, b) in some.cells.iter().zip(&whole.cells) {
        if a.visible.len() == triangles && a.undecided.len() == triangles {
            open += 1;
        } else {
            assert_eq!(a.visible, b.visible);
            same += 1;
        }
    }
    assert_eq!(
        (same, open),
        (
            8 * number(&paused["tiles_done"]),
            512 - 8 * number(&paused["tiles_done"])
        )
    );
}

#[test]
fn deletion_of_job_keeps_shared_data() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let worker = coordinator.worker();
    let small = |seed| format!("rooms.glb --cells 2x2x2 --seed {seed} --backend cpu");
    let [a, b] = [1, 2].map(|seed| coordinator.submit(&small(seed)));
    coordinator.finish(a);
    let kept = coordinator.finish(b);
    // Without a worker no files are added during the count.
    worker.kill();
    let open = coordinator.submit(&format!("{JOB} --seed 9"));
    coordinator
        .run(&format!("delete {open}"))
        .code(4)
        .says("cannot be deleted");
    let before = sandbox.files_below("data/blobs");
    coordinator.ok(&format!("delete {a}"));
    assert!(sandbox.files_below("data/blobs") < before);
    coordinator
        .run(&format!("show {a}"))
        .code(4)
        .says(&format!("job {a} does not exist"));
    coordinator
        .run(&format!("delete {a}"))
        .code(4)
        .says(&format!("job {a} does not exist"));
    coordinator.ok(&format!("fetch {b} -o again.pvs"));
    assert!(sandbox.read("again.pvs") == kept);
    let _worker = coordinator.worker();
    // A new submission is another job with the same result.
    let again = coordinator.submit(&small(1));
    assert!(again > open);
    coordinator.ok(&format!("cancel {open}"));
    coordinator.finish(again);
    coordinator.ok(&format!("delete {open}"));
}

#[test]
fn watcher_survives_coordinator_restart() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let address = coordinator.address();
    let job = coordinator.submit(JOB);
    let watcher = coordinator.start(&format!("watch {job}"));
    let worker = coordinator.worker();
    coordinator.until(job, "the job's middle", |job| {
        number(&job["tiles_done"]) > 3
    });
    coordinator.process.kill();
    wait_for("the watcher's word", || {
        watcher.err().contains("connecting again").then_some(())
    });
    let coordinator = sandbox.coordinator("data", &address);
    let ended = watcher.end().code(0);
    assert!(ended.err.contains("ended as done"), "{}", ended.err);
    assert_eq!(coordinator.json(&format!("show {job}"))["state"], "done");
    drop(worker);
}

#[test]
fn progress_is_printed_as_json_and_two_bakes_run_in_parallel() {
    let sandbox = sandbox();
    // Both bakes use the default data directory of the sandbox's user.
    let long = "rooms.glb --cells 8x8x8 --block-cells 8 --target-error 0.00003 --backend cpu";
    let first = sandbox.start(&format!("bake {long} -o first.pvs --json"));
    wait_for("the first bake's progress", || {
        first.err().contains("\"event\":\"progress\"").then_some(())
    });
    let second = sandbox
        .run(&format!("bake {JOB} --seed 2 -o second.pvs --json"))
        .code(0);
    assert!(
        second.err.contains("is in use by process"),
        "{}",
        second.err
    );
    let first = first.end().code(0);
    let events: Vec<Value> = first
        .err
        .lines()
        .filter(|l| l.starts_with('{'))
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    assert!(
        events
            .iter()
            .all(|e| e["event"] == "progress" && e["total"] == 64 && e["what"] == "tiles")
    );
    assert!(events.is_sorted_by_key(|e| number(&e["done"])));
    assert_eq!(sandbox.dump("second.pvs").cells.len(), 512);
}
