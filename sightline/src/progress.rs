//! The measurement of progress: counts, the sampling rate, and the remaining time.

use std::time::Instant;

use sightline_model::job::message::time_budget_ms;
use sightline_proto::v1;

use crate::client::Job;
use crate::observer::{JobProgress, Observer, Progress, TimeLeft};

/// Maximum number of tiles of a small job. The remaining time of a small job is unknown until a fifth of the
/// cells is done, because the first cells of a tile take long, and most cells end together.
const FEW_TILES: u32 = 8;

/// A count of items that take about the same time each.
pub(crate) struct Counter<'a> {
    what: &'static str,
    start: Instant,
    observer: &'a dyn Observer,
}

impl<'a> Counter<'a> {
    /// Creates a count for an observer.
    pub(crate) fn new(what: &'static str, observer: &'a dyn Observer) -> Self {
        Self {
            what,
            start: Instant::now(),
            observer,
        }
    }

    /// Reports the numbers of finished items and of all items to the observer.
    pub(crate) fn show(&self, done: u64, total: u64) {
        let seconds = self.start.elapsed().as_secs_f64();
        let left = total.saturating_sub(done) as f64;
        let left = (done > 0).then(|| seconds / done as f64 * left);
        self.observer.progress(&Progress {
            done,
            total,
            what: self.what,
            left: left.map_or(TimeLeft::Unknown, TimeLeft::Seconds),
            job: None,
        });
    }
}

/// The numbers of ended tiles, finished cells and samples of a job when this process first observed the job.
#[derive(Clone, Copy)]
struct AtStart {
    tiles: u64,
    cells: u64,
    samples: u64,
}

/// The counts of a job over time.
pub(crate) struct JobRate {
    start: Instant,
    first: Option<AtStart>,
    workers_here: bool,
}

impl JobRate {
    /// Creates the counts of a job that is observed from now on. If `workers_here` is true, the job's workers
    /// run in this process.
    pub(crate) fn new(workers_here: bool) -> Self {
        Self {
            start: Instant::now(),
            first: None,
            workers_here,
        }
    }

    /// Reports the progress of the job to an observer.
    pub(crate) fn show(&mut self, job: &Job, observer: &dyn Observer) {
        let message = job.message();
        let (left, samples_per_second) = (self.left(message), self.samples_per_second(message));
        let (done, total, what) = match message.cells_total {
            0 => (
                u64::from(message.tiles_done + message.tiles_set_aside),
                u64::from(message.tiles_total),
                "tiles",
            ),
            total => (message.cells_done, total, job.cell_noun()),
        };
        observer.progress(&Progress {
            done,
            total,
            what,
            left,
            job: Some(JobProgress {
                job,
                samples_per_second,
            }),
        });
    }

    fn first(&mut self, job: &v1::Job) -> AtStart {
        let tiles = u64::from(job.tiles_done + job.tiles_set_aside);
        *self.first.get_or_insert(AtStart {
            tiles,
            cells: job.cells_done,
            samples: job.samples,
        })
    }

    /// Returns the samples per second since the job was first observed.
    fn samples_per_second(&mut self, job: &v1::Job) -> f64 {
        let first = self.first(job);
        job.samples.saturating_sub(first.samples) as f64
            / self.start.elapsed().as_secs_f64().max(1e-3)
    }

    /// Estimates the remaining time of the job.
    fn left(&mut self, job: &v1::Job) -> TimeLeft {
        let first = self.first(job);
        let seconds = self.start.elapsed().as_secs_f64();
        let ended = u64::from(job.tiles_done + job.tiles_set_aside);
        // If the total number of cells is known, count cells, because a small job may be a single tile.
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
            TimeLeft::Paused
        } else if open && job.workers == 0 && !self.workers_here {
            TimeLeft::NoWorkers
        } else if left == 0 {
            TimeLeft::Finishing
        } else if here > 0 && (job.tiles_total > FEW_TILES || here * 4 >= left) {
            // A job does not run much longer than its time budget.
            let budget = job
                .spec
                .as_ref()
                .and_then(time_budget_ms)
                .map_or(0.0, |budget| budget as f64 * 1e-3);
            match seconds / here as f64 * left as f64 {
                _ if budget > 0.0 && seconds >= budget => TimeLeft::Finishing,
                left if budget > 0.0 => TimeLeft::Seconds(left.min(budget - seconds)),
                left => TimeLeft::Seconds(left),
            }
        } else {
            TimeLeft::Unknown
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_ignores_work_of_earlier_runs() {
        let running = v1::JobState::Running as i32;
        let mut job = v1::Job {
            state: running,
            tiles_total: 1,
            cells_total: 8,
            ..v1::Job::default()
        };
        let mut here = JobRate::new(true);
        let mut away = JobRate::new(false);
        job.cells_done = 4;
        assert_eq!(away.left(&job), TimeLeft::NoWorkers);
        assert_eq!(here.left(&job), TimeLeft::Unknown);
        job.cells_done = 6;
        assert!(matches!(here.left(&job), TimeLeft::Seconds(s) if s < 60.0));
        job.cells_done = 8;
        assert_eq!(here.left(&job), TimeLeft::Finishing);
        job.state = v1::JobState::Paused as i32;
        assert_eq!(here.left(&job), TimeLeft::Paused);
    }
}
