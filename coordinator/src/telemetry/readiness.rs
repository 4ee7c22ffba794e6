//! Whether new work is welcome: liveness says that the process runs, readiness that it can do its work.
//!
//! Not ready is a coordinator whose store or blobs cannot be written, whose disk is full, or that has paused
//! leasing because of such a fault.

use std::sync::PoisonError;
use std::time::{Duration, Instant};

use crate::kept::NotReady;
use crate::state::Coordinator;
use crate::telemetry::metrics::free_bytes;

/// Least free space, in bytes.
const LEAST_FREE: u64 = 64 << 20;
/// How long the outcome of a trial counts.
const EVERY: Duration = Duration::from_secs(10);

/// Whether the coordinator is ready; the error has every reason why it is not. Writes a small blob, once
/// every few seconds at most. Blocks on the disk.
///
/// # Errors
/// The reasons, a sentence each.
pub(crate) fn readiness(c: &Coordinator) -> Result<(), NotReady> {
    let mut last = c.last_trial.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((at, outcome)) = &*last
        && at.elapsed() < EVERY
    {
        return outcome.clone();
    }
    let outcome = try_all(c);
    *last = Some((Instant::now(), outcome.clone()));
    outcome
}

fn try_all(c: &Coordinator) -> Result<(), NotReady> {
    let mut reasons = NotReady::new();
    if let Some(free) = c.data_dir.as_deref().and_then(free_bytes)
        && free < LEAST_FREE
    {
        reasons.push(format!(
            "the disk has {} MiB left; free some, or add a larger one",
            free >> 20
        ));
    }
    let mut random = [0; 16];
    let random = getrandom::fill(&mut random)
        .map(|()| random)
        .map_err(|e| e.to_string());
    let written = random.and_then(|random| {
        let digest = c.blobs.put_unsynced(&random).map_err(|e| e.to_string())?;
        c.blobs.remove(&digest).map_err(|e| e.to_string())
    });
    if let Err(e) = written {
        reasons.push(format!("blobs cannot be written: {e}"));
    }
    if let Err(e) = c.store.may_change() {
        reasons.push(format!("the store cannot be written: {e}"));
    }
    if c.lock().scheduler.is_paused() {
        reasons.push(
            "no tiles are granted for a while, because the store could not be written".to_owned(),
        );
    }
    if reasons.is_empty() {
        Ok(())
    } else {
        Err(reasons)
    }
}
