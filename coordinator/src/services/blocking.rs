//! Runs the coordinator's blocking work off the async threads.

use std::sync::Arc;

use tonic::Status;

use super::status;
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
    tokio::task::spawn_blocking(move || f(&c)).await.map_err(|e| match e.is_cancelled() {
        true => Status::unavailable("the coordinator is stopping; try again when it is back"),
        false => status::internal(&format!("a request panicked: {e}")),
    })?
}
