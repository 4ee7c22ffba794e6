//! The image and the compose file, tested in a real engine: a cluster in containers, used over gRPC from
//! outside, gives the same bytes as one process, although it is scaled and loses a worker meanwhile.
//!
//! Needs a container engine that can run Debian and a way to make the base image (`deploy/base-image.sh`).
//! Without them it says so in one line and passes; where `CI` is set it fails instead. The test checks the
//! cluster's result, never its speed.
//!
//! Environment: `SIGHTLINE_BIN` names the program (default: the one in the target folder),
//! `SIGHTLINE_TEST_TRIANGLES` and `SIGHTLINE_TEST_CELLS` size the job, which has to last long enough for a
//! worker to die in the middle of it.

// clippy.toml's permissions for tests reach `#[test]` functions only, not the helpers of an integration test.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::ffi::OsStr;
use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Town size and cells at which two single-threaded workers are busy for well over twenty seconds.
const DEFAULT_TRIANGLES: &str = "20000";
const DEFAULT_CELLS: &str = "8x8x4";
const SIZE_IT_UP: &str = "size it up by SIGHTLINE_TEST_TRIANGLES or SIGHTLINE_TEST_CELLS";
/// All steps together may take no longer; a hung cluster is a failure that is cleaned up after, not a hung
/// test run.
const LIMIT: Duration = Duration::from_secs(900);
/// When the first step began; [`LIMIT`] counts from here.
static BEGAN: LazyLock<Instant> = LazyLock::new(Instant::now);

#[test]
fn containers_bake_the_same_bytes_although_a_worker_is_killed() {
    let sightline = find_program();
    let compose = match Compose::prepare(&sightline) {
        Ok(compose) => compose,
        Err(reason) if in_ci() => panic!("containers test cannot run: {reason}"),
        Err(reason) => {
            eprintln!("containers test did not run: {reason}");
            return;
        }
    };

    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("town.glb");
    let triangles = setting("SIGHTLINE_TEST_TRIANGLES", DEFAULT_TRIANGLES);
    let cells = setting("SIGHTLINE_TEST_CELLS", DEFAULT_CELLS);
    // Every parameter is part of the job's key, so both bakes need the same flags.
    let job_flags = ["--cells", &cells, "--sampler", "cubes", "--backend", "cpu", "--resolution", "192"];
    run(Command::new(&sightline)
        .args(["generate", "town", "--seed", "1", "--triangles", &triangles, "-o"])
        .arg(&scene));

    let alone = folder.path().join("alone.pvs");
    let started = Instant::now();
    run(Command::new(&sightline)
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
    let client = |args: &[&str]| run(Command::new(&sightline).args(args).args(["--coordinator", &url]));
    client(&["health"]);

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
        // In the middle of the job: tiles are committed, and all three workers have tiles.
        if now.done > 0 && now.workers == 3 && now.running >= 3 {
            break now;
        }
        assert!(
            now.done < now.total,
            "the job was over before three workers were at it ({now:?}); {SIZE_IT_UP}"
        );
        assert!(BEGAN.elapsed() < LIMIT, "three workers never were at work on a job begun: {now:?}");
        sleep(Duration::from_millis(100));
    };
    run(Command::new("docker").args(["kill", "--signal", "KILL", &first_workers[0]]));
    let after = progress();
    eprintln!("killed a worker between {before:?} and {after:?}");
    assert!(after.done < after.total, "the job was over before the worker died ({after:?}); {SIZE_IT_UP}");

    client(&["watch", &job]);
    eprintln!("three workers, one killed: {:.1} s", started.elapsed().as_secs_f64());
    let end = progress();
    assert_eq!(
        (end.done, end.set_aside),
        (end.total, 0),
        "every tile is committed at the end, none set aside"
    );
    assert_eq!(compose.workers().len(), 2, "the killed worker stayed dead");

    let together = folder.path().join("together.pvs");
    client(&["fetch", &job, "-o", together.to_str().unwrap()]);
    let profiles = [&alone, &together].map(|result| profile(&sightline, result));
    eprintln!("one process on {}, the cluster on {}", profiles[0], profiles[1]);
    assert_eq!(
        profiles[0], profiles[1],
        "host and image hold different versions of Embree; make the image of the host's release"
    );
    let (alone, together) = (fs::read(alone).unwrap(), fs::read(together).unwrap());
    let differing = alone.iter().zip(&together).position(|(a, b)| a != b);
    assert!(
        alone == together,
        "the cluster's result differs: {} bytes against {}, first at {differing:?}",
        together.len(),
        alone.len()
    );
    eprintln!("{} bytes, the same", alone.len());
}

/// Tiles of a job, and the coordinator's workers, as `sightline show --json` counts them.
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
        let count = |key: &str| shown[key].as_u64().unwrap_or_else(|| panic!("no count '{key}' in {json}"));
        Self {
            done: count("tiles_done"),
            total: count("tiles_total"),
            running: count("tiles_running"),
            set_aside: count("tiles_set_aside"),
            workers: count("workers"),
        }
    }
}

/// One compose project of its own name, image and port. Dropping it takes everything down again, also after a
/// panic.
struct Compose {
    /// `docker-compose`, or `docker compose`.
    program: &'static [&'static str],
    project: String,
    image: String,
    port: u16,
}

impl Compose {
    /// Finds engine and compose and builds the image; `Err` says what this machine lacks for it.
    fn prepare(sightline: &Path) -> Result<Self, String> {
        if !succeeds(&["docker", "info"]) {
            return Err("no container engine answers (docker info)".into());
        }
        let program: &[&str] = if succeeds(&["docker-compose", "version"]) {
            &["docker-compose"]
        } else if succeeds(&["docker", "compose", "version"]) {
            &["docker", "compose"]
        } else {
            return Err("neither docker-compose nor docker compose is installed".into());
        };
        if !Command::new(root().join("deploy/base-image.sh")).status().is_ok_and(|status| status.success()) {
            return Err("the base image cannot be made here (deploy/base-image.sh says why)".into());
        }
        // A port that is free now. Something else may take it before compose does; the test then fails saying
        // so.
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let project = format!("sightline-test-{}", std::process::id());
        let compose = Self { program, image: format!("{project}:local"), project, port };
        run(Command::new(root().join("deploy/build-image.sh"))
            .arg(sightline)
            .env("SIGHTLINE_IMAGE", &compose.image));
        Ok(compose)
    }

    fn command(&self) -> Command {
        let mut command = Command::new(self.program[0]);
        command
            .args(&self.program[1..])
            .args(["--project-name", &self.project, "--file"])
            .arg(root().join("deploy/compose.yaml"))
            .env("SIGHTLINE_IMAGE", &self.image)
            .env("SIGHTLINE_PORT", self.port.to_string())
            .env("SIGHTLINE_BACKEND", "cpu")
            .env("SIGHTLINE_WORKER_THREADS", "1");
        command
    }

    /// Starts the containers that are missing for one coordinator and `workers` workers; running ones stay.
    fn up(&self, workers: usize) {
        let scale = format!("worker={workers}");
        run(self.command().args(["up", "--detach", "--no-recreate", "--scale", &scale]));
    }

    /// Ids of the worker containers that are running.
    fn workers(&self) -> Vec<String> {
        let project = format!("label=com.docker.compose.project={}", self.project);
        let filters = ["--filter", &project, "--filter", "label=com.docker.compose.service=worker"];
        run(Command::new("docker").args(["ps", "--quiet"]).args(filters)).lines().map(str::to_owned).collect()
    }
}

impl Drop for Compose {
    fn drop(&mut self) {
        // Nothing here may panic: that would abort the test run in the middle of a clean-up.
        if std::thread::panicking() {
            let _shown = self.command().args(["logs", "--no-color", "--tail", "40"]).status();
        }
        let down = self.command().args(["down", "--volumes", "--remove-orphans", "--timeout", "5"]).output();
        if !down.is_ok_and(|output| output.status.success()) {
            eprintln!("containers test: project {} could not be taken down; see docker ps", self.project);
        }
        let _absent_if_the_build_failed =
            Command::new("docker").args(["image", "rm", "--force", &self.image]).output();
    }
}

/// Numerics profile a result was computed on, as `sightline info` names it.
fn profile(sightline: &Path, result: &Path) -> String {
    let info = run(Command::new(sightline).arg("info").arg(result).arg("--json"));
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    info["info"]["profile"].as_str().unwrap_or_else(|| panic!("no profile in {info}")).to_owned()
}

/// Runs a command to its end and returns what it printed on stdout. Panics, with all its output, when it
/// fails or takes past [`LIMIT`].
fn run(command: &mut Command) -> String {
    // Files, not pipes: a pipe would need a reader while this thread watches the time.
    let (out, err) = (tempfile::NamedTempFile::new().unwrap(), tempfile::NamedTempFile::new().unwrap());
    let began = *BEGAN;
    let mut child = command
        .stdin(Stdio::null())
        .stdout(out.reopen().unwrap())
        .stderr(err.reopen().unwrap())
        .spawn()
        .unwrap_or_else(|error| panic!("{command:?} does not start: {error}"));
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break Some(status);
        }
        if began.elapsed() > LIMIT {
            child.kill().unwrap();
            child.wait().unwrap();
            break None;
        }
        sleep(Duration::from_millis(20));
    };
    let text = |path: &Path| String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
    let (out, err) = (text(out.path()), text(err.path()));
    match status {
        Some(status) if status.success() => out,
        Some(status) => panic!("{command:?} failed, {status}:\n{out}{err}"),
        None => panic!("{command:?} was ended, as the test had taken {LIMIT:?}:\n{out}{err}"),
    }
}

/// Whether a command can be started and succeeds; its output does not matter.
fn succeeds(words: &[&str]) -> bool {
    Command::new(words[0]).args(&words[1..]).output().is_ok_and(|output| output.status.success())
}

/// The program under test: `SIGHTLINE_BIN`, or what cargo built beside this test, or the release build.
fn find_program() -> PathBuf {
    if let Some(named) = std::env::var_os("SIGHTLINE_BIN") {
        let named = PathBuf::from(named);
        assert!(named.is_file(), "SIGHTLINE_BIN names no file: {}", named.display());
        return named;
    }
    // target/PROFILE/deps/containers-HASH
    let test = std::env::current_exe().unwrap();
    let profile = test.ancestors().nth(2).unwrap();
    let target = profile.parent().unwrap();
    [profile.join("sightline"), target.join("release/sightline")]
        .into_iter()
        .find(|program| program.is_file())
        .unwrap_or_else(|| panic!("no sightline in {}; cargo build --workspace first", target.display()))
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn setting(name: &str, default: &str) -> String {
    std::env::var(name).unwrap_or_else(|_| default.to_owned())
}

fn in_ci() -> bool {
    std::env::var_os("CI").is_some_and(|value| !value.is_empty() && value != OsStr::new("false"))
}
