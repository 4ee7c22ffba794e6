//! The states of the tiles of a job, for display.

use sightline_records::ids::JobId;

use super::job::{Job, Output, Tile};
use super::state::{Leased, Scheduler};

/// The state of a tile. The numbers are the numbers of `v1::TileState`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileStatus {
    /// The tile waits for other tiles, or for the end of a delay.
    Waiting = 1,
    /// A worker may get the tile.
    Ready = 2,
    /// A worker has the tile and has not begun it.
    Leased = 3,
    /// A worker computes the tile.
    Running = 4,
    /// The store has the output.
    Done = 5,
    /// The tile failed too often.
    SetAside = 6,
}

/// A tile of a job that has not ended.
#[derive(Clone, Debug)]
pub struct Live {
    pub standing: TileStatus,
    /// Cells and samples that its worker has reported.
    pub cells: u64,
    pub samples: u64,
    /// The workers that hold it, by name.
    pub workers: Vec<String>,
}

impl Scheduler {
    /// How all tiles of a job stand, in their order; `None` for a job that has ended.
    pub fn standings(&self, id: JobId) -> Option<Vec<TileStatus>> {
        let job = self.jobs.get(&id)?;
        Some(
            job.tiles
                .iter()
                .map(|tile| self.standing(job, tile))
                .collect(),
        )
    }

    /// Some tiles of a job that has not ended.
    pub fn live_tiles(&self, id: JobId, range: std::ops::Range<usize>) -> Option<Vec<Live>> {
        let job = self.jobs.get(&id)?;
        let live = |tile: &Tile| {
            let leases: Vec<&Leased> = self.leases_of(tile).collect();
            let name = |lease: &&Leased| self.name_of(lease.worker).map(str::to_owned);
            Live {
                standing: self.standing(job, tile),
                cells: leases.iter().map(|l| l.cells).max().unwrap_or(0),
                samples: leases.iter().map(|l| l.samples).max().unwrap_or(0),
                workers: leases.iter().filter_map(name).collect(),
            }
        };
        Some(job.tiles.get(range)?.iter().map(live).collect())
    }

    fn standing(&self, job: &Job, tile: &Tile) -> TileStatus {
        match tile.output {
            Output::Done(_) => TileStatus::Done,
            Output::SetAside(_) => TileStatus::SetAside,
            Output::Open if tile.leases != [None; 2] => {
                match self.leases_of(tile).any(|lease| lease.begun.is_some()) {
                    true => TileStatus::Running,
                    false => TileStatus::Leased,
                }
            }
            Output::Open => match self.allowed(job) && !job.grace && tile.can_be_leased() {
                true => TileStatus::Ready,
                false => TileStatus::Waiting,
            },
        }
    }

    fn leases_of<'a>(&'a self, tile: &'a Tile) -> impl Iterator<Item = &'a Leased> {
        tile.leases
            .iter()
            .flatten()
            .filter_map(|id| self.leases.get(id))
    }
}
