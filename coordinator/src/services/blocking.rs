//! Blocking work of the coordinator, outside the async threads.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::Semaphore;
use tonic::Status;

use super::status;
use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::dispatch::follow_ups::Waiting;
use crate::quota::{FairQueue, QueueTurn};

/// Runs `f`, which may block on the disk, on one of tokio's threads for blocking work.
///
/// # Errors
/// The errors of `f`; UNAVAILABLE if the coordinator is stopping, INTERNAL if `f` panicked.
pub(super) async fn blocking<T: Send + 'static>(
    c: &Arc<Coordinator>,
    f: impl FnOnce(&Arc<Coordinator>) -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    let c = Arc::clone(c);
    // Log lines of `f` belong to the span of the call.
    let span = tracing::Span::current();
    tokio::task::spawn_blocking(move || span.in_scope(|| f(&c)))
        .await
        .map_err(|e| match e.is_cancelled() {
            true => Status::unavailable("the coordinator is stopping; try again after its restart"),
            false => status::internal(&format!("a request panicked: {e}")),
        })?
}

/// Runs `f` like [`blocking`], while it holds one of `permits`. The permit is released when `f` has ended,
/// also if the caller no longer waits.
///
/// # Errors
/// As for [`blocking`].
pub(super) async fn blocking_one_of<T: Send + 'static>(
    c: &Arc<Coordinator>,
    permits: &Arc<Semaphore>,
    f: impl FnOnce(&Arc<Coordinator>) -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    let closed =
        |_| Status::unavailable("the coordinator is stopping; try again after its restart");
    let permit = Arc::clone(permits).acquire_owned().await.map_err(closed)?;
    blocking(c, move |c| {
        let _permit = permit;
        f(c)
    })
    .await
}

/// A query whose caller waits. If the call is dropped, the flag is set.
struct OpenQuestion(Arc<AtomicBool>);

impl Drop for OpenQuestion {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Answers a query like [`blocking`], in its user's turn. `answer` polls its second argument from time to
/// time, and stops if it returns true because the caller has gone.
///
/// # Errors
/// As for [`blocking`]; RESOURCE_EXHAUSTED if the user has too many waiting queries.
pub(super) async fn in_turn<T: Send + 'static>(
    c: &Arc<Coordinator>,
    turns: &FairQueue,
    user: &str,
    answer: impl FnOnce(&Arc<Coordinator>, &(dyn Fn() -> bool + Sync)) -> Result<T, Status>
    + Send
    + 'static,
) -> Result<T, Status> {
    let turn = turns.take(user).await.map_err(|beyond| {
        c.telemetry.metrics.refused(beyond.name());
        Status::resource_exhausted(beyond.to_string())
    })?;
    let gone = Arc::new(AtomicBool::new(false));
    let _open = OpenQuestion(Arc::clone(&gone));
    blocking(c, move |c| {
        // The turn ends with the work, even if the caller has gone.
        let _turn = turn;
        answer(c, &|| gone.load(Ordering::Relaxed))
    })
    .await
}

/// Waits for the turn of a user to keep a large upload in memory. Returns `None` at once if `is_large` is
/// false. The user's name is empty for workers.
///
/// # Errors
/// RESOURCE_EXHAUSTED if too many requests wait.
pub(super) async fn large(
    c: &Coordinator,
    user: &str,
    is_large: bool,
) -> Result<Option<QueueTurn>, Status> {
    if !is_large {
        return Ok(None);
    }
    let turn = c.uploads.large.take(user).await;
    turn.map(Some)
        .map_err(|beyond| Status::resource_exhausted(beyond.to_string()))
}

/// Runs follow-ups on one of tokio's threads for blocking work, without waiting for them.
pub(super) fn later(c: &Arc<Coordinator>, follow_ups: FollowUps) {
    if follow_ups.is_empty() {
        return;
    }
    let c = Arc::clone(c);
    match tokio::runtime::Handle::try_current() {
        Ok(runtime) => {
            let waiting = Waiting::new(follow_ups);
            runtime.spawn_blocking(move || waiting.take().run(&c));
        }
        // The runtime ends. The next start of the coordinator derives these follow-ups from the store.
        Err(_) => {
            tracing::debug!(
                "the coordinator stops with {} unfinished follow-ups",
                follow_ups.len()
            );
            follow_ups.discard();
        }
    }
}
