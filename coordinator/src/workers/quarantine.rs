//! The release of workers from quarantine.

use std::sync::Arc;

use sightline_records::ids::worker_name;
use sightline_scheduler::Event;
use sightline_store::StoreError;

use crate::coordinator::Coordinator;
use crate::records::JobChanges;
use crate::telemetry::events::{EventKind, LogEvent};

/// Releases quarantined workers: the worker with this signature, or all workers with this name. Returns true
/// if at least one was quarantined.
///
/// # Errors
/// [`StoreError`] if the store fails.
pub(crate) fn release(c: &Arc<Coordinator>, worker: &str) -> Result<bool, StoreError> {
    let is_meant = |signature: &str| signature == worker || worker_name(signature) == worker;
    let quarantined = c
        .records
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
            c.record_event(LogEvent::new(EventKind::Worker, text).on(&signature));
            any = true;
        }
    }
    Ok(any)
}
