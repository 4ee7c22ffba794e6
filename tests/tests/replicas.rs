//! Tests of several coordinators on one database.
//!
//! If any of them is killed at any time, and even if the database restarts, the job ends. Its result equals
//! the result of a single process.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::net::{TcpListener, TcpStream};

use serde_json::Value;
use sightline_tests::{Balancer, Coordinator, Postgres, Run, Sandbox, ask, assert_same, wait_for};

/// The scene of `cluster.rs`, with 69 tiles of about ten milliseconds each.
const SCENE: &str = "generate rooms --triangles 2000 -o rooms.glb";
const JOB: &str = "rooms.glb --sampler cubes --cells 4x4x2 --resolution 96 --backend cpu";

/// Returns a folder with the scene and the result of an undisturbed run in one process, on the store on disk.
fn sandbox(server: &Postgres) -> Sandbox {
    let mut sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir alone"));
    sandbox.set("SIGHTLINE_STORE", server.url());
    sandbox
}

/// Starts a coordinator with its own data directory and shared blobs.
fn replica<'a>(sandbox: &'a Sandbox, name: &str, arguments: &str) -> Coordinator<'a> {
    for folder in ["shared", name] {
        std::fs::create_dir_all(sandbox.path(folder)).unwrap();
    }
    let blobs = sandbox.path(name).join("blobs");
    if !blobs.exists() {
        std::os::unix::fs::symlink(sandbox.path("shared"), blobs).unwrap();
    }
    sandbox.serve(name, &format!("--listen 127.0.0.1:0 {arguments}"))
}

/// Waits until a coordinator reports that it leads.
fn leads(coordinator: &Coordinator<'_>) {
    wait_for("a coordinator to lead", || {
        coordinator
            .process
            .err()
            .contains("this coordinator leads")
            .then_some(())
    });
}

/// Waits until a coordinator reports that another one leads.
fn stands_by(coordinator: &Coordinator<'_>, leader: &Coordinator<'_>) {
    let text = format!("at {} leads", leader.url);
    wait_for("a coordinator to stand by", || {
        coordinator.process.err().contains(&text).then_some(())
    });
}

fn number(job: &Value, key: &str) -> u64 {
    job[key]
        .as_u64()
        .unwrap_or_else(|| panic!("no number '{key}' in {job}"))
}

/// Returns the document of a job, or `None` if no coordinator answers, as during a change of leaders.
fn shown(sandbox: &Sandbox, url: &str, job: u64) -> Option<Value> {
    let run: Run = sandbox.run(&format!("show {job} --json --coordinator {url}"));
    run.succeeded()
        .then(|| serde_json::from_str(&run.out).unwrap())
}

/// Waits until some tiles of a job are done and some are running.
fn in_the_middle(sandbox: &Sandbox, url: &str, job: u64) -> u64 {
    wait_for("the job's middle", || {
        let shown = shown(sandbox, url, job)?;
        let (done, total) = (number(&shown, "tiles_done"), number(&shown, "tiles_total"));
        assert!(
            done < total,
            "the job was over before it could be disturbed; make it larger: {shown}"
        );
        (done > 0 && number(&shown, "tiles_running") > 0).then_some(done)
    })
}

/// Follows a job to its end. Returns the bytes of its result.
fn finished(sandbox: &Sandbox, url: &str, job: u64) -> Vec<u8> {
    wait_for("the job's end", || {
        shown(sandbox, url, job).filter(|job| job["state"] == "done" || job["state"] == "failed")
    });
    sandbox.ok(&format!("fetch {job} -o fetched.pvs --coordinator {url}"));
    sandbox.read("fetched.pvs")
}

#[test]
fn successor_of_killed_leader_gives_same_bytes() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let sandbox = sandbox(&server);
    let first = replica(&sandbox, "a", "");
    leads(&first);
    let second = replica(&sandbox, "b", "");
    stands_by(&second, &first);
    let balancer = Balancer::before(&[first.address(), second.address()]);
    // The scene, the job and all queries about it go through the standby.
    let job = second.submit(JOB);
    let watcher = sandbox.start(&format!("watch {job} --coordinator {}", balancer.url()));
    let worker = format!(
        "worker --backend cpu --threads 1 --coordinator {}",
        balancer.url()
    );
    let mut workers = [sandbox.start(&worker), sandbox.start(&worker)];
    let done = in_the_middle(&sandbox, &second.url, job);
    first.process.kill();
    balancer.lead_to(&[second.address()]);
    leads(&second);
    let after = wait_for("an answer", || shown(&sandbox, &second.url, job));
    assert!(
        number(&after, "tiles_done") >= done,
        "acknowledged tiles are lost: {after}"
    );
    // A third coordinator takes over and answers.
    let third = replica(&sandbox, "c", "");
    stands_by(&third, &second);
    assert_same(
        &finished(&sandbox, &third.url, job),
        &sandbox.read("alone.pvs"),
        "after the leader's end",
    );
    assert!(
        workers.iter_mut().all(|worker| worker.runs()),
        "workers outlive their coordinator"
    );
    watcher.end().code(0);
    assert_eq!(second.count(job, "tiles_set_aside"), 0);
    // A coordinator that receives SIGTERM resigns, and its successor leads immediately.
    second.process.signal("TERM");
    second.process.end().code(0);
    leads(&third);
    assert_eq!(third.json(&format!("show {job}"))["state"], "done");
}

#[test]
fn restarted_database_does_not_affect_bytes() {
    let Some(mut server) = Postgres::start_with("") else {
        return;
    };
    let sandbox = sandbox(&server);
    let replicas = [replica(&sandbox, "a", ""), replica(&sandbox, "b", "")];
    let balancer = Balancer::before(&replicas.each_ref().map(|replica| replica.address()));
    let job: u64 = sandbox
        .ok(&format!("submit {JOB} --coordinator {}", balancer.url()))
        .trim()
        .parse()
        .unwrap();
    let worker = format!(
        "worker --backend cpu --threads 1 --coordinator {}",
        balancer.url()
    );
    let _workers = [sandbox.start(&worker), sandbox.start(&worker)];
    let done = in_the_middle(&sandbox, &balancer.url(), job);
    server.restart();
    let after = wait_for("an answer", || shown(&sandbox, &balancer.url(), job));
    assert!(
        number(&after, "tiles_done") >= done,
        "acknowledged tiles are lost: {after}"
    );
    let result = finished(&sandbox, &balancer.url(), job);
    assert_same(
        &result,
        &sandbox.read("alone.pvs"),
        "after the database's restart",
    );
}

#[test]
fn standby_reports_failed_forwarding() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let mut sandbox = Sandbox::new();
    sandbox.set("SIGHTLINE_STORE", server.url_on_loopback());
    sandbox.set("PGPASSWORD", server.password());
    let first = replica(&sandbox, "a", "");
    leads(&first);
    let second = replica(&sandbox, "b", "--http 127.0.0.1:0");
    stands_by(&second, &first);
    // Only the leader serves pages.
    let (status, text) = ask(&second.pages, "GET /", "", "");
    let text = String::from_utf8(text).unwrap();
    assert!(
        status == 503 && text.contains(&first.url),
        "{status} {text}"
    );
    // The standby reports its own health, and forwards the leader's errors unchanged.
    second.run("show 99").code(4).says("job 99 does not exist");
    drop(first);
    leads(&second);
    second.run("show 99").code(4).says("job 99 does not exist");
    wait_for("the dashboard", || {
        (ask(&second.pages, "GET /", "", "").0 == 200).then_some(())
    });
    assert!(!second.process.err().contains(server.password()));
}

#[test]
fn unusable_store_is_rejected_with_remedy() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let mut sandbox = Sandbox::new();
    let refused = |sandbox: &Sandbox, arguments: &str, code: i32, text: &str| {
        let run = sandbox.run(&format!(
            "coordinator --listen 127.0.0.1:0 --data-dir data {arguments}"
        ));
        assert!(!run.err.contains("secret"), "{}", run.err);
        run.code(code).says(text);
    };
    refused(
        &sandbox,
        "--store mysql://u:secret@h/d",
        2,
        "--store must be sled:DIR, memory: or postgres://",
    );
    refused(
        &sandbox,
        "--store postgres://u:secret@h/d?sslmode=prefer",
        2,
        "sslmode=require",
    );
    // No server listens on this port.
    let free = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    assert!(TcpStream::connect(free).is_err());
    refused(
        &sandbox,
        &format!("--store postgres://u:secret@{free}/d"),
        3,
        "does not answer",
    );
    refused(
        &sandbox,
        &format!("--store {}", server.url_on_loopback()),
        3,
        "PGPASSWORD",
    );
    sandbox.set("PGPASSWORD", "secret");
    refused(
        &sandbox,
        &format!("--store {}", server.url_on_loopback()),
        3,
        "PGPASSWORD",
    );
    sandbox.set("PGPASSWORD", server.password());
    let everywhere = format!(
        "--store {} --listen 0.0.0.0:0 --allow-plaintext",
        server.url_on_loopback()
    );
    let run = sandbox.run(&format!("coordinator --data-dir data {everywhere}"));
    run.code(2).says("--advertise");
    let _one = sandbox.serve(
        "data",
        &format!("--store {} --listen 127.0.0.1:0", server.url_on_loopback()),
    );
    refused(
        &sandbox,
        &format!("--store {}", server.url_on_loopback()),
        3,
        "in use by another coordinator",
    );
    server.sql(
        "sightline",
        "INSERT INTO sightline.migrations VALUES (9, now())",
    );
    let newer = sandbox.run(&format!(
        "coordinator --data-dir other --listen 127.0.0.1:0 --store {}",
        server.url_on_loopback()
    ));
    newer.code(3).says("tables of version 9");
}

#[test]
fn records_move_into_database_and_back() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let bytes = {
        let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
        let _worker = coordinator.worker();
        let job = coordinator.submit(JOB);
        coordinator.finish(job)
    };
    let (disk, database) = ("sled:data/state", server.url());
    let verify = format!("store verify --store {database} --data-dir data");
    sandbox.ok(&format!("store migrate {disk} {database}"));
    sandbox
        .run(&format!("store migrate {disk} {database}"))
        .code(3)
        .says("cannot import another store");
    {
        let arguments = format!("--listen 127.0.0.1:0 --store {database}");
        let coordinator = sandbox.serve("data", &arguments);
        // For a moment, the database still names the process that moved the records as its leader.
        wait_for("the new leader", || {
            (!coordinator.run("jobs").err.contains("error:")).then_some(())
        });
        coordinator.ok("fetch 1 -o moved.pvs");
        assert_same(&sandbox.read("moved.pvs"), &bytes, "from the database");
        let used = sandbox.run(&format!("store migrate {database} sled:back"));
        used.code(3).says("a coordinator uses the database of FROM");
        sandbox
            .run(&verify)
            .code(3)
            .says("a coordinator uses the database of --store");
    }
    let found = sandbox.json(&verify);
    assert_eq!((&found["scenes"], &found["jobs"]), (&1.into(), &1.into()));
    assert_eq!(found["lost"].as_array().unwrap().len(), 0);
    // `store verify` detects the loss.
    std::fs::rename(sandbox.path("data/blobs"), sandbox.path("blobs")).unwrap();
    std::fs::create_dir(sandbox.path("data/blobs")).unwrap();
    let lost = sandbox.run(&format!("--json {verify}")).code(3);
    assert!(lost.out.contains("the result of job 1"), "{}", lost.out);
    std::fs::remove_dir_all(sandbox.path("data/blobs")).unwrap();
    std::fs::rename(sandbox.path("blobs"), sandbox.path("data/blobs")).unwrap();
    sandbox.ok(&format!("{verify} --repair"));
    sandbox.ok(&format!("store migrate {database} sled:back"));
    let coordinator = sandbox.serve("data", "--listen 127.0.0.1:0 --store sled:back");
    coordinator.ok("fetch 1 -o back.pvs");
    assert_same(&sandbox.read("back.pvs"), &bytes, "back on disk");
    sandbox
        .run("store migrate memory: sled:other")
        .code(2)
        .says("FROM must be sled:DIR");
}

#[test]
fn store_in_memory_or_other_directory_works() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let memory = sandbox.serve("data", "--listen 127.0.0.1:0 --store memory:");
    memory.submit(JOB);
    assert!(
        memory
            .process
            .err()
            .contains("are lost when this coordinator ends")
    );
    drop(memory);
    for _ in 0..2 {
        let sled = sandbox.serve("data", "--listen 127.0.0.1:0 --store sled:elsewhere");
        assert_eq!(sled.submit(JOB), 1);
    }
    assert!(sandbox.path("elsewhere/journal").is_file() && !sandbox.path("data/state").exists());
}

#[test]
fn encrypted_calls_are_forwarded_with_tokens_but_not_certificates() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let mut sandbox = Sandbox::new();
    sandbox.set("SIGHTLINE_STORE", server.url());
    // All coordinators use one certificate, which is its own authority.
    let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
    let own = rcgen::generate_simple_self_signed(names).unwrap();
    sandbox.write("farm.pem", own.cert.pem());
    sandbox.write("farm.key", own.signing_key.serialize_pem());
    for (user, scope) in [("ada", "submit"), ("smith", "worker")] {
        let text = sandbox.ok(&format!(
            "token new --tokens tokens.json --user {user} --scope {scope}"
        ));
        sandbox.write(&format!("{user}.token"), text);
    }
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    const JOB: &str = "town.glb --cells 2x2x1 --target-error 0.1 --backend cpu";
    sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir alone"));
    let guarded = "--tls-cert farm.pem --tls-key farm.key --client-ca farm.pem --peer-ca farm.pem \
                   --tokens tokens.json";
    let first = replica(&sandbox, "a", guarded);
    leads(&first);
    let second = replica(&sandbox, "b", guarded);
    stands_by(&second, &first);
    let ada = "--ca farm.pem --token-file ada.token";
    let job: u64 = second
        .ok(&format!("submit {JOB} {ada}"))
        .trim()
        .parse()
        .unwrap();
    // The leader rejects unknown callers.
    second
        .run("jobs --ca farm.pem")
        .code(4)
        .says("needs a token");
    second
        .run(&format!("workers {ada}"))
        .code(4)
        .says("needs the scope admin");
    let certified = second.start(
        "worker --backend cpu --threads 1 --ca farm.pem --cert farm.pem --key farm.key --give-up-after 60",
    );
    wait_for("the certificate to be refused", || {
        let log = certified.err();
        (log.contains("cannot forward a certificate") && log.contains(&first.url)).then_some(())
    });
    drop(certified);
    let worker =
        second.start("worker --backend cpu --threads 1 --ca farm.pem --token-file smith.token");
    second.ok(&format!("watch {job} {ada}"));
    second.ok(&format!("fetch {job} -o passed.pvs {ada}"));
    assert_same(
        &sandbox.read("passed.pvs"),
        &sandbox.read("alone.pvs"),
        "passed on",
    );
    for name in ["ada", "smith"] {
        let text = String::from_utf8(sandbox.read(&format!("{name}.token"))).unwrap();
        let secret = text.trim().rsplit('_').next().unwrap();
        for process in [&first.process, &second.process, &worker] {
            assert!(!process.err().contains(secret));
        }
    }
}
