//! System calls of a process under test, as `strace` records them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::{in_ci, wait_for};

/// The calls by which files are created, synced, renamed and removed.
pub const FILE_CALLS: &str = "openat,open,creat,fsync,fdatasync,sync_file_range,rename,renameat,\
                              renameat2,link,linkat,unlink,unlinkat,mkdir,mkdirat";

/// A recording of system calls. `strace` runs as a grandchild, so that the traced process is the direct child
/// of the test, with its own id, signals and exit code.
pub struct Strace {
    log: PathBuf,
}

/// A system call that has returned.
#[derive(Clone, Debug)]
pub struct SystemCall {
    /// The number of the log line at which the call started. The lines of all threads are in the order of
    /// time.
    pub begun: usize,
    /// The number of the log line at which the call returned.
    pub returned: usize,
    /// The name of the call.
    pub name: String,
    /// The arguments and the result as `strace -y` writes them: descriptors with their paths, such as
    /// `3</tmp/data>`.
    pub text: String,
}

impl SystemCall {
    /// Returns true if the call succeeded.
    pub fn succeeded(&self) -> bool {
        !self
            .text
            .rsplit(" = ")
            .next()
            .unwrap_or_default()
            .starts_with('-')
    }
}

impl Strace {
    /// Prepares a recording in the file `log`. If `strace` cannot run, prints the reason in one line and
    /// returns `None`, which is a failure on CI.
    pub fn new(log: &Path) -> Option<Self> {
        let strace = Self {
            log: log.to_owned(),
        };
        let ran = strace
            .command(Path::new("true"), "fsync")
            .stderr(Stdio::piped())
            .output();
        let reason = match ran {
            Ok(ran) if ran.status.success() && ran.stderr.is_empty() => {
                drop(strace.calls());
                return Some(strace);
            }
            Ok(ran) => String::from_utf8_lossy(&ran.stderr)
                .trim()
                .replace('\n', "; "),
            Err(e) => e.to_string(),
        };
        assert!(
            !in_ci(),
            "strace has to run in continuous integration: {reason}"
        );
        eprintln!("not run: the order of system calls (strace cannot run: {reason})");
        None
    }

    /// Returns a command that runs `program` and records `calls`, a list that `strace -e trace=` accepts.
    pub fn command(&self, program: &Path, calls: &str) -> Command {
        let mut command = Command::new("strace");
        // -D: the tracer is not a child of the test; -y: descriptors with paths; -s: complete strings.
        command
            .args(["-D", "-f", "-q", "-y", "-s", "4096", "-o"])
            .arg(&self.log);
        command
            .arg("-e")
            .arg(format!("trace={calls}"))
            .arg("--")
            .arg(program);
        command
    }

    /// Waits for the end of the process. Returns its calls in the order in which they returned.
    pub fn calls(&self) -> Vec<SystemCall> {
        // The tracer writes the last lines after the process has ended.
        let log = wait_for("the end of the recording", || {
            let log = fs::read_to_string(&self.log).ok()?;
            let first = log.split_whitespace().next()?.to_owned();
            let ended = |l: &str| {
                l.split_once(' ')
                    .is_some_and(|(id, rest)| id == first && rest.trim_start().starts_with("+++ "))
            };
            log.lines().any(ended).then_some(log)
        });
        parse(&log)
    }
}

fn parse(log: &str) -> Vec<SystemCall> {
    let mut pending: Vec<(&str, usize, &str)> = Vec::new();
    let mut calls = Vec::new();
    for (number, line) in log.lines().enumerate() {
        let Some((thread, rest)) = line.split_once(' ') else {
            continue;
        };
        let rest = rest.trim_start();
        let (begun, text) = if let Some(begin) = rest.strip_suffix("<unfinished ...>") {
            pending.push((thread, number, begin));
            continue;
        } else if let Some(resumed) = rest.strip_prefix("<... ") {
            let at = pending.iter().position(|(owner, ..)| *owner == thread);
            let Some((_, begun, begin)) = at.map(|at| pending.remove(at)) else {
                continue;
            };
            let end = resumed.split_once(" resumed>").map_or("", |(_, end)| end);
            (begun, format!("{begin}{end}"))
        } else {
            (number, rest.to_owned())
        };
        // Skip the lines about signals and ends.
        let Some((name, text)) = text.split_once('(') else {
            continue;
        };
        if name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            calls.push(SystemCall {
                begun,
                returned: number,
                name: name.to_owned(),
                text: text.to_owned(),
            });
        }
    }
    calls
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interrupted_calls_are_joined() {
        let log = "7 fsync(3</a> <unfinished ...>\n\
                   8 rename(\"/b\", \"/c\") = -1 ENOENT (No such file)\n\
                   7 <... fsync resumed>) = 0\n7 --- SIGCHLD {si_signo=SIGCHLD} ---\n\
                   7 +++ exited with 0 +++\n";
        let calls = parse(log);
        assert_eq!(calls.len(), 2, "{calls:?}");
        assert_eq!(
            (calls[0].name.as_str(), calls[0].succeeded()),
            ("rename", false)
        );
        assert_eq!(
            (calls[1].begun, calls[1].returned, calls[1].succeeded()),
            (0, 2, true)
        );
        assert_eq!(calls[1].text, "3</a> ) = 0");
    }
}
