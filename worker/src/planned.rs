//! The jobs of the last grants, decoded and planned, because a worker gets many tiles of one job.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use sightline_model::{JobSpec, PlannedJob, SceneFacts};
use sightline_proto::v1;

/// Maximum number of cached jobs.
const KEPT: usize = 4;

/// The jobs of the last grants, the newest last.
#[derive(Default)]
pub struct PlannedJobs(Mutex<VecDeque<(v1::JobSpec, Arc<PlannedJob>)>>);

impl PlannedJobs {
    /// Returns the job of a grant from the cache, or plans the job.
    ///
    /// # Errors
    /// The reason, if the grant contains no specification that this program can read.
    pub fn job(&self, message: Option<v1::JobSpec>) -> Result<Arc<PlannedJob>, String> {
        let message = message.ok_or("the coordinator's message has no job specification")?;
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, job)) = kept
            .iter()
            .find(|(kept_message, _)| *kept_message == message)
        {
            return Ok(Arc::clone(job));
        }
        let spec = JobSpec::from_message(&message, &SceneFacts::default());
        let job = Arc::new(PlannedJob::stored(spec.map_err(|e| e.to_string())?));
        if kept.len() == KEPT {
            kept.pop_front();
        }
        kept.push_back((message, Arc::clone(&job)));
        Ok(job)
    }
}

#[cfg(test)]
mod tests {
    use sightline_model::Ambient;

    use super::*;

    fn message(receivers: u8) -> Option<v1::JobSpec> {
        let ambient = Ambient {
            receivers: [receivers; 32],
            bytes: 1000,
            points: 5,
            lights: 0,
        };
        Some(JobSpec::of_receivers([7; 32], ambient).to_message())
    }

    #[test]
    fn last_jobs_are_planned_once() {
        let jobs = PlannedJobs::default();
        let first = jobs.job(message(1)).unwrap();
        assert!(Arc::ptr_eq(&first, &jobs.job(message(1)).unwrap()));
        (2..=4).for_each(|n| drop(jobs.job(message(n)).unwrap()));
        assert!(Arc::ptr_eq(&first, &jobs.job(message(1)).unwrap()));
        jobs.job(message(5)).unwrap();
        assert!(!Arc::ptr_eq(&first, &jobs.job(message(1)).unwrap()));
        assert!(jobs.job(None).is_err());
        assert!(jobs.job(Some(v1::JobSpec::default())).is_err());
    }
}
