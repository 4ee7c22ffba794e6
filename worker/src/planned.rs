//! The jobs of the last orders, decoded and planned: a worker gets many tiles of one job.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use sightline_model::{JobSpec, PlannedJob, SceneFacts};
use sightline_proto::v1;

/// Maximum number of jobs that are kept.
const KEPT: usize = 4;

/// The jobs of the last orders, the newest last.
#[derive(Default)]
pub struct PlannedJobs(Mutex<VecDeque<(v1::JobSpec, Arc<PlannedJob>)>>);

impl PlannedJobs {
    /// Finds or plans the job of an order.
    ///
    /// # Errors
    /// The reason, when the order has no specification that this program can read.
    pub fn job(&self, message: Option<v1::JobSpec>) -> Result<Arc<PlannedJob>, String> {
        let message = message.ok_or("the order has no specification")?;
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, job)) = kept.iter().find(|(of, _)| *of == message) {
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

    fn order(receivers: u8) -> Option<v1::JobSpec> {
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
        let first = jobs.job(order(1)).unwrap();
        assert!(Arc::ptr_eq(&first, &jobs.job(order(1)).unwrap()));
        (2..=4).for_each(|n| drop(jobs.job(order(n)).unwrap()));
        assert!(Arc::ptr_eq(&first, &jobs.job(order(1)).unwrap()));
        jobs.job(order(5)).unwrap();
        assert!(!Arc::ptr_eq(&first, &jobs.job(order(1)).unwrap()));
        assert!(jobs.job(None).is_err());
        assert!(jobs.job(Some(v1::JobSpec::default())).is_err());
    }
}
