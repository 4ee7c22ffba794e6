//! Tests of a coordinator whose blobs are in a bucket. Whatever happens to the object store, the result
//! equals the result with a directory.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::path::Path;

use serde_json::Value;
use sightline_test_s3::{KEY, S3Server, SECRET};
use sightline_tests::{Coordinator, Sandbox, assert_same, wait_for};

/// The scene of a job with 69 tiles of about ten milliseconds each, so that a test can act in the middle of
/// the job.
const SCENE: &str = "generate rooms --triangles 2000 -o rooms.glb";
const JOB: &str = "rooms.glb --sampler cubes --cells 4x4x2 --resolution 96 --backend cpu";

/// Returns a folder with the scene and the result of [`JOB`] in one process, and a running object store.
fn sandbox() -> (Sandbox, S3Server) {
    let mut sandbox = Sandbox::new();
    sandbox.set("AWS_ACCESS_KEY_ID", KEY);
    sandbox.set("AWS_SECRET_ACCESS_KEY", SECRET);
    sandbox.ok(SCENE);
    sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir alone"));
    let server = S3Server::start(&sandbox.path("s3"), "farm");
    (sandbox, server)
}

fn place(server: &S3Server, cache: &str) -> String {
    format!("s3://farm/one?endpoint={}&cache={cache}", server.endpoint())
}

/// Starts a coordinator on the object store without a local cache, so that every blob is read from the store.
fn coordinator<'a>(sandbox: &'a Sandbox, server: &S3Server) -> Coordinator<'a> {
    sandbox.serve(
        "data",
        &format!("--listen 127.0.0.1:0 --blobs {}", place(server, "0")),
    )
}

fn finished(coordinator: &Coordinator<'_>, sandbox: &Sandbox, job: u64, what: &str) {
    assert_same(&coordinator.finish(job), &sandbox.read("alone.pvs"), what);
    assert_eq!(coordinator.count(job, "tiles_set_aside"), 0);
    assert!(
        !coordinator.process.err().contains(SECRET),
        "the log has the secret"
    );
}

fn in_the_middle(job: &Value) -> bool {
    let [done, total] = ["tiles_done", "tiles_total"].map(|key| job[key].as_u64().unwrap());
    assert!(
        done < total,
        "the job was over before it could be disturbed; make it larger: {job}"
    );
    done > 0
}

fn flip(path: &Path, at: usize) {
    let mut bytes = std::fs::read(path).unwrap();
    bytes[at] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn bucket_gives_bytes_of_directory() {
    let (sandbox, server) = sandbox();
    for (data, cache) in [("none", "0"), ("some", "20K"), ("all", "1G")] {
        let place = place(&server, cache).replace("one?", &format!("{data}?"));
        let coordinator = sandbox.serve(data, &format!("--listen 127.0.0.1:0 --blobs {place}"));
        let job = coordinator.submit(JOB);
        let workers = [coordinator.worker(), coordinator.worker()];
        finished(
            &coordinator,
            &sandbox,
            job,
            &format!("with a cache of {cache}"),
        );
        assert_eq!(
            sandbox.files_below(&format!("{data}/blobs")),
            0,
            "a directory was used"
        );
        wait_for(
            "the scene, the result and the name of the store alone",
            || (server.objects(&format!("farm/{data}"), "").len() == 3).then_some(()),
        );
        let copies = sandbox.files_below(&format!("{data}/copies"));
        assert!(match data {
            "none" => copies == 0,
            "all" => copies == 2,
            _ => true,
        });
        workers.into_iter().for_each(|worker| worker.kill());
    }
}

#[test]
fn blobs_option_accepts_directory() {
    let (sandbox, _) = sandbox();
    let elsewhere = sandbox.path("elsewhere");
    let coordinator = sandbox.serve(
        "data",
        &format!("--listen 127.0.0.1:0 --blobs dir:{}", elsewhere.display()),
    );
    let job = coordinator.submit(JOB);
    let _worker = coordinator.worker();
    finished(&coordinator, &sandbox, job, "in a directory with a name");
    // The third file is the identity of the store.
    wait_for("the scene and the result only", || {
        (sandbox.files_below("elsewhere") == 3).then_some(())
    });
    assert_eq!(sandbox.files_below("data/blobs"), 0);
}

#[test]
fn coordinator_waits_for_killed_store() {
    let (sandbox, mut server) = sandbox();
    let coordinator = coordinator(&sandbox, &server);
    let job = coordinator.submit(JOB);
    let _workers = [coordinator.worker(), coordinator.worker()];
    coordinator.until(job, "the job's middle", in_the_middle);
    server.kill();
    // The pause is long enough for tiles to end.
    std::thread::sleep(std::time::Duration::from_millis(700));
    let shown = coordinator.json(&format!("show {job}"));
    assert_eq!(shown["state"], "running", "{shown}");
    server.start_again();
    finished(&coordinator, &sandbox, job, "after the store was killed");
}

#[test]
fn coordinator_continues_from_bucket() {
    let (sandbox, server) = sandbox();
    let first = coordinator(&sandbox, &server);
    let job = first.submit(JOB);
    let worker = first.worker();
    first.until(job, "the job's middle", in_the_middle);
    worker.kill();
    first.process.kill();
    let second = coordinator(&sandbox, &server);
    let _worker = second.worker();
    finished(&second, &sandbox, job, "after the coordinator was killed");
}

#[test]
fn damaged_objects_are_detected_and_replaced() {
    let (sandbox, server) = sandbox();
    let coordinator = coordinator(&sandbox, &server);
    let job = coordinator.submit(JOB);
    let digest = coordinator.json(&format!("show {job}"))["scene"]
        .as_str()
        .unwrap()
        .to_owned();
    let [scene] = &server.objects("farm", &digest)[..] else {
        panic!("one scene")
    };
    flip(scene, 100);
    // The next submission uploads the scene again and replaces the damaged object.
    assert_eq!(coordinator.submit(JOB), job);
    assert!(
        coordinator.process.err().contains("is damaged"),
        "{}",
        coordinator.process.err()
    );
    let worker = coordinator.worker();
    coordinator.until(job, "the faces and some separators", |j| {
        j["tiles_done"].as_u64().unwrap() >= 8
    });
    worker.signal("TERM");
    worker.end().code(0);
    // Damaged packs count as lost: a worker that needs one computes it again.
    let mut flipped = 0;
    for object in server
        .objects("farm", "")
        .iter()
        .filter(|object| *object != scene)
    {
        let raw = std::fs::File::open(object)
            .map(zstd::stream::decode_all)
            .unwrap();
        if raw.is_ok_and(|raw| raw[0] == b'P') {
            flip(object, 9);
            flipped += 1;
        }
    }
    assert!(flipped >= 7, "{flipped} packs");
    let _heir = coordinator.worker();
    finished(&coordinator, &sandbox, job, "after objects were damaged");
}

#[test]
fn unusable_blob_location_is_rejected_at_start() {
    let (mut sandbox, server) = sandbox();
    let endpoint = server.endpoint();
    let refused = |sandbox: &Sandbox, place: &str, text: &str| {
        let line = format!("coordinator --listen 127.0.0.1:0 --data-dir data --blobs {place}");
        let run = sandbox.run(&line).says(text);
        assert!(
            !run.err.contains(SECRET) && !run.err.contains("hush"),
            "{}",
            run.err
        );
    };
    refused(&sandbox, "farm", "dir:PATH nor s3://");
    refused(&sandbox, "s3://farm?secret=hush", "the option 'secret'");
    refused(
        &sandbox,
        "s3://farm?endpoint=http://192.0.2.1",
        "--allow-plaintext",
    );
    refused(
        &sandbox,
        "s3://farm?endpoint=http://127.0.0.1:9",
        "cannot be reached",
    );
    refused(
        &sandbox,
        &format!("s3://other?endpoint={endpoint}"),
        "the bucket of s3://other",
    );
    sandbox.set("AWS_SECRET_ACCESS_KEY", "hush");
    refused(
        &sandbox,
        &format!("s3://farm?endpoint={endpoint}"),
        "AWS_SECRET_ACCESS_KEY",
    );
}
