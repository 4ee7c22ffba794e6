//! A cluster in containers: a separate compose project, and commands with a time limit.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Maximum duration of a command. A command that takes longer hangs.
const HANGS: Duration = Duration::from_secs(600);

/// A compose project with its own name, image and port. Dropping it removes all its containers, also after a
/// panic.
pub struct Compose {
    /// The compose program: `docker-compose`, or `docker compose`.
    program: &'static [&'static str],
    project: String,
    image: String,
    /// The coordinator's port on this host.
    pub port: u16,
}

impl Compose {
    /// Finds the engine and compose, and builds the image.
    ///
    /// # Errors
    /// The reason, if this machine lacks a required program.
    pub fn prepare() -> Result<Self, String> {
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
        if !Command::new(root().join("deploy/base-image.sh"))
            .status()
            .is_ok_and(|status| status.success())
        {
            return Err(
                "the base image cannot be made here (deploy/base-image.sh says why)".into(),
            );
        }
        // The port is free now. If another process binds it before compose does, the test fails with an error
        // about the port.
        let port = TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
            .port();
        let project = format!("sightline-test-{}", std::process::id());
        let compose = Self {
            program,
            image: format!("{project}:local"),
            project,
            port,
        };
        run(Command::new(root().join("deploy/build-image.sh"))
            .arg(crate::program())
            .env("SIGHTLINE_IMAGE", &compose.image));
        Ok(compose)
    }

    fn command(&self) -> Command {
        let mut command = Command::new(self.program[0]);
        command
            .args(&self.program[1..])
            .args(["--project-name", &self.project, "--file"])
            .arg(root().join("deploy/compose.yaml"))
            .args(["--profile", "default"])
            .env("SIGHTLINE_IMAGE", &self.image)
            .env("SIGHTLINE_PORT", self.port.to_string())
            .env("SIGHTLINE_OPEN_FILES", open_files().to_string())
            .env("SIGHTLINE_BACKEND", "cpu")
            .env("SIGHTLINE_WORKER_THREADS", "1");
        command
    }

    /// Starts the missing containers of one coordinator and `workers` workers. Running containers stay.
    pub fn up(&self, workers: usize) {
        let scale = format!("worker={workers}");
        run(self
            .command()
            .args(["up", "--detach", "--no-recreate", "--scale", &scale]));
    }

    /// Returns the ids of the running worker containers.
    pub fn workers(&self) -> Vec<String> {
        self.running("worker")
    }

    /// Returns the id of the coordinator's container.
    pub fn coordinator(&self) -> String {
        self.running("coordinator")
            .pop()
            .unwrap_or_else(|| panic!("no coordinator is up"))
    }

    fn running(&self, service: &str) -> Vec<String> {
        let project = format!("label=com.docker.compose.project={}", self.project);
        let service = format!("label=com.docker.compose.service={service}");
        let filters = ["--filter", &project, "--filter", &service];
        run(Command::new("docker").args(["ps", "--quiet"]).args(filters))
            .lines()
            .map(str::to_owned)
            .collect()
    }

    /// Returns the name of the network on which workers reach the coordinator.
    pub fn network(&self) -> String {
        format!("{}_cluster", self.project)
    }
}

/// Returns the limit of open files for a container: 65 536, or the hard limit of this process. The hard limit
/// is the daemon's limit on machines whose daemon may not raise it.
fn open_files() -> u64 {
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let line = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max open files"))
        .unwrap_or_default();
    let hard = line
        .split_whitespace()
        .nth(1)
        .and_then(|hard| hard.parse().ok());
    hard.map_or(65_536, |hard: u64| hard.min(65_536))
}

/// Runs `docker` with these arguments.
pub fn docker(args: &[&str]) -> String {
    run(Command::new("docker").args(args))
}

/// Returns the log of a container so far.
pub fn logged(container: &str) -> String {
    let logs = Command::new("docker").args(["logs", container]).output();
    let logs = logs.unwrap_or_else(|e| panic!("docker does not start: {e}"));
    String::from_utf8_lossy(&[logs.stdout, logs.stderr].concat()).into_owned()
}

impl Drop for Compose {
    fn drop(&mut self) {
        // This code must not panic, because a second panic would abort the test run during the clean-up.
        if std::thread::panicking() {
            let _shown = self
                .command()
                .args(["logs", "--no-color", "--tail", "40"])
                .status();
        }
        let down = self
            .command()
            .args(["down", "--volumes", "--remove-orphans", "--timeout", "5"])
            .output();
        if !down.is_ok_and(|output| output.status.success()) {
            eprintln!(
                "containers test: project {} could not be taken down; see docker ps",
                self.project
            );
        }
        let _absent_if_the_build_failed = Command::new("docker")
            .args(["image", "rm", "--force", &self.image])
            .output();
    }
}

/// Runs a command to its end, and returns its output on stdout. Panics with all its output if it fails or
/// hangs.
pub fn run(command: &mut Command) -> String {
    // Use files instead of pipes, because a pipe would need a reader while this thread watches the time.
    let (out, err) = (
        tempfile::NamedTempFile::new().unwrap(),
        tempfile::NamedTempFile::new().unwrap(),
    );
    let began = Instant::now();
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
        if began.elapsed() > HANGS {
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
        None => panic!("{command:?} was ended, as it had taken {HANGS:?}:\n{out}{err}"),
    }
}

/// Returns true if a command can be started and succeeds.
fn succeeds(words: &[&str]) -> bool {
    Command::new(words[0])
        .args(&words[1..])
        .output()
        .is_ok_and(|output| output.status.success())
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}
