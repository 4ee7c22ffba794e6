//! Changes of the state of a job: in the store, then in the scheduler. The caller runs the follow-ups.

use sightline_records::ids::JobId;
use sightline_records::{JobPhase, JobState};
use sightline_scheduler::Event;
use sightline_store::StoreError;

use crate::dispatch::FollowUps;
use crate::records::JobChanges;
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};

/// Moves a job that is in one of some phases to another state.
pub(crate) fn turned(
    c: &Coordinator,
    id: JobId,
    from: &[JobPhase],
    to: JobState,
) -> Result<FollowUps, StoreError> {
    let mut changes = JobChanges::begin(c);
    let record = changes.set_state(id, from, to)?;
    tracing::info!("job {id} is {}", record.state.phase());
    c.happened(LogEvent::of_job(
        Kind::Job,
        id,
        format!("the job is {}", record.state.phase()),
    ));
    changes.tell(Event::JobChanged(Box::new(record)));
    Ok(changes.finish())
}
