//! A test of a tile that kills its workers, among fifty good ones: by an abort, by the kernel for memory, or
//! by an exit.
//!
//! ```text
//! cargo test --workspace --test poison -- --nocapture
//! ```
//! Each worker is a separate process, which the test starts again under the same name when the process ends.
//! The test prints the times of the job with and without the bad tile.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests"
)]

use std::path::PathBuf;
use std::process::{Child, Command};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use sightline_tests::{Coordinator, Sandbox, in_ci};

mod simulated;

use simulated::Work;

/// The job: 51 tiles of one cell each.
const JOB: &str =
    "rooms.glb --cells 51x1x1 --block-cells 1 --backend cpu --cell-to-cell off --seed";
/// The number of the tile that kills its workers.
const BAD: u32 = 20;
/// The environment variables of a worker's process: the address, the name, and the way to die.
const ADDRESS: &str = "POISON_ADDRESS";
const NAME: &str = "POISON_NAME";
const END: &str = "POISON_END";
/// The names of the workers.
const WORKERS: [&str; 3] = ["ada", "bob", "eve"];
/// The memory limit of a worker's control group, in bytes.
const MEMORY: u64 = 256 << 20;
/// The computation time of a tile.
const TILE: Duration = Duration::from_millis(200);

/// Runs a worker. The other test starts this test as a separate process.
#[test]
#[ignore = "the process of a worker"]
fn worker_process() {
    let (address, name) = (
        std::env::var(ADDRESS).unwrap(),
        std::env::var(NAME).unwrap(),
    );
    let end = std::env::var(END).unwrap();
    let instance = u64::from(std::process::id());
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let before = move |tile: u32| {
        if tile == BAD {
            die(&end);
        }
        std::thread::sleep(TILE);
    };
    runtime.block_on(simulated::work_with(
        &address,
        &name,
        instance,
        &Work::default(),
        &before,
    ));
}

/// Ends the process.
#[allow(clippy::disallowed_methods, reason = "the ends that the test is about")]
fn die(end: &str) {
    match end {
        "abort" => std::process::abort(),
        "exit" => std::process::exit(3),
        "memory" => {
            let mut all = Vec::new();
            // The kernel ends the process before the list is complete.
            for _ in 0..64 {
                all.push(vec![1u8; 16 << 20]);
            }
            panic!(
                "{} MB fit into a control group of {} MB",
                all.len() * 16,
                MEMORY >> 20
            );
        }
        "never" => {}
        other => panic!("no way to die: {other}"),
    }
}

/// A control group that limits the memory of its processes. Dropping it removes the group.
struct Bounded(PathBuf);

impl Bounded {
    /// Creates a group. Returns `None` if this machine has no such groups, or the test may not create one.
    fn new(name: &str) -> Option<Self> {
        let name = format!("sightline-{}-{name}", std::process::id());
        for (root, limit) in [("memory", "memory.limit_in_bytes"), ("", "memory.max")] {
            let group = PathBuf::from("/sys/fs/cgroup").join(root).join(&name);
            if std::fs::create_dir(&group).is_err() {
                continue;
            }
            let group = Self(group);
            if std::fs::write(group.0.join(limit), MEMORY.to_string()).is_ok() {
                return Some(group);
            }
        }
        None
    }

    /// Puts a process into the group.
    fn add(&self, process: u32) {
        std::fs::write(self.0.join("cgroup.procs"), process.to_string()).unwrap();
    }
}

impl Drop for Bounded {
    fn drop(&mut self) {
        // The kernel may keep the group for a moment after its last process.
        for _ in 0..100 {
            if std::fs::remove_dir(&self.0).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

fn start(coordinator: &Coordinator<'_>, name: &str, end: &str, group: Option<&Bounded>) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "worker_process", "--ignored", "--nocapture"]);
    command
        .env(ADDRESS, &coordinator.url)
        .env(NAME, name)
        .env(END, end);
    command
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null());
    let child = command.spawn().unwrap();
    if let Some(group) = group {
        group.add(child.id());
    }
    child
}

/// Runs a job with three workers that are started again whenever they end, each in its own group if there
/// are groups. Returns the duration of the job and the number of ends.
fn run(
    coordinator: &Coordinator<'_>,
    job: u64,
    end: &str,
    groups: Option<&[Bounded; 3]>,
) -> (Duration, u32) {
    let (over, ends) = (AtomicBool::new(false), AtomicU32::new(0));
    let begun = Instant::now();
    std::thread::scope(|scope| {
        for (at, name) in WORKERS.into_iter().enumerate() {
            let (over, ends) = (&over, &ends);
            let group = groups.map(|groups| &groups[at]);
            scope.spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    let mut worker = start(coordinator, name, end, group);
                    while worker.try_wait().unwrap().is_none() && !over.load(Ordering::Relaxed) {
                        std::thread::sleep(Duration::from_millis(5));
                    }
                    if over.load(Ordering::Relaxed) {
                        // The worker may have ended by itself.
                        let _ = worker.kill();
                    } else {
                        ends.fetch_add(1, Ordering::Relaxed);
                    }
                    worker.wait().unwrap();
                }
            });
        }
        coordinator.finish(job);
        over.store(true, Ordering::Relaxed);
    });
    (begun.elapsed(), ends.load(Ordering::Relaxed))
}

#[test]
fn tile_that_kills_workers_is_set_aside() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(&format!("{JOB} 1"));
    let (calm, ends) = run(&coordinator, job, "never", None);
    assert_eq!((ends, coordinator.count(job, "tiles_set_aside")), (0, 0));
    for (seed, end) in (2..).zip(["abort", "memory", "exit"]) {
        // In a common group, the kernel could end a worker with a good tile.
        let groups = if end == "memory" {
            let [Some(ada), Some(bob), Some(eve)] = WORKERS.map(Bounded::new) else {
                assert!(
                    !in_ci(),
                    "no control group could be made, so the kernel ends nobody for memory"
                );
                println!("not run: the end for memory (no control group could be made)");
                continue;
            };
            Some([ada, bob, eve])
        } else {
            None
        };
        let job = coordinator.submit(&format!("{JOB} {seed}"));
        let (time, ends) = run(&coordinator, job, end, groups.as_ref());
        println!(
            "{end}: {ends} workers ended, {:.2} of the calm time",
            time.as_secs_f64() / calm.as_secs_f64()
        );
        let (done, aside) = (
            coordinator.count(job, "tiles_done"),
            coordinator.count(job, "tiles_set_aside"),
        );
        assert_eq!((done, aside), (50, 1), "{end}");
        assert!((3..=5).contains(&ends), "{end}: {ends} workers ended");
        let tiles = coordinator.ok(&format!("show {job} --tiles"));
        assert!(tiles.contains("connection of the worker ended"), "{tiles}");
    }
}
