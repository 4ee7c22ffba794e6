//! How fast a job goes on: its samples a second, and the time that is left.

use std::time::Instant;

use sightline_model::job::message::time_budget_ms;
use sightline_proto::v1;

/// The cells of a tile do not take the same time: the first take long, and most end together. Of few tiles
/// the time left is told when a fifth of the cells is done.
const FEW_TILES: u32 = 8;

/// What is left of a job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Left {
    /// It is paused.
    Paused,
    /// Nobody works on it.
    NoWorkers,
    /// All its cells are done.
    Finishing,
    /// About this time.
    Seconds(f64),
    /// Too little is done to tell.
    NotKnown,
}

/// The counts of a job when it was first seen: what earlier runs had done already.
#[derive(Clone, Copy)]
struct AtStart {
    tiles: u64,
    cells: u64,
    samples: u64,
}

/// Follows a job's counts over time.
pub struct Pace {
    start: Instant,
    first: Option<AtStart>,
}

impl Pace {
    /// The time runs from now on.
    pub fn new() -> Self {
        Self {
            start: Instant::now(),
            first: None,
        }
    }

    fn first(&mut self, job: &v1::Job) -> AtStart {
        let tiles = u64::from(job.tiles_done + job.tiles_set_aside);
        *self.first.get_or_insert(AtStart {
            tiles,
            cells: job.cells_done,
            samples: job.samples,
        })
    }

    /// Samples a second since the job was first seen.
    pub fn samples_per_second(&mut self, job: &v1::Job) -> f64 {
        let first = self.first(job);
        job.samples.saturating_sub(first.samples) as f64
            / self.start.elapsed().as_secs_f64().max(1e-3)
    }

    /// What is left of the job. `workers_here`: the workers run in this process.
    pub fn left(&mut self, job: &v1::Job, workers_here: bool) -> Left {
        let first = self.first(job);
        let seconds = self.start.elapsed().as_secs_f64();
        let ended = u64::from(job.tiles_done + job.tiles_set_aside);
        // Cells are counted if their total is known, because a small job may be a single tile.
        let (here, left) = match job.cells_total {
            0 => (
                ended.saturating_sub(first.tiles),
                u64::from(job.tiles_total).saturating_sub(ended),
            ),
            total => (
                job.cells_done.saturating_sub(first.cells),
                total.saturating_sub(job.cells_done),
            ),
        };
        let open = matches!(job.state(), v1::JobState::Queued | v1::JobState::Running);
        if job.state() == v1::JobState::Paused {
            Left::Paused
        } else if open && job.workers == 0 && !workers_here {
            Left::NoWorkers
        } else if left == 0 {
            Left::Finishing
        } else if here > 0 && (job.tiles_total > FEW_TILES || here * 4 >= left) {
            // No job runs much longer than its time budget.
            let budget = job
                .spec
                .as_ref()
                .and_then(time_budget_ms)
                .map_or(0.0, |budget| budget as f64 * 1e-3);
            match seconds / here as f64 * left as f64 {
                _ if budget > 0.0 && seconds >= budget => Left::Finishing,
                left if budget > 0.0 => Left::Seconds(left.min(budget - seconds)),
                left => Left::Seconds(left),
            }
        } else {
            Left::NotKnown
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_earlier_runs_have_done_tells_nothing_about_the_time_left() {
        let running = v1::JobState::Running as i32;
        let mut job = v1::Job {
            state: running,
            tiles_total: 1,
            cells_total: 8,
            ..v1::Job::default()
        };
        let mut pace = Pace::new();
        job.cells_done = 4;
        assert_eq!(pace.left(&job, false), Left::NoWorkers);
        assert_eq!(pace.left(&job, true), Left::NotKnown);
        job.cells_done = 6;
        assert!(matches!(pace.left(&job, true), Left::Seconds(s) if s < 60.0));
        job.cells_done = 8;
        assert_eq!(pace.left(&job, true), Left::Finishing);
        job.state = v1::JobState::Paused as i32;
        assert_eq!(pace.left(&job, true), Left::Paused);
    }
}
