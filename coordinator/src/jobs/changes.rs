//! Changes of the state of a job: in the store, then in the scheduler. The caller runs the follow-ups.

use sightline_records::ids::JobId;
use sightline_records::{JobPhase, JobState};
use sightline_scheduler::Event;
use sightline_store::StoreError;

use crate::dispatch::{FollowUps, tell};
use crate::jobs::retention_stamp;
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};

/// Moves a job that is in one of some phases to another state.
pub(crate) fn turned(
    c: &Coordinator,
    id: JobId,
    from: &[JobPhase],
    to: JobState,
) -> Result<FollowUps, StoreError> {
    let _turn = c.turn();
    let record = c
        .store
        .set_job_state(id, from, to, retention_stamp::end_time(c))?;
    tracing::info!("job {id} is {}", record.state.phase());
    c.happened(LogEvent::of_job(
        Kind::Job,
        id,
        format!("the job is {}", record.state.phase()),
    ));
    Ok(tell(c, Event::JobChanged(Box::new(record))))
}
