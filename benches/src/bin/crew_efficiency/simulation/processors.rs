//! The workers' processors: one core each, or a number of cores that all share evenly.

use std::collections::BTreeSet;

/// Work in progress.
#[derive(Debug)]
pub struct Processors {
    cores: Option<u64>,
    /// What a worker that has been busy all the time would have done, in nanoseconds of work.
    done: u64,
    /// When that was.
    at: u64,
    /// What will have been done at the end of each worker's work.
    busy: BTreeSet<(u64, usize)>,
}

impl Processors {
    /// Cores for all workers together; `None` for one each.
    pub fn new(cores: Option<u64>) -> Self {
        Self {
            cores,
            done: 0,
            at: 0,
            busy: BTreeSet::new(),
        }
    }

    /// Workers for each core in use: numerator and denominator.
    fn share(&self) -> (u128, u128) {
        let busy = self.busy.len() as u64;
        match self.cores {
            Some(cores) if busy > cores => (u128::from(busy), u128::from(cores)),
            _ => (1, 1),
        }
    }

    /// Lets time pass.
    pub fn advance(&mut self, now: u64) {
        let (over, under) = self.share();
        self.done += (u128::from(now - self.at) * under / over) as u64;
        self.at = now;
    }

    /// Gives a worker work, at the time of the last [`Self::advance`].
    pub fn begin(&mut self, worker: usize, work: u64) {
        self.busy.insert((self.done + work, worker));
    }

    /// When the next worker ends its work.
    pub fn next(&self) -> Option<u64> {
        let (over, under) = self.share();
        let (end, _) = self.busy.first()?;
        Some(self.at + (u128::from(end.saturating_sub(self.done)) * over).div_ceil(under) as u64)
    }

    /// The worker that ends at the time of the last [`Self::advance`], which was [`Self::next`].
    pub fn end(&mut self) -> Option<usize> {
        let (end, worker) = self.busy.pop_first()?;
        // Rounding may leave a part of a nanosecond.
        self.done = self.done.max(end);
        Some(worker)
    }
}
