//! The connected workers that cannot work on a job, with the reasons, for display.

use std::collections::BTreeMap;

use sightline_records::ids::JobId;

use super::state::{Scheduler, Worker};

/// Maximum number of worker names that are listed per reason.
const MOST_NAMES: usize = 20;

/// The workers that cannot work on a job for the same reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ineligible {
    /// The reason.
    pub reason: String,
    /// The number of workers.
    pub workers: u32,
    /// The names of the first 20 of these workers.
    pub names: Vec<String>,
}

impl Scheduler {
    /// Returns the connected workers that cannot work on a job, by reason. Returns an empty list for a job
    /// that has ended.
    pub fn ineligible(&self, id: JobId) -> Vec<Ineligible> {
        let Some(job) = self.jobs.get(&id) else {
            return Vec::new();
        };
        let choice = Self::choice_of(job);
        let mut by_reason: BTreeMap<String, (u32, Vec<String>)> = BTreeMap::new();
        for worker in self.roster.workers.values() {
            let Some(reason) = self.reason_against(worker, job.record.profile.as_deref(), choice)
            else {
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
            .map(|(reason, (workers, names))| Ineligible {
                reason,
                workers,
                names,
            })
            .collect()
    }

    /// Returns the reason why a worker cannot work on a job, or `None` if it can.
    fn reason_against(
        &self,
        worker: &Worker,
        profile: Option<&str>,
        choice: usize,
    ) -> Option<String> {
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
                    "the job is bound to the numerics profile {profile}; the worker's numerics profiles: {}",
                    has()
                ));
            }
            None if !worker.serves[choice] => {
                return Some(format!(
                    "the worker has no backend that the job allows; the worker's numerics profiles: {}",
                    has()
                ));
            }
            _ => {}
        }
        if worker.draining {
            return Some("the worker is draining and accepts no more tiles".to_owned());
        }
        self.trouble(worker).map(str::to_owned)
    }
}
