//! A job as clients see it: derived from its record and the states of its tiles, never kept.

use prost::Message as _;
use sightline_model::JobSpec;
use sightline_proto::v1;

use crate::core::Coordinator;
use crate::scheduler::{Slot, cells_total};
use crate::store::{JobRecord, JobState, StoreError, TileState};

impl Coordinator {
    /// The job as a message.
    pub(crate) fn summary(&self, id: u64) -> Result<v1::Job, StoreError> {
        let scheduler = self.lock();
        let workers = scheduler.workers.len() as u32;
        if let Some(job) = scheduler.jobs.get(&id) {
            return Ok(message(&job.record, &job.slots, cells_total(&job.spec, &job.plan), workers));
        }
        drop(scheduler);
        let record = self.store.job(id)?.ok_or(StoreError::UnknownJob { job: id })?;
        let slots: Vec<Slot> = self.store.tiles(id)?.into_iter().map(|t| Slot::new(t.state)).collect();
        // A specification of another version cannot be planned; its cells are then not known.
        let total = v1::JobSpec::decode(record.spec.as_slice())
            .ok()
            .and_then(|m| JobSpec::from_proto(&m, None).ok())
            .and_then(|s| s.plan().ok().map(|(_, plan)| cells_total(&s, &plan)))
            .unwrap_or(0);
        Ok(message(&record, &slots, total, workers))
    }
}

fn message(record: &JobRecord, slots: &[Slot], cells_total: u64, workers: u32) -> v1::Job {
    let mut job = v1::Job {
        id: record.id,
        name: record.name.clone(),
        // Unreadable specifications are shown as absent; the record keeps their bytes.
        spec: v1::JobSpec::decode(record.spec.as_slice()).ok(),
        profile: record.profile.clone().unwrap_or_default(),
        tiles_total: slots.len() as u32,
        cells_total,
        submitted_at_ms: record.submitted_at_ms,
        finished_at_ms: record.finished_at_ms.unwrap_or(0),
        workers,
        ..v1::Job::default()
    };
    let state = match &record.state {
        JobState::Queued => v1::JobState::Queued,
        JobState::Running => v1::JobState::Running,
        JobState::Paused => v1::JobState::Paused,
        JobState::Cancelled => v1::JobState::Cancelled,
        JobState::Failed { reason } => {
            job.reason = reason.clone();
            v1::JobState::Failed
        }
        JobState::Done { result, bytes } => {
            job.result = result.to_vec();
            job.result_bytes = *bytes;
            v1::JobState::Done
        }
    };
    job.set_state(state);
    for slot in slots {
        match &slot.state {
            TileState::Open => {}
            TileState::Done { stats, .. } => {
                job.tiles_done += 1;
                job.cells_done = job.cells_done.saturating_add(stats.cells);
                job.samples = job.samples.saturating_add(stats.samples);
                job.tile_millis = job.tile_millis.saturating_add(stats.millis);
            }
            TileState::SetAside { .. } => job.tiles_set_aside += 1,
        }
        if let Some(l) = &slot.lease {
            job.tiles_running += 1;
            job.cells_done = job.cells_done.saturating_add(l.cells);
            job.samples = job.samples.saturating_add(l.samples);
        }
    }
    job
}
