//! The readiness of the coordinator for new work. Liveness states that the process runs, readiness that the
//! process can do its work.
//!
//! A coordinator is not ready if its store or its blobs cannot be written, if its disk is full, or if it has
//! paused leasing because of such a fault.

use std::sync::PoisonError;
use std::time::{Duration, Instant};

use crate::coordinator::Coordinator;
use crate::telemetry::metrics::free_bytes;
use crate::telemetry::state::NotReady;

/// Minimum free space on the disk, in bytes.
const LEAST_FREE: u64 = 64 << 20;
/// The time for which the outcome of a write test is valid.
const EVERY: Duration = Duration::from_secs(10);

/// Checks that the coordinator is ready. Writes a small blob at most once every few seconds, so it blocks on
/// the disk.
///
/// # Errors
/// The reasons why the coordinator is not ready, one sentence each.
pub(crate) fn readiness(c: &Coordinator) -> Result<(), NotReady> {
    let mut last = c
        .telemetry
        .last_test
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
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
    if let Some(free) = c.config.data_dir.as_deref().and_then(free_bytes)
        && free < LEAST_FREE
    {
        reasons.push(format!(
            "the disk has {} MiB left; free some space, or use a larger disk",
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
    if let Err(e) = c.records.may_change() {
        reasons.push(format!("the store cannot be written: {e}"));
    }
    if c.dispatcher.read(|scheduler| scheduler.is_paused()) {
        reasons.push(
            "no tiles are granted for 10 s, because the store or the blobs could not be written"
                .to_owned(),
        );
    }
    if reasons.is_empty() {
        Ok(())
    } else {
        Err(reasons)
    }
}
