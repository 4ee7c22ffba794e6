//! A load test of two coordinators on one database. Half of the simulated workers connect to the leader and
//! half to the standby; all lease tiles and send outputs as fast as they can.
//!
//! ```text
//! cargo test --workspace --test replica_load -- --ignored --nocapture
//! ```
//! The figure includes gRPC, the forwarding, the checks and files of outputs, and the database with its disk.
//! `SIGHTLINE_WORKERS` changes the number of workers (default: 32).

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a measurement"
)]

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use sightline_tests::{Coordinator, Postgres, Sandbox, wait_for};

mod simulated;

use simulated::Work;

const JOB: &str = "rooms.glb --cells 64x64x1 --block-cells 1 --backend cpu";
const TILES: u64 = 4096;
/// The number of tiles at which the measurement ends. The last tiles are computed twice, and would count
/// twice.
const ENOUGH: u64 = TILES * 9 / 10;

fn replica<'a>(sandbox: &'a Sandbox, name: &str) -> Coordinator<'a> {
    for folder in ["shared", name] {
        std::fs::create_dir_all(sandbox.path(folder)).unwrap();
    }
    std::os::unix::fs::symlink(sandbox.path("shared"), sandbox.path(name).join("blobs")).unwrap();
    sandbox.serve(name, "--listen 127.0.0.1:0")
}

#[test]
#[ignore = "a measurement"]
fn leases_and_commits_a_second_at_two_coordinators() {
    let Some(server) = Postgres::start_with("") else {
        return;
    };
    let mut sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    sandbox.set("SIGHTLINE_STORE", server.url());
    let first = replica(&sandbox, "a");
    wait_for("a leader", || {
        first
            .process
            .err()
            .contains("this coordinator leads")
            .then_some(())
    });
    let second = replica(&sandbox, "b");
    let job = second.submit(JOB);
    let workers = std::env::var("SIGHTLINE_WORKERS").map_or(32, |n| n.parse().unwrap());
    let work = Arc::new(Work::default());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .unwrap();
    let begun = Instant::now();
    let _working = simulated::start(&runtime, &[&first.url, &second.url], workers, &work);
    wait_for("the tiles", || {
        (work.done.load(Ordering::Relaxed) >= ENOUGH).then_some(())
    });
    let (took, done) = (
        begun.elapsed().as_secs_f64(),
        work.done.load(Ordering::Relaxed),
    );
    work.over.store(true, Ordering::Relaxed);
    println!(
        "{workers} workers, {done} leases and commits: {:.0} a second",
        done as f64 / took
    );
    assert!(second.count(job, "tiles_done") >= ENOUGH);
    drop(runtime);
    // Measure the time from the end of the leader to the first answer of its successor.
    let ended = Instant::now();
    first.process.kill();
    wait_for("an answer", || {
        sandbox
            .run(&format!("jobs --coordinator {}", second.url))
            .succeeded()
            .then_some(())
    });
    println!(
        "from the leader's end to an answer: {:.1} s",
        ended.elapsed().as_secs_f64()
    );
}
