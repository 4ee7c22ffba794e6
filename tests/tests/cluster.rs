//! Tests of a cluster of real processes: if any process dies at any time, the result equals the result of a
//! single process.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::sync::OnceLock;

use serde_json::Value;
use sightline_tests::{Sandbox, assert_same, wait_for};

/// The scene of all jobs in this file. A job has 69 tiles of about ten milliseconds each, so that a test can
/// act in the middle of the job.
const SCENE: &str = "generate rooms --triangles 2000 -o rooms.glb";
const JOB: &str = "rooms.glb --sampler cubes --cells 4x4x2 --resolution 96 --backend cpu";

/// Returns a folder with the scene.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    sandbox
}

/// Returns the result of [`JOB`] in one process.
fn alone() -> &'static [u8] {
    static ALONE: OnceLock<Vec<u8>> = OnceLock::new();
    ALONE.get_or_init(|| {
        let sandbox = sandbox();
        sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir data"));
        sandbox.read("alone.pvs")
    })
}

fn number(job: &Value, key: &str) -> u64 {
    job[key]
        .as_u64()
        .unwrap_or_else(|| panic!("no number '{key}' in {job}"))
}

/// Returns true if a job has both done tiles and leased tiles.
fn in_the_middle(job: &Value) -> bool {
    let (done, total) = (number(job, "tiles_done"), number(job, "tiles_total"));
    assert!(
        done < total,
        "the job was over before it could be disturbed; make it larger: {job}"
    );
    done > 0 && number(job, "tiles_running") > 0
}

#[test]
fn any_number_of_workers_gives_bytes_of_one_process() {
    for workers in [1, 3] {
        let sandbox = sandbox();
        let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
        let job = coordinator.submit(JOB);
        let _workers: Vec<_> = (0..workers).map(|_| coordinator.worker()).collect();
        assert_same(
            &coordinator.finish(job),
            alone(),
            &format!("{workers} workers"),
        );
        let shown = coordinator.json(&format!("show {job}"));
        assert_eq!(shown["state"], "done");
        assert_eq!(shown["tiles_set_aside"], 0);
        assert_eq!(number(&shown, "tiles_done"), number(&shown, "tiles_total"));
        assert_eq!(number(&shown, "cells_done"), 32);
    }
}

#[test]
fn killed_worker_does_not_affect_bytes() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let victim = coordinator.worker();
    // The killed worker is the only one, so the running tiles are its tiles.
    let before = coordinator.until(job, "the job's middle", in_the_middle);
    victim.kill();
    let after = coordinator.json(&format!("show {job}"));
    assert_eq!(after["state"], "running");
    assert!(number(&after, "tiles_done") >= number(&before, "tiles_done"));
    let _heir = coordinator.worker();
    assert_same(
        &coordinator.finish(job),
        alone(),
        "after a worker was killed",
    );
    // The tiles are revoked immediately, not when the leases expire.
    let log = coordinator.process.err();
    assert!(
        log.contains("is taken back: the worker disconnected and did not return"),
        "{log}"
    );
}

/// Returns a scene of slivers, duplicates, triangles without area, coplanar overlaps, T-junctions, and
/// coordinates of 1e-6 next to 1e3.
fn ugly() -> String {
    let mut obj = String::new();
    let mut corners = 0;
    let mut put = |triangle: [[f64; 3]; 3]| {
        for [x, y, z] in triangle {
            obj += &format!("v {x} {y} {z}\n");
        }
        obj += &format!("f {} {} {}\n", corners + 1, corners + 2, corners + 3);
        corners += 3;
    };
    for i in 0..400 {
        // The points are spread without a pattern, and are the same in every run.
        let at = |k: u32| f64::from((i * 7919 + k * 104_729) % 1000) / 10.0;
        let [x, y, z] = [at(1), at(2), at(3)];
        let wall = [
            [x, y, z],
            [x + at(4) / 5.0, y, z + 3.0],
            [x, y + 12.0, z + at(5) / 9.0],
        ];
        put(wall);
        match i % 5 {
            0 => put(wall),
            1 => put([wall[0], wall[1], wall[0]]),
            2 => put([wall[0], wall[1], [x + 30.0, y + 1e-6, z + 4.5]]),
            3 => put(wall.map(|[x, y, z]| [x + (wall[1][0] - wall[0][0]) / 3.0, y, z + 1.0])),
            _ => put(wall.map(|[x, y, z]| [x * 1e-6, y * 1e-6, z * 1e-6])),
        }
    }
    put([[-1e3, 0.0, -1e3], [1e3, 0.0, -1e3], [0.0, 0.0, 1e3]]);
    obj
}

/// Tests the default sampler, whose tiles are blocks of cells, on a scene full of degenerate geometry.
#[test]
fn killed_worker_does_not_affect_bytes_of_ugly_scene() {
    const LINES: &str =
        "ugly.obj --cells 8x8x8 --view-box 0,0,0,100,100,100 --block-cells 8 --backend cpu";
    let sandbox = Sandbox::new();
    sandbox.write("ugly.obj", ugly());
    sandbox.ok(&format!("bake {LINES} --data-dir alone -o alone.pvs"));
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(LINES);
    let victim = coordinator.worker();
    let before = coordinator.until(job, "the job's middle", in_the_middle);
    assert_eq!(number(&before, "tiles_total"), 64);
    victim.kill();
    let _heirs = [coordinator.worker(), coordinator.worker()];
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "after a worker was killed",
    );
    assert_eq!(coordinator.count(job, "tiles_set_aside"), 0);
    let dump = sandbox.dump("alone.pvs");
    assert!(
        dump.cells.iter().all(|cell| !cell.visible.is_empty()),
        "the ground or a wall is seen from everywhere"
    );
}

#[test]
fn killed_coordinator_continues_job() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let address = coordinator.address();
    let job = coordinator.submit(JOB);
    let mut workers = [coordinator.worker(), coordinator.worker()];
    let watcher = coordinator.start(&format!("watch {job}"));
    let before = coordinator.until(job, "the job's middle", in_the_middle);
    coordinator.process.kill();
    assert!(
        workers.iter_mut().all(|w| w.runs()),
        "workers outlive their coordinator"
    );

    let coordinator = sandbox.coordinator("data", &address);
    let after = coordinator.json(&format!("show {job}"));
    // Tiles that were reported as done were acknowledged.
    assert!(
        number(&after, "tiles_done") >= number(&before, "tiles_done"),
        "{before} then {after}"
    );
    assert_same(
        &coordinator.finish(job),
        alone(),
        "after the coordinator was killed",
    );
    assert!(
        workers.iter_mut().all(|w| w.runs()),
        "the same workers finished it"
    );
    watcher.end().code(0).says("connecting again");
    assert_eq!(coordinator.count(job, "workers"), 2);
}

#[test]
fn stopping_worker_finishes_its_tile_and_returns_next() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let worker = coordinator.worker();
    let before = coordinator.until(job, "the job's middle", in_the_middle);
    worker.signal("TERM");
    worker.end().code(0).says("finishing");
    let after = coordinator.json(&format!("show {job}"));
    assert!(
        number(&after, "tiles_done") >= number(&before, "tiles_done"),
        "{before} then {after}"
    );
    // The coordinator's only worker has ended, so no tile is leased, and the job does not wait for a lease to
    // expire.
    assert_eq!(number(&after, "tiles_running"), 0, "{after}");
    assert!(
        number(&after, "tiles_done") < number(&after, "tiles_total"),
        "it took more tiles: {after}"
    );
    let _heir = coordinator.worker();
    assert_same(&coordinator.finish(job), alone(), "after a worker drained");
}

#[test]
fn late_worker_receives_waiting_tile_of_other_worker() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 19000 -o rooms.glb");
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    // Two tiles of several seconds each.
    let job =
        coordinator.submit("rooms.glb --method exact --cells 4x4x4 --block-cells 32 --backend cpu");
    let _first = coordinator.worker();
    coordinator.until(job, "both tiles in one worker's hands", |job| {
        number(job, "tiles_running") == 2
    });
    let _second = coordinator.worker();
    coordinator.until(job, "the waiting tile in the other's", |_| {
        coordinator.process.err().contains("goes to an idle worker")
    });
    coordinator.finish(job);
    assert_eq!(coordinator.count(job, "tiles_set_aside"), 0);
}

#[test]
fn repeated_submission_returns_existing_job() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let first = coordinator.submit(&format!("{JOB} --request-id one --name first"));
    assert_eq!(
        coordinator.submit(&format!("{JOB} --request-id one --name first")),
        first
    );
    // Another request for the same job, with another name.
    let again = coordinator
        .run(&format!("submit {JOB} --request-id two --name second"))
        .code(0);
    assert_eq!(again.out.trim(), first.to_string());
    again.says("does this already");
    // The same request id for another job is an error.
    coordinator
        .run(&format!("submit {JOB} --seed 7 --request-id one"))
        .code(3)
        .says("request");
    let other = coordinator.submit(&format!("{JOB} --seed 7"));
    assert_ne!(other, first);

    let jobs = coordinator.json("jobs");
    let listed: Vec<u64> = jobs
        .as_array()
        .unwrap()
        .iter()
        .map(|j| number(j, "job"))
        .collect();
    assert_eq!(listed, [first, other]);
    for job in jobs.as_array().unwrap() {
        assert_eq!(job["state"], "queued");
        assert_eq!(
            number(job, "tiles_done") + number(job, "tiles_running") + number(job, "samples"),
            0
        );
        assert_eq!(number(job, "cells_total"), 32);
        assert_eq!(job["scene"].as_str().unwrap().len(), 64);
        let mut shown = coordinator.json(&format!("show {}", job["job"]));
        assert!(
            shown.as_object_mut().unwrap().remove("spec").is_some(),
            "only show has the specification"
        );
        assert_eq!(job, &shown, "show and jobs agree");
    }
    assert_eq!(jobs[0]["name"], "first");
    assert!(
        coordinator.ok("jobs").contains("NO WORKERS"),
        "a queue nobody works on is pointed out"
    );
    coordinator.run("show 99").code(4).says("99");

    // A new request does not return a cancelled job.
    coordinator.ok(&format!("cancel {first}"));
    assert_ne!(
        coordinator.submit(&format!("{JOB} --request-id three")),
        first
    );
}

#[test]
fn jobs_can_be_paused_resumed_cancelled_and_retried() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let state = |line: &str| coordinator.json(&format!("{line} {job}"))["state"].clone();
    // A command without effect is not an error.
    for (turn, then) in [
        ("pause", "paused"),
        ("resume", "queued"),
        ("retry", "queued"),
    ] {
        assert_eq!(state(turn), then);
        assert_eq!(state(turn), then);
    }

    let worker = coordinator.worker();
    coordinator.until(job, "the job's middle", in_the_middle);
    assert_eq!(state("pause"), "paused");
    let paused = coordinator.json(&format!("show {job}"));
    assert_eq!(
        number(&paused, "tiles_running"),
        0,
        "a paused job's tiles are taken back"
    );
    coordinator
        .run(&format!("fetch {job} -o early.pvs"))
        .code(4)
        .says("not ended");
    assert!(!sandbox.path("early.pvs").exists());

    let watcher = coordinator.start(&format!("watch {job}"));
    assert_eq!(state("cancel"), "cancelled");
    watcher.end().code(5).says("retry");
    coordinator
        .run(&format!("fetch {job} -o early.pvs"))
        .code(5)
        .says("retry");
    assert_eq!(state("cancel"), "cancelled");
    coordinator
        .run(&format!("pause {job}"))
        .code(4)
        .says("cannot be paused");

    let kept = coordinator.json(&format!("retry {job}"));
    assert!(
        number(&kept, "tiles_done") >= number(&paused, "tiles_done"),
        "{paused} then {kept}"
    );
    assert_same(
        &coordinator.finish(job),
        alone(),
        "after pause, cancel and retry",
    );
    for turn in ["pause", "resume", "cancel"] {
        coordinator
            .run(&format!("{turn} {job}"))
            .code(4)
            .says("so it cannot be");
    }
    assert_eq!(state("retry"), "done", "nothing is left to be tried again");
    assert_same(&coordinator.finish(job), alone(), "after all of that");
    worker.signal("TERM");
    worker.end().code(0);
}

#[test]
fn finished_job_survives_coordinator() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    {
        let _worker = coordinator.worker();
        coordinator.ok(&format!("watch {job}"));
    }
    let before = coordinator.json(&format!("show {job}"));
    coordinator.process.signal("TERM");
    coordinator.process.end().code(0);
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    // All fields are equal except the number of workers.
    let mut after = coordinator.json(&format!("show {job}"));
    after["workers"] = before["workers"].clone();
    assert_eq!(after, before);
    assert_same(
        &coordinator.finish(job),
        alone(),
        "fetched from the next coordinator",
    );
    // The same submission returns the stored job.
    assert_eq!(coordinator.submit(JOB), job);
}

#[test]
fn plain_text_needs_loopback_or_permission() {
    let sandbox = Sandbox::new();
    for address in ["0.0.0.0:0", "[::]:0"] {
        let refused = sandbox.run(&format!("coordinator --data-dir data --listen {address}"));
        refused.code(2).says("--allow-plaintext").says("127.0.0.1");
    }
    let allowed = sandbox.start("coordinator --data-dir data --listen 0.0.0.0:0 --allow-plaintext");
    wait_for("a coordinator on all addresses", || {
        allowed
            .out()
            .contains("listening on http://0.0.0.0:")
            .then_some(())
    });
}

#[test]
fn absent_coordinator_is_reported() {
    let sandbox = sandbox();
    // The port was bound and closed again, so no coordinator listens on it.
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let nobody = format!("--coordinator http://{free}");
    let commands = [
        "health".to_owned(),
        "jobs".to_owned(),
        "show 1".to_owned(),
        "watch 1".to_owned(),
        "fetch 1 -o no.pvs".to_owned(),
        format!("submit {JOB}"),
    ];
    for command in commands {
        sandbox
            .run(&format!("{command} {nobody}"))
            .code(4)
            .says("sightline coordinator");
    }
    let gave_up = sandbox.run(&format!("worker --backend cpu --give-up-after 1 {nobody}"));
    gave_up.code(4).says("sightline coordinator");
    for command in ["health", "worker --backend cpu --give-up-after 1"] {
        sandbox
            .run(&format!("{command} --coordinator nonsense:x:y"))
            .code(2)
            .says("http://");
    }
}

#[test]
fn data_folder_has_one_coordinator() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let second = sandbox
        .run("coordinator --listen 127.0.0.1:0 --data-dir data")
        .code(3)
        .says("data");
    assert!(!second.out.contains("listening"), "{}", second.out);
    sandbox
        .run(&format!("bake {JOB} -o no.pvs --data-dir data"))
        .code(3)
        .says("--data-dir");
    assert_eq!(coordinator.ok("health").trim(), "serving");
    // The port is in use, too.
    let taken = sandbox.run(&format!(
        "coordinator --listen {} --data-dir other",
        coordinator.address()
    ));
    taken.code(2).says("another coordinator");
}

#[test]
fn damaged_scene_is_uploaded_again() {
    scene_is_uploaded_again("is damaged", |blob| {
        let mut bytes = std::fs::read(blob).unwrap();
        bytes[100] ^= 1;
        std::fs::write(blob, bytes).unwrap();
    });
}

#[test]
fn unreadable_scene_is_uploaded_again() {
    scene_is_uploaded_again("cannot be read", |blob| {
        std::fs::remove_file(blob).unwrap();
        // A process has no page 0, so reading this file fails with EIO, like a bad sector.
        std::os::unix::fs::symlink("/proc/self/mem", blob).unwrap();
    });
}

/// Loses a job's scene, uploads it again, and compares the result.
fn scene_is_uploaded_again(says: &str, lose: impl FnOnce(&std::path::Path)) {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let first = coordinator.submit(JOB);
    let digest = coordinator.json(&format!("show {first}"))["scene"]
        .as_str()
        .unwrap()
        .to_owned();
    let blob = format!("data/blobs/{}/{}/{digest}", &digest[..2], &digest[2..4]);
    lose(&sandbox.path(&blob));
    // The job waits, and reports the missing blob.
    let _worker = coordinator.worker();
    let paused = coordinator.until(first, "a pause", |job| job["state"] == "paused");
    assert!(
        paused["reason"]
            .as_str()
            .unwrap()
            .contains("send the scene again"),
        "{paused}"
    );
    assert!(
        coordinator
            .ok(&format!("logs {first}"))
            .contains("send the scene again")
    );
    // The next submission uploads the scene again, and the waiting job continues.
    assert_eq!(coordinator.submit(JOB), first);
    assert_same(
        &coordinator.finish(first),
        alone(),
        "after the scene was lost",
    );
    assert_eq!(coordinator.json(&format!("show {first}"))["reason"], "");
    assert!(
        coordinator.process.err().contains(says),
        "{}",
        coordinator.process.err()
    );
}

/// Removes all packs from a coordinator's blobs. Returns their number.
fn lose_packs(folder: &std::path::Path) -> usize {
    let mut lost = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            lost += lose_packs(&path);
        } else if zstd::stream::decode_all(std::fs::File::open(&path).unwrap())
            .is_ok_and(|raw| raw[0] == b'P')
        {
            std::fs::remove_file(&path).unwrap();
            lost += 1;
        }
    }
    lost
}

#[test]
fn lost_packs_are_computed_again() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let worker = coordinator.worker();
    coordinator.until(job, "the faces and some separators", |j| {
        number(j, "tiles_done") >= 8
    });
    worker.signal("TERM");
    worker.end().code(0);
    assert!(lose_packs(&sandbox.path("data/blobs")) >= 7);
    let heir = coordinator.worker();
    assert_same(
        &coordinator.finish(job),
        alone(),
        "after the packs were lost",
    );
    heir.kill();
}
