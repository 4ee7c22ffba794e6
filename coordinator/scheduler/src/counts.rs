//! The numbers of tiles of each job by state, for the metrics.

use sightline_records::JobPhase;

use super::state::Scheduler;

/// The tile counts of a job that has not ended.
#[derive(Clone, Debug)]
pub struct Counts {
    /// The state of the job: `queued`, `running` or `paused`.
    pub state: &'static str,
    /// The numerics profile, or `unbound`.
    pub profile: String,
    /// The number of tiles that could be leased now.
    pub ready: u32,
    /// The number of leases on tiles of the job, including checks.
    pub leased: u32,
    /// The number of open tiles that are neither ready nor leased.
    pub waiting: u32,
}

impl Scheduler {
    /// Returns the counts of the jobs that have not ended. The cost per job does not depend on its number of
    /// tiles.
    pub fn counts(&self) -> Vec<Counts> {
        let counts = self.jobs.values().map(|job| {
            let able = self.allowed(job) && !job.grace;
            let ready = if able { job.ready.len() as u32 } else { 0 };
            Counts {
                state: match job.record.state.phase() {
                    JobPhase::Running => "running",
                    JobPhase::Paused => "paused",
                    _ => "queued",
                },
                profile: job
                    .record
                    .profile
                    .clone()
                    .unwrap_or_else(|| "unbound".to_owned()),
                ready,
                leased: job.running,
                waiting: job.open().saturating_sub(ready).saturating_sub(job.running),
            }
        });
        counts.collect()
    }

    /// Returns true if the scheduler temporarily grants no tiles.
    pub fn is_paused(&self) -> bool {
        self.time.paused_until.is_some()
    }
}
