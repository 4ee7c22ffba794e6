//! The program under test as a process: run to its end, in the background, or as a coordinator.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use serde_json::Value;
use tempfile::TempDir;

use crate::{Dump, LIMIT, program, wait_for};

/// A separate folder in which commands run. Dropping it removes the folder.
pub struct Sandbox {
    folder: TempDir,
    variables: Vec<(OsString, OsString)>,
    descriptors: Option<u32>,
    runs: AtomicU32,
}

impl Default for Sandbox {
    fn default() -> Self {
        Self::new()
    }
}

impl Sandbox {
    /// Creates an empty folder.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        // Keep the user's cache out of the tests, and the tests out of the user's cache.
        let cache = folder.path().join("cache").into();
        let variables = vec![("XDG_CACHE_HOME".into(), cache)];
        Self {
            folder,
            variables,
            descriptors: None,
            runs: AtomicU32::new(0),
        }
    }

    /// Sets an environment variable for all later commands.
    pub fn set(&mut self, name: &str, value: impl Into<OsString>) {
        self.variables.push((name.into(), value.into()));
    }

    /// Limits the number of file descriptors of all later commands.
    pub fn limit_descriptors(&mut self, most: u32) {
        self.descriptors = Some(most);
    }

    /// Returns the path of a file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns the bytes of a file in the folder.
    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Writes a file in the folder.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path(name), bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
    }

    /// Returns the number of files below `name`, or 0 if `name` does not exist.
    pub fn files_below(&self, name: &str) -> usize {
        fn count(folder: &Path) -> usize {
            let Ok(entries) = fs::read_dir(folder) else {
                return 0;
            };
            // Files that disappear during the count do not count.
            entries
                .flatten()
                .map(|e| {
                    if e.path().is_dir() {
                        count(&e.path())
                    } else {
                        1
                    }
                })
                .sum()
        }
        count(&self.path(name))
    }

    fn command(&self, program: &Path, line: &str) -> Command {
        let mut command = match self.descriptors {
            None => Command::new(program),
            Some(most) => {
                // Use the `ulimit` of the shell, which sets the soft and the hard limit.
                let mut command = Command::new("sh");
                command
                    .args(["-c", &format!("ulimit -n {most} && exec \"$0\" \"$@\"")])
                    .arg(program);
                command
            }
        };
        command
            .args(line.split_whitespace())
            .current_dir(self.folder.path())
            .env_remove("SIGHTLINE_LOG")
            .envs(self.variables.iter().map(|(k, v)| (k, v)))
            .stdin(Stdio::null());
        command
    }

    /// Starts `sightline LINE` in the folder. The line is split at spaces, and files are relative to the
    /// folder.
    pub fn start(&self, line: &str) -> Background {
        self.background(self.command(program(), line), line)
    }

    /// Runs `sightline LINE` to its end, under limits that a shell sets, such as `ulimit -n 20`.
    pub fn run_limited(&self, limits: &str, line: &str) -> Run {
        let mut command = self.command(Path::new("sh"), "");
        command
            .arg("-c")
            .arg(format!("{limits} && exec \"$0\" {line}"))
            .arg(program());
        self.background(command, &format!("{line} after {limits}"))
            .end()
    }

    fn background(&self, mut command: Command, line: &str) -> Background {
        let number = self.runs.fetch_add(1, Ordering::Relaxed);
        let [out, err] = ["out", "err"].map(|kind| self.path(&format!(".{number}.{kind}")));
        // Use files instead of pipes, so that no thread has to read.
        command
            .stdout(File::create(&out).unwrap())
            .stderr(File::create(&err).unwrap());
        let child = command
            .spawn()
            .unwrap_or_else(|e| panic!("sightline {line} does not start: {e}"));
        Background {
            line: line.to_owned(),
            child,
            out,
            err,
        }
    }

    /// Runs `sightline LINE` to its end. A panic in it is a failure for any exit code.
    pub fn run(&self, line: &str) -> Run {
        self.start(line).end()
    }

    /// Runs `sightline LINE`, which must succeed. Returns its output on stdout.
    pub fn ok(&self, line: &str) -> String {
        self.run(line).code(0).out
    }

    /// Runs `sightline LINE --json`, which must succeed. Returns the document on stdout.
    pub fn json(&self, line: &str) -> Value {
        let out = self.ok(&format!("{line} --json"));
        serde_json::from_str(&out).unwrap_or_else(|e| panic!("sightline {line}: {e} in {out}"))
    }

    /// Returns the dump of a result.
    pub fn dump(&self, result: &str) -> Dump {
        Dump::parse(&self.ok(&format!("dump {result}")))
    }

    /// Starts a coordinator on a free port, or at the given address, with its data in `data`.
    pub fn coordinator(&self, data: &str, address: &str) -> Coordinator<'_> {
        self.serve(data, &format!("--listen {address}"))
    }

    /// Starts a coordinator with a dashboard on free ports.
    pub fn coordinator_with_pages(&self, data: &str) -> Coordinator<'_> {
        self.serve(data, "--listen 127.0.0.1:0 --http 127.0.0.1:0")
    }

    /// Starts a coordinator with these arguments, which include `--listen`, and with its data in `data`.
    pub fn serve(&self, data: &str, arguments: &str) -> Coordinator<'_> {
        let mut command = self.command(
            program(),
            &format!("coordinator {arguments} --data-dir {data}"),
        );
        let log = self.path(&format!(
            ".{data}.{}.log",
            self.runs.fetch_add(1, Ordering::Relaxed)
        ));
        command
            .stdout(Stdio::piped())
            .stderr(File::create(&log).unwrap());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut line = || lines.next().map(Result::unwrap).unwrap_or_default();
        let first = line();
        let second = if arguments.contains("--http") {
            line()
        } else {
            String::new()
        };
        let third = if arguments.contains("--metrics-listen") {
            line()
        } else {
            String::new()
        };
        let coordinator = Coordinator {
            sandbox: self,
            process: Background {
                line: "coordinator".into(),
                child,
                out: PathBuf::new(),
                err: log,
            },
            url: first
                .trim()
                .strip_prefix("listening on ")
                .unwrap_or_default()
                .to_owned(),
            pages: second
                .trim()
                .strip_prefix("dashboard on ")
                .unwrap_or_default()
                .to_owned(),
            metrics: third
                .trim()
                .strip_prefix("metrics on ")
                .unwrap_or_default()
                .to_owned(),
        };
        assert!(
            coordinator.url.starts_with("http"),
            "the coordinator said {first:?}:\n{}",
            coordinator.process.err()
        );
        coordinator
    }
}

/// The outcome of a command.
pub struct Run {
    line: String,
    status: ExitStatus,
    /// The output on stdout.
    pub out: String,
    /// The output on stderr.
    pub err: String,
}

impl Run {
    /// Panics unless the exit code is `code`.
    #[track_caller]
    pub fn code(self, code: i32) -> Self {
        assert!(
            self.status.code() == Some(code),
            "sightline {} ended with {}, not {code}:\n{}{}",
            self.line,
            self.status,
            self.out,
            self.err
        );
        self
    }

    /// Returns true if the command succeeded.
    pub fn succeeded(&self) -> bool {
        self.status.success()
    }

    /// Panics unless stderr contains `text`.
    #[track_caller]
    pub fn says(self, text: &str) -> Self {
        assert!(
            self.err.contains(text),
            "sightline {} does not say '{text}':\n{}",
            self.line,
            self.err
        );
        self
    }
}

/// A process in the background. Dropping it kills the process.
pub struct Background {
    line: String,
    child: Child,
    out: PathBuf,
    err: PathBuf,
}

impl Background {
    /// Returns the output on stderr so far.
    pub fn err(&self) -> String {
        String::from_utf8_lossy(&fs::read(&self.err).unwrap_or_default()).into_owned()
    }

    /// Returns the output on stdout so far.
    pub fn out(&self) -> String {
        String::from_utf8_lossy(&fs::read(&self.out).unwrap_or_default()).into_owned()
    }

    /// Returns the id of the process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Returns true if the process is running.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Sends the process a signal by its name, such as `TERM`.
    pub fn signal(&self, name: &str) {
        // Use the `kill` of the shell, which exists on every machine.
        let sent = Command::new("sh")
            .args(["-c", &format!("kill -{name} {}", self.child.id())])
            .status();
        assert!(
            sent.unwrap().success(),
            "SIG{name} could not be sent to sightline {}",
            self.line
        );
    }

    /// Kills the process, like a crash or a power failure.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Waits for the end of the process.
    pub fn end(mut self) -> Run {
        let began = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(
                began.elapsed() < LIMIT,
                "sightline {} hangs:\n{}",
                self.line,
                self.err()
            );
            std::thread::sleep(std::time::Duration::from_millis(2));
        };
        let run = Run {
            line: self.line.clone(),
            status,
            out: self.out(),
            err: self.err(),
        };
        assert!(
            !run.err.contains("panicked"),
            "sightline {} panicked:\n{}",
            run.line,
            run.err
        );
        run
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // The process may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            eprintln!("---- stderr of sightline {}\n{}", self.line, self.err());
        }
    }
}

/// A running coordinator.
pub struct Coordinator<'a> {
    sandbox: &'a Sandbox,
    /// The process of the coordinator.
    pub process: Background,
    /// The address for gRPC, such as `http://127.0.0.1:41234`.
    pub url: String,
    /// The address of the dashboard, such as `http://127.0.0.1:41235/`. Empty without a dashboard.
    pub pages: String,
    /// The address of the metrics, such as `http://127.0.0.1:41236/metrics`. Empty without metrics.
    pub metrics: String,
}

impl Coordinator<'_> {
    /// Returns only the address and the port, for `--listen`.
    pub fn address(&self) -> String {
        self.url.rsplit('/').next().unwrap_or_default().to_owned()
    }

    /// Starts a client command against the coordinator.
    pub fn start(&self, line: &str) -> Background {
        self.sandbox
            .start(&format!("{line} --coordinator {}", self.url))
    }

    /// Runs a client command against the coordinator.
    pub fn run(&self, line: &str) -> Run {
        self.start(line).end()
    }

    /// Runs a client command against the coordinator, which must succeed. Returns its output on stdout.
    pub fn ok(&self, line: &str) -> String {
        self.run(line).code(0).out
    }

    /// Runs a client command with `--json` against the coordinator. Returns the document.
    pub fn json(&self, line: &str) -> Value {
        self.sandbox
            .json(&format!("{line} --coordinator {}", self.url))
    }

    /// Starts a worker with one thread on the cpu backend.
    pub fn worker(&self) -> Background {
        self.start("worker --backend cpu --threads 1")
    }

    /// Submits a job. Returns its number.
    pub fn submit(&self, line: &str) -> u64 {
        self.ok(&format!("submit {line}")).trim().parse().unwrap()
    }

    /// Returns a count of a job from `show --json`.
    pub fn count(&self, job: u64, key: &str) -> u64 {
        count(&self.json(&format!("show {job}")), key)
    }

    /// Waits until `seen` accepts the document of `show --json` for a job. Returns the document.
    pub fn until(&self, job: u64, what: &str, seen: impl Fn(&Value) -> bool) -> Value {
        wait_for(what, || {
            Some(self.json(&format!("show {job}"))).filter(&seen)
        })
    }

    /// Follows a job to its end, which must be a success. Returns the bytes of its result.
    pub fn finish(&self, job: u64) -> Vec<u8> {
        self.ok(&format!("watch {job}"));
        let name = format!("fetched-{job}.pvs");
        self.ok(&format!("fetch {job} -o {name}"));
        self.sandbox.read(&name)
    }
}

/// Returns a number in a JSON object.
pub(crate) fn count(value: &Value, key: &str) -> u64 {
    value[key]
        .as_u64()
        .unwrap_or_else(|| panic!("no count '{key}' in {value}"))
}
