//! A job of a coordinator in its last known state.

use serde::{Serialize, Serializer};
use serde_json::{Value, json};
use sightline_proto::v1;

use crate::error::Error;

/// A job of a coordinator in its last known state. Its serialisation is the document that
/// `sightline show --json` prints.
///
/// ```no_run
/// use sightline::{Client, Endpoint, Silent};
///
/// let client = Client::new(Endpoint::new("http://127.0.0.1:7600"))?;
/// for job in client.jobs(&Default::default(), &Silent)?.jobs {
///     println!("{} is {}", job.id(), job.state_name());
/// }
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Job(v1::Job);

impl From<v1::Job> for Job {
    fn from(message: v1::Job) -> Self {
        Self(message)
    }
}

impl Job {
    /// Returns the job's number at its coordinator.
    pub fn id(&self) -> u64 {
        self.0.id
    }

    /// Returns the coordinator's message about the job.
    pub fn message(&self) -> &v1::Job {
        &self.0
    }

    /// Returns the state as a word: queued, running, paused, cancelled, failed or done.
    pub fn state_name(&self) -> &'static str {
        match self.0.state() {
            v1::JobState::Unspecified => "unknown",
            v1::JobState::Queued => "queued",
            v1::JobState::Running => "running",
            v1::JobState::Paused => "paused",
            v1::JobState::Cancelled => "cancelled",
            v1::JobState::Failed => "failed",
            v1::JobState::Done => "done",
        }
    }

    /// Returns true if the job has a result.
    pub fn is_done(&self) -> bool {
        self.0.state() == v1::JobState::Done
    }

    /// Returns true if the job is paused.
    pub fn is_paused(&self) -> bool {
        self.0.state() == v1::JobState::Paused
    }

    /// Returns true if the job computes ambient occlusion at receivers.
    pub fn has_receivers(&self) -> bool {
        let task = self.0.spec.as_ref().and_then(|spec| spec.task.as_ref());
        matches!(task, Some(v1::job_spec::Task::Ambient(_)))
    }

    /// Returns the noun for the items of the job that its message counts as cells: `receivers` or `cells`.
    pub fn cell_noun(&self) -> &'static str {
        match self.has_receivers() {
            true => "receivers",
            false => "cells",
        }
    }

    /// Checks that the job has ended with a result.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Job`] if the job failed or was cancelled, or [`crate::ErrorKind::Coordinator`] if
    /// the job has not ended.
    pub fn ensure_done(&self) -> Result<(), Error> {
        let id = self.id();
        match self.0.state() {
            v1::JobState::Done => Ok(()),
            v1::JobState::Failed => Err(Error::job(format!("job {id} failed: {}", self.0.reason))),
            v1::JobState::Cancelled => Err(Error::job(format!(
                "job {id} was cancelled; `sightline retry {id}` continues it"
            ))),
            _ => Err(Error::coordinator(format!(
                "job {id} has not ended yet; `sightline watch {id}` follows it"
            ))),
        }
    }

    /// Returns the document that `sightline show --json` prints, without the job's specification.
    pub fn to_json(&self) -> Value {
        let job = &self.0;
        let hex = |b: &[u8]| b.iter().map(|b| format!("{b:02x}")).collect::<String>();
        let unable = |u: &v1::UnableWorkers| {
            let (reason, workers, names) = (&u.reason, u.workers, &u.names);
            json!({"reason": reason, "workers": workers, "names": names})
        };
        let team = |t: &v1::Team| {
            json!({
                "tile": t.tile, "leader": t.leader, "has_begun": t.has_begun, "helpers": t.helpers,
            })
        };
        json!({
            "job": job.id, "name": job.name, "state": self.state_name(), "reason": job.reason,
            "scene": job.spec.as_ref().map(|s| hex(&s.scene)), "profile": job.profile,
            "tiles_total": job.tiles_total, "tiles_done": job.tiles_done,
            "tiles_set_aside": job.tiles_set_aside, "tiles_running": job.tiles_running,
            "cells_total": job.cells_total, "cells_done": job.cells_done, "samples": job.samples,
            "tile_millis": job.tile_millis, "submitted_at_ms": job.submitted_at_ms,
            "finished_at_ms": job.finished_at_ms, "result": hex(&job.result),
            "result_bytes": job.result_bytes, "workers": job.workers,
            "priority": job.priority, "user": job.user, "left_millis": job.left_millis,
            "unable": job.unable.iter().map(unable).collect::<Vec<_>>(),
            "teams": job.teams.iter().map(team).collect::<Vec<_>>(),
            "trace": (!job.trace.is_empty()).then(|| hex(&job.trace)),
        })
    }
}

impl Serialize for Job {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.to_json().serialize(to)
    }
}
