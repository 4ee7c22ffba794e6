//! A quarantined worker works again.

use std::sync::Arc;

use crate::chores::happened;
use crate::chronicle::{Happening, Kind};
use crate::scheduler::Event;
use crate::state::Coordinator;
use crate::store::StoreError;

/// Lets a quarantined worker work again; returns whether it was quarantined.
pub(crate) fn release(c: &Arc<Coordinator>, worker: &str) -> Result<bool, StoreError> {
    let was = c.store.release(worker)?;
    if was {
        let text = format!("worker {worker} may work again");
        tracing::warn!("{text}");
        c.happened(Happening::of(Kind::Worker, text).on(worker));
        happened(c, Event::Released(worker.to_owned()));
    }
    Ok(was)
}
