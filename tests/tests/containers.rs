//! Tests of the image and the compose file in a real engine.
//!
//! A cluster in containers, used over gRPC from outside, gives the same bytes as one process, while it is
//! scaled and loses workers. The job has many tiles, or one.
//!
//! The tests need a container engine that can run Debian, and a way to make the base image
//! (`deploy/base-image.sh`). Without them, a test prints this in one line and passes. If `CI` is set, it
//! fails instead. The tests check the cluster's result, never its speed.
//!
//! Environment: `SIGHTLINE_BIN` names the program (default: the program in the target folder).
//! `SIGHTLINE_TEST_TRIANGLES` and `SIGHTLINE_TEST_CELLS` set the size of the job of many tiles, which has to
//! last long enough for the faults to occur in its middle. The job of one tile selects its own size.

// The permissions for tests in clippy.toml cover only `#[test]` functions, not the helpers of an integration
// test.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::sleep;
use std::time::{Duration, Instant};

use sightline_tests::{Compose, docker, in_ci, logged, program, run};

/// The default size of the town and of the grid. With them, two single-threaded workers are busy for much
/// more than twenty seconds.
const DEFAULT_TRIANGLES: &str = "20000";
const DEFAULT_CELLS: &str = "8x8x4";
/// The time in seconds that one process needs for a town's block, so that the block lasts through all faults.
const LASTING: f64 = 8.0;
/// Target errors for such a block, on slow and on fast machines.
const ERRORS: [&str; 5] = ["0.00002", "0.00001", "0.000005", "0.000002", "0.000001"];
const SIZE_IT_UP: &str = "size it up by SIGHTLINE_TEST_TRIANGLES or SIGHTLINE_TEST_CELLS";
/// Maximum duration of a wait.
const LIMIT: Duration = Duration::from_secs(300);
/// The lock of the cluster, because two simultaneous clusters would compete for the cores.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Returns a cluster, if this machine can run one. The other test waits.
fn cluster() -> Option<(MutexGuard<'static, ()>, Compose)> {
    let turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    match Compose::prepare() {
        Ok(compose) => Some((turn, compose)),
        Err(reason) if in_ci() => panic!("containers test cannot run: {reason}"),
        Err(reason) => {
            eprintln!("containers test did not run: {reason}");
            None
        }
    }
}

#[test]
fn containers_give_same_bytes_after_killed_worker() {
    let Some((_turn, compose)) = cluster() else {
        return;
    };
    let sightline = program();

    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("town.glb");
    let triangles = setting("SIGHTLINE_TEST_TRIANGLES", DEFAULT_TRIANGLES);
    let cells = setting("SIGHTLINE_TEST_CELLS", DEFAULT_CELLS);
    // Every parameter is part of the job's key, so both bakes need the same flags.
    let job_flags = [
        "--cells",
        &cells,
        "--sampler",
        "cubes",
        "--backend",
        "cpu",
        "--resolution",
        "192",
    ];
    run(Command::new(sightline)
        .args([
            "generate",
            "town",
            "--seed",
            "1",
            "--triangles",
            &triangles,
            "-o",
        ])
        .arg(&scene));

    let alone = folder.path().join("alone.pvs");
    let started = Instant::now();
    run(Command::new(sightline)
        .arg("bake")
        .arg(&scene)
        .arg("-o")
        .arg(&alone)
        .args(job_flags)
        .arg("--data-dir")
        .arg(folder.path().join("store")));
    eprintln!("one process: {:.1} s", started.elapsed().as_secs_f64());

    compose.up(2);
    let url = format!("http://127.0.0.1:{}", compose.port);
    let client = |args: &[&str]| {
        run(Command::new(sightline)
            .args(args)
            .args(["--coordinator", &url]))
    };
    // The engine accepts connections before the program in the container listens.
    wait_until("the coordinator answers", || {
        coordinator_answers(&url).then_some(())
    });

    let started = Instant::now();
    let mut submit = vec!["submit", scene.to_str().unwrap(), "--name", "town"];
    submit.extend(job_flags);
    let job = client(&submit).trim().to_owned();
    assert!(!job.is_empty(), "submit prints the id of the job");
    let first_workers = compose.workers();
    assert_eq!(first_workers.len(), 2, "two workers are up");
    compose.up(3);
    assert_eq!(compose.workers().len(), 3, "three workers are up");

    let progress = || Progress::parse(&client(&["show", &job, "--json"]));
    let before = loop {
        let now = progress();
        // The middle of the job: tiles are committed, and all three workers have tiles.
        if now.done > 0 && now.workers == 3 && now.running >= 3 {
            break now;
        }
        assert!(
            now.done < now.total,
            "the job was over before three workers were at it ({now:?}); {SIZE_IT_UP}"
        );
        assert!(
            started.elapsed() < LIMIT,
            "three workers never were at work on a job begun: {now:?}"
        );
        sleep(Duration::from_millis(100));
    };
    docker(&["kill", "--signal", "KILL", &first_workers[0]]);
    let after = progress();
    eprintln!("killed a worker between {before:?} and {after:?}");
    assert!(
        after.done < after.total,
        "the job was over before the worker died ({after:?}); {SIZE_IT_UP}"
    );

    client(&["watch", &job]);
    eprintln!(
        "three workers, one killed: {:.1} s",
        started.elapsed().as_secs_f64()
    );
    let end = progress();
    assert_eq!(
        (end.done, end.set_aside),
        (end.total, 0),
        "every tile is committed at the end, none set aside"
    );
    assert_eq!(compose.workers().len(), 2, "the killed worker stayed dead");

    let together = folder.path().join("together.pvs");
    client(&["fetch", &job, "-o", together.to_str().unwrap()]);
    assert_same_bytes(&alone, &together);
}

/// Waits until `look` returns a value, as a step of a test.
fn wait_until<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(seen) = look() {
            eprintln!("{what}: after {:.1} s", began.elapsed().as_secs_f64());
            return seen;
        }
        assert!(began.elapsed() < LIMIT, "waited {LIMIT:?} in vain: {what}");
        sleep(Duration::from_millis(100));
    }
}

#[test]
fn containers_share_one_block_through_all_faults() {
    let Some((_turn, compose)) = cluster() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("town.glb");
    run(Command::new(program())
        .args(["generate", "town", "--triangles", "20000", "-o"])
        .arg(&scene));
    let alone = folder.path().join("alone.pvs");
    let job_flags = ERRORS
        .map(|error| {
            [
                "--cells",
                "8x8x8",
                // With small errors, the default has several tiles.
                "--block-cells",
                "512",
                "--backend",
                "cpu",
                "--target-error",
                error,
            ]
        })
        .into_iter()
        .enumerate()
        .find(|(attempt, flags)| {
            let started = Instant::now();
            run(Command::new(program())
                .arg("bake")
                .arg(&scene)
                .arg("-o")
                .arg(&alone)
                .args(flags)
                .arg("--data-dir")
                .arg(folder.path().join(format!("store-{attempt}"))));
            let seconds = started.elapsed().as_secs_f64();
            eprintln!("one process: {seconds:.1} s with {}", flags.join(" "));
            seconds >= LASTING
        })
        .map(|(_, flags)| flags)
        .unwrap_or_else(|| panic!("no target error of {ERRORS:?} makes a block of {LASTING} s"));

    compose.up(2);
    let url = format!("http://127.0.0.1:{}", compose.port);
    let client = |args: &[&str]| {
        run(Command::new(program())
            .args(args)
            .args(["--coordinator", &url]))
    };
    let mut submit = vec!["submit", scene.to_str().unwrap()];
    submit.extend(job_flags);
    let started = Instant::now();
    let job = client(&submit).trim().to_owned();
    let still_runs = |what: &str| {
        let now = Progress::parse(&client(&["show", &job, "--json"]));
        assert_eq!(
            (now.done, now.total),
            (0, 1),
            "the job was over before {what}; LASTING has to be longer"
        );
    };
    let has_said = |worker: &String, what: &str| logged(worker).contains(what);
    let helps = |worker: &String| has_said(worker, "helps with tile 0");

    // First the second worker helps the first one, then the cluster has four workers.
    let first = compose.workers();
    let helper = wait_until("the second worker helps", || {
        first.iter().find(|w| helps(w)).cloned()
    });
    let leader = first.iter().find(|w| **w != helper).unwrap().clone();
    compose.up(4);
    let late: Vec<String> = compose
        .workers()
        .into_iter()
        .filter(|w| !first.contains(w))
        .collect();
    wait_until("two more workers help", || {
        late.iter().all(helps).then_some(())
    });
    still_runs("four workers were at it");

    // The leader pauses for longer than its lease lasts, and another worker continues.
    docker(&["pause", &leader]);
    let others: Vec<String> = compose
        .workers()
        .into_iter()
        .filter(|w| *w != leader)
        .collect();
    let next = wait_until("another worker leads", || {
        others
            .iter()
            .find(|w| has_said(w, "continues after"))
            .cloned()
    });
    docker(&["unpause", &leader]);
    still_runs("its second leader began");

    // A helper dies, another one is cut off, and the coordinator restarts.
    let helpers: Vec<&String> = others.iter().filter(|w| **w != next).collect();
    docker(&["kill", "--signal", "KILL", helpers[0]]);
    docker(&["network", "disconnect", &compose.network(), helpers[1]]);
    let coordinator = compose.coordinator();
    docker(&["kill", "--signal", "KILL", &coordinator]);
    docker(&["start", &coordinator]);
    wait_until("the leader has a crew again", || {
        let again = has_said(&next, "has a crew again");
        if !again && coordinator_answers(&url) {
            still_runs("its leader had a crew again");
        }
        again.then_some(())
    });
    docker(&["network", "connect", &compose.network(), helpers[1]]);
    still_runs("the coordinator was back");

    client(&["watch", &job]);
    eprintln!("the cluster: {:.1} s", started.elapsed().as_secs_f64());
    let together = folder.path().join("together.pvs");
    client(&["fetch", &job, "-o", together.to_str().unwrap()]);
    assert_same_bytes(&alone, &together);
}

/// Returns true if the coordinator at this address answers. It may be starting.
fn coordinator_answers(url: &str) -> bool {
    let health = Command::new(program())
        .args(["health", "--coordinator", url])
        .output()
        .unwrap();
    health.status.success()
}

/// Panics unless both results have the same bytes and the same profile.
fn assert_same_bytes(alone: &Path, together: &Path) {
    let profiles = [alone, together].map(profile);
    eprintln!(
        "one process on {}, the cluster on {}",
        profiles[0], profiles[1]
    );
    assert_eq!(
        profiles[0], profiles[1],
        "the host and the image have different backends"
    );
    let (alone, together) = (fs::read(alone).unwrap(), fs::read(together).unwrap());
    sightline_tests::assert_same(&alone, &together, "the cluster's result differs");
    eprintln!("{} bytes, the same", alone.len());
}

/// The numbers of a job's tiles and of the coordinator's workers in `sightline show --json`.
#[derive(Debug)]
struct Progress {
    done: u64,
    total: u64,
    running: u64,
    set_aside: u64,
    workers: u64,
}

impl Progress {
    fn parse(json: &str) -> Self {
        let shown: serde_json::Value =
            serde_json::from_str(json).unwrap_or_else(|error| panic!("{error} in {json}"));
        let count = |key: &str| {
            shown[key]
                .as_u64()
                .unwrap_or_else(|| panic!("no count '{key}' in {json}"))
        };
        Self {
            done: count("tiles_done"),
            total: count("tiles_total"),
            running: count("tiles_running"),
            set_aside: count("tiles_set_aside"),
            workers: count("workers"),
        }
    }
}

/// Returns the numerics profile of a result from `sightline info`.
fn profile(result: &Path) -> String {
    let info = run(Command::new(program())
        .arg("info")
        .arg(result)
        .arg("--json"));
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    info["info"]["profile"]
        .as_str()
        .unwrap_or_else(|| panic!("no profile in {info}"))
        .to_owned()
}

fn setting(name: &str, default: &str) -> String {
    std::env::var(name).unwrap_or_else(|_| default.to_owned())
}
