//! The end of a wait for a lost blob (`suspend.rs`): the jobs continue.

use std::sync::{Arc, PoisonError};

use crate::jobs::control;
use crate::state::{Coordinator, MissingBlob};

/// Continues the jobs that have waited for something, which is there again.
pub(crate) fn back(c: &Arc<Coordinator>, lacks: MissingBlob) {
    let _turn = c.lost_turn();
    let mut waiting = Vec::new();
    c.lost
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .retain(|job, of| {
            if *of == lacks {
                waiting.push(*job);
            }
            *of != lacks
        });
    for job in waiting {
        // Somebody may have resumed, cancelled or deleted it.
        if let Err(e) = control::resume(c, job) {
            tracing::info!("job {job} does not go on, though what it lacked is there again: {e}");
        }
    }
}
