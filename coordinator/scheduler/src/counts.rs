//! How many tiles of each job are where: for the metrics.

use sightline_records::JobPhase;

use super::state::Scheduler;

/// A job that has not ended.
#[derive(Clone, Debug)]
pub struct Counts {
    /// `queued`, `running` or `paused`.
    pub state: &'static str,
    /// The numerics profile, or `unbound`.
    pub profile: String,
    /// Tiles that could be leased.
    pub ready: u32,
    /// Leases.
    pub leased: u32,
    /// Open tiles that are neither.
    pub waiting: u32,
}

impl Scheduler {
    /// The jobs that have not ended. Costs the same for each job, however many tiles it has.
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

    /// Whether no tiles are granted for a while.
    pub fn is_paused(&self) -> bool {
        self.paused_until.is_some()
    }
}
