//! Waiting for long work: it runs on another thread, while this one shows its progress and hears of Ctrl-C.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;
use sightline_cli::calls::{CliError, Progress, Watcher};

use crate::errors::{SightlineError, of_command};

/// Time between two looks for signals.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// As large as that of most main threads.
const STACK_BYTES: usize = 8 << 20;

/// The waiting thread, as the working one sees it.
struct Caller<'a> {
    progress: Mutex<Sender<Progress>>,
    stop: &'a AtomicBool,
}

impl Watcher for Caller<'_> {
    fn progress(&self, progress: Progress) {
        // Nobody listens any more only when the work is to stop.
        let _ = self
            .progress
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .send(progress);
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Does `work` without holding the interpreter. `progress` is called on this thread. An exception that it
/// raises, and Ctrl-C, stop the work and are raised when that has ended.
pub fn wait<T: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&dyn Watcher) -> Result<T, CliError> + Send,
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
                    // What came since then is newer.
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
                None => done.map_err(of_command),
            }
        })
    })
}

/// Calls `progress`, and lets the handlers of signals run.
fn show(py: Python<'_>, progress: Option<&Py<PyAny>>, latest: Option<Progress>) -> PyResult<()> {
    py.check_signals()?;
    if let (Some(call), Some(p)) = (progress, latest) {
        call.call1(py, (p.done, p.total, p.what, p.state, p.seconds_left))?;
    }
    Ok(())
}
