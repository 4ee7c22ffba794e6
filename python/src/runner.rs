//! The runner of long work: another thread works, while the calling thread shows the progress and handles
//! Ctrl-C.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;
use sightline::{Error, Note, Observer, Progress};

use crate::errors::{SightlineError, from_library};

/// The time between two checks for signals.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// The stack size of the working thread in bytes, which equals the stack size of most main threads.
const STACK_BYTES: usize = 8 << 20;

/// The progress that Python receives: done, total, noun, state, remaining seconds.
type ProgressTuple = (u64, u64, &'static str, &'static str, Option<f64>);

/// The handle by which the working thread reports to the waiting thread.
struct Caller<'a> {
    progress: Mutex<Sender<ProgressTuple>>,
    stop: &'a AtomicBool,
}

impl Observer for Caller<'_> {
    fn progress(&self, progress: &Progress<'_>) {
        let shown = (
            progress.done,
            progress.total,
            progress.what,
            progress.state(),
            progress.seconds_left(),
        );
        let sender = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        // The receiver is dropped only if the work should stop.
        let _ = sender.send(shown);
    }

    fn note(&self, note: &Note) {
        // The call fails if the interpreter is ending, or if a handler has raised an error.
        let _ = Python::try_attach(|py| log(py, note));
    }

    fn is_cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Runs `work` on another thread, without the interpreter lock. This thread calls `progress`. An exception in
/// `progress`, or Ctrl-C, stops the work, and is raised after the work has ended.
pub fn wait<T: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&dyn Observer) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let stop = &AtomicBool::new(false);
    let (sender, told) = channel();
    py.detach(move || {
        std::thread::scope(|scope| {
            let caller = Caller {
                progress: Mutex::new(sender),
                stop,
            };
            let builder = std::thread::Builder::new()
                .name("sightline".to_owned())
                .stack_size(STACK_BYTES);
            let worker = builder
                .spawn_scoped(scope, move || work(&caller))
                .map_err(|e| SightlineError::new_err(format!("no thread can be started: {e}")))?;
            let mut raised = None;
            loop {
                let latest = match told.recv_timeout(LOOK_EVERY) {
                    // Only the newest progress counts.
                    Ok(first) => Some(told.try_iter().last().unwrap_or(first)),
                    Err(RecvTimeoutError::Timeout) => None,
                    Err(RecvTimeoutError::Disconnected) => break,
                };
                if raised.is_none() {
                    raised = Python::attach(|py| show(py, progress, latest)).err();
                    stop.store(raised.is_some(), Ordering::Relaxed);
                }
            }
            let done = worker
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            match raised {
                Some(e) => Err(e),
                None => done.map_err(from_library),
            }
        })
    })
}

/// Calls `progress`, and runs the handlers of signals.
fn show(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    latest: Option<ProgressTuple>,
) -> PyResult<()> {
    py.check_signals()?;
    if let (Some(call), Some(shown)) = (progress, latest) {
        call.call1(py, shown)?;
    }
    Ok(())
}

/// Passes a note to Python's logger "sightline".
fn log(py: Python<'_>, note: &Note) -> PyResult<()> {
    let logger = py
        .import("logging")?
        .call_method1("getLogger", ("sightline",))?;
    let level = if note.is_warning { "warning" } else { "info" };
    logger.call_method1(level, ("%s", &note.text)).map(drop)
}
