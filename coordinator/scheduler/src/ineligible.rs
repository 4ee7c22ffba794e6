//! Which connected workers cannot work on a job, and why: for people.

use std::collections::BTreeMap;

use sightline_records::ids::JobId;

use super::state::{Scheduler, Worker};

/// Names that are given of the workers with one reason.
const MOST_NAMES: usize = 20;

/// Workers that cannot work on a job for the same reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unable {
    /// The reason.
    pub reason: String,
    /// The number of workers.
    pub workers: u32,
    /// The names of some of the workers.
    pub names: Vec<String>,
}

impl Scheduler {
    /// The connected workers that cannot work on a job, by reason; none for a job that has ended.
    pub fn unable(&self, id: JobId) -> Vec<Unable> {
        let Some(job) = self.jobs.get(&id) else {
            return Vec::new();
        };
        let choice = Self::choice_of(job);
        let mut by_reason: BTreeMap<String, (u32, Vec<String>)> = BTreeMap::new();
        for worker in self.workers.values() {
            let Some(reason) = self.why(worker, job.record.profile.as_deref(), choice) else {
                continue;
            };
            let (workers, names) = by_reason.entry(reason).or_default();
            *workers += 1;
            if names.len() < MOST_NAMES {
                names.push(worker.name.clone());
            }
        }
        by_reason
            .into_iter()
            .map(|(reason, (workers, names))| Unable {
                reason,
                workers,
                names,
            })
            .collect()
    }

    fn why(&self, worker: &Worker, profile: Option<&str>, choice: usize) -> Option<String> {
        let has = || {
            worker
                .profiles
                .iter()
                .map(|p| &**p)
                .collect::<Vec<_>>()
                .join(", ")
        };
        match profile {
            Some(profile) if !worker.profiles.contains(profile) => {
                return Some(format!(
                    "the job is bound to the numerics profile {profile}, and the worker has {}",
                    has()
                ));
            }
            None if !worker.serves[choice] => {
                return Some(format!(
                    "it has no backend that the job asks for; it has {}",
                    has()
                ));
            }
            _ => {}
        }
        if worker.draining {
            return Some("it takes no more tiles, because it was told to stop".to_owned());
        }
        self.trouble(worker).map(str::to_owned)
    }
}
