//! Runs the coordinator's blocking work off the async threads.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::Semaphore;
use tonic::Status;

use super::status;
use crate::dispatch::FollowUps;
use crate::dispatch::follow_ups::Waiting;
use crate::quota::{Turn, Turns};
use crate::state::Coordinator;

/// Runs `f`, which may block on the disk, on one of tokio's threads for blocking work.
///
/// # Errors
/// Those of `f`; UNAVAILABLE when the coordinator is stopping, INTERNAL when `f` panicked.
pub(super) async fn blocking<T: Send + 'static>(
    c: &Arc<Coordinator>,
    f: impl FnOnce(&Arc<Coordinator>) -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    let c = Arc::clone(c);
    // What it logs belongs to the call.
    let span = tracing::Span::current();
    tokio::task::spawn_blocking(move || span.in_scope(|| f(&c)))
        .await
        .map_err(|e| match e.is_cancelled() {
            true => Status::unavailable("the coordinator is stopping; try again when it is back"),
            false => status::internal(&format!("a request panicked: {e}")),
        })?
}

/// As [`blocking`], with one of few permits, which is held until `f` has ended, whether anybody waits for it
/// or not.
///
/// # Errors
/// As [`blocking`].
pub(super) async fn blocking_one_of<T: Send + 'static>(
    c: &Arc<Coordinator>,
    permits: &Arc<Semaphore>,
    f: impl FnOnce(&Arc<Coordinator>) -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    let closed = |_| Status::unavailable("the coordinator is stopping; try again when it is back");
    let permit = Arc::clone(permits).acquire_owned().await.map_err(closed)?;
    blocking(c, move |c| {
        let _permit = permit;
        f(c)
    })
    .await
}

/// A question whose asker waits. When the call is dropped, the flag is set.
struct OpenQuestion(Arc<AtomicBool>);

impl Drop for OpenQuestion {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Answers a question in its user's turn, as [`blocking`] does. `answer` looks at its second argument from
/// time to time and stops when that is true: the asker has gone.
///
/// # Errors
/// As [`blocking`]; RESOURCE_EXHAUSTED when the user has too many questions that wait.
pub(super) async fn in_turn<T: Send + 'static>(
    c: &Arc<Coordinator>,
    turns: &Turns,
    user: &str,
    answer: impl FnOnce(&Arc<Coordinator>, &(dyn Fn() -> bool + Sync)) -> Result<T, Status>
    + Send
    + 'static,
) -> Result<T, Status> {
    let turn = turns.take(user).await.map_err(|beyond| {
        c.metrics.refused(beyond.name());
        Status::resource_exhausted(beyond.to_string())
    })?;
    let gone = Arc::new(AtomicBool::new(false));
    let _open = OpenQuestion(Arc::clone(&gone));
    blocking(c, move |c| {
        // The turn ends with the work, also when the caller has gone.
        let _turn = turn;
        answer(c, &|| gone.load(Ordering::Relaxed))
    })
    .await
}

/// Waits for the turn of a user to hold a large upload in memory, if it `is` large. The name is empty for
/// workers.
///
/// # Errors
/// RESOURCE_EXHAUSTED when too many requests wait.
pub(super) async fn large(c: &Coordinator, user: &str, is: bool) -> Result<Option<Turn>, Status> {
    if !is {
        return Ok(None);
    }
    let turn = c.large.take(user).await;
    turn.map(Some)
        .map_err(|beyond| Status::resource_exhausted(beyond.to_string()))
}

/// Runs follow-ups on one of tokio's threads for blocking work; the caller does not wait for them.
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
        // The runtime ends. The next start derives the tasks that did not begin from the store.
        Err(_) => {
            tracing::debug!(
                "the coordinator stops with {} follow-ups open",
                follow_ups.len()
            );
            follow_ups.discard();
        }
    }
}
