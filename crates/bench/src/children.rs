//! Runs of this program as a child process. A benchmark times whole commands, and a fresh process has a
//! separate peak memory.

use std::ffi::OsStr;
use std::io::Read as _;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

use serde_json::Value;

use crate::error::BenchError;
use crate::host::Host;
use crate::load::Ticks;
use crate::timing::RunCost;

/// An event that wakes the waiting thread.
enum Event {
    /// The child closed its stdout, after it wrote these bytes.
    Said(Vec<u8>),
    /// The user stopped the program with Ctrl-C or SIGTERM.
    Stop,
}

/// A runner of child processes, one at a time.
pub struct Children {
    program: PathBuf,
    events: Receiver<Event>,
    sender: Sender<Event>,
}

impl Children {
    /// Creates a runner of the host's program. A stop of the host ends the running child, and the next `run`
    /// reports the stop.
    pub fn new(host: &Host<'_>) -> Self {
        let (sender, events) = channel();
        let stop = sender.clone();
        (host.on_stop)(Box::new(move || {
            // The send fails only if the command is ending anyway.
            let _ = stop.send(Event::Stop);
        }));
        Self {
            program: host.program.clone(),
            events,
            sender,
        }
    }

    /// Runs `sightline --json ARGUMENTS…`. Returns the JSON that the child printed, and the cost of the child
    /// from start to exit.
    pub fn run<I: IntoIterator<Item: AsRef<OsStr>>>(
        &self,
        arguments: I,
    ) -> Result<(Value, RunCost), BenchError> {
        if self.events.try_recv().is_ok() {
            return Err(interrupted());
        }
        let mut command = Command::new(&self.program);
        command.arg("--json").args(arguments);
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let before = Ticks::now();
        let start = Instant::now();
        let mut child = command.spawn().map_err(|e| {
            BenchError::Internal(format!("{} cannot be started: {e}", self.program.display()))
        })?;
        let complaints = self.listen(&mut child);
        let event = self.events.recv();
        if !matches!(event, Ok(Event::Said(_))) {
            // The kill fails only if the child has ended already.
            let _ = child.kill();
        }
        let status = child.wait().map_err(BenchError::internal)?;
        let wall = start.elapsed().as_secs_f64();
        let load = Ticks::now()
            .zip(before)
            .map(|(now, before)| now.since(before));
        let Ok(Event::Said(said)) = event else {
            return Err(interrupted());
        };
        if !status.success() {
            let complaints = complaints.and_then(|c| c.join().ok()).unwrap_or_default();
            return Err(failure(
                status.code(),
                &String::from_utf8_lossy(&complaints),
                &command,
            ));
        }
        let value: Value = serde_json::from_slice(&said).map_err(|e| {
            BenchError::Internal(format!("{} printed no JSON: {e}", shown(&command)))
        })?;
        let cpu = value["cpu_seconds"].as_f64();
        Ok((value, RunCost { wall, cpu, load }))
    }

    /// Reads the output of the child, with a thread per stream. Otherwise one pipe could fill up and block
    /// the child while this process waits for the other pipe. Returns the thread that reads stderr.
    fn listen(&self, child: &mut Child) -> Option<std::thread::JoinHandle<Vec<u8>>> {
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let sender = self.sender.clone();
        std::thread::spawn(move || {
            let mut said = Vec::new();
            // A broken pipe ends the output, and the JSON parser then reports that the output is truncated.
            let _ = stdout.map(|mut s| s.read_to_end(&mut said));
            let _ = sender.send(Event::Said(said));
        });
        stderr.map(|mut stderr| {
            std::thread::spawn(move || {
                let mut said = Vec::new();
                let _ = stderr.read_to_end(&mut said);
                said
            })
        })
    }
}

fn interrupted() -> BenchError {
    BenchError::Interrupted(
        "interrupted; the files contain the completed measurements; use --samplers and --points \
         for a shorter run"
            .into(),
    )
}

/// Returns the error of a failed child: the child's message, as the variant that belongs to the child's exit
/// code.
fn failure(code: Option<i32>, complaints: &str, command: &Command) -> BenchError {
    let last = complaints
        .lines()
        .rev()
        .find_map(|l| l.strip_prefix("error: "));
    let why = format!("{}: {}", shown(command), last.unwrap_or(complaints.trim()));
    match code {
        Some(2) => BenchError::Usage(why),
        Some(3) => BenchError::Input(why),
        Some(4) => BenchError::Coordinator(why),
        Some(5) => BenchError::Job(why),
        // At a terminal, Ctrl-C reaches the child as well, and the child may receive it first.
        Some(130) => interrupted(),
        Some(_) => BenchError::Internal(why),
        None => BenchError::Internal(format!(
            "{} was killed by a signal; check that the machine has enough memory",
            shown(command)
        )),
    }
}

fn shown(command: &Command) -> String {
    let words = command
        .get_args()
        .map(|a| a.to_string_lossy())
        .collect::<Vec<_>>();
    format!("sightline {}", words.join(" "))
}

/// Returns a number of a child's JSON.
pub fn number(value: &Value, key: &str) -> Result<f64, BenchError> {
    value[key].as_f64().ok_or_else(|| {
        BenchError::Internal(format!(
            "the JSON output of the bake or measurement has no number {key:?}"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failure_keeps_kind_and_message_of_child() {
        let command = Command::new("sightline");
        let e = failure(Some(3), "noise\nerror: a.glb: not there\n", &command);
        assert!(
            matches!(&e, BenchError::Input(m) if m.ends_with("a.glb: not there")),
            "{e}"
        );
        assert!(matches!(
            failure(Some(130), "", &command),
            BenchError::Interrupted(_)
        ));
        assert!(matches!(
            failure(None, "", &command),
            BenchError::Internal(_)
        ));
    }
}
