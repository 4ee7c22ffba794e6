//! A quarantined worker works again.

use std::sync::Arc;

use sightline_records::ids::worker_name;
use sightline_scheduler::Event;
use sightline_store::StoreError;

use crate::records::JobChanges;
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};

/// Lets quarantined workers work again: the one with this signature, or all with this name. Returns whether
/// any was quarantined.
///
/// # Errors
/// The store's.
pub(crate) fn release(c: &Arc<Coordinator>, worker: &str) -> Result<bool, StoreError> {
    let is_meant = |signature: &str| signature == worker || worker_name(signature) == worker;
    let quarantined = c
        .store
        .quarantined()?
        .into_iter()
        .map(|record| record.worker);
    let mut any = false;
    for signature in quarantined.filter(|signature| is_meant(signature)) {
        let mut changes = JobChanges::begin(c);
        let was_quarantined = changes.release(&signature);
        if let Ok(true) = was_quarantined {
            changes.tell(Event::Released(signature.clone()));
        }
        changes.finish().run(c);
        if was_quarantined? {
            let text = format!("worker {signature} may work again");
            tracing::warn!("{text}");
            c.happened(LogEvent::of(Kind::Worker, text).on(&signature));
            any = true;
        }
    }
    Ok(any)
}
