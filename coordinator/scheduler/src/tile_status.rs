//! The states of the tiles of a job, for display.

use sightline_records::ids::JobId;

use super::job::{OpenJob, Output, Tile};
use super::state::{Leased, Scheduler};

/// The state of a tile. The values equal the values of `v1::TileState`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileStatus {
    /// The tile waits for other tiles or for the end of a delay, or its job leases no tiles.
    Waiting = 1,
    /// A worker may get the tile.
    Ready = 2,
    /// A worker holds the tile and has not begun it.
    Leased = 3,
    /// A worker computes the tile.
    Running = 4,
    /// The store has the output.
    Done = 5,
    /// The tile failed too often.
    SetAside = 6,
}

/// A tile of a job that has not ended, for display.
#[derive(Clone, Debug)]
pub struct Live {
    pub status: TileStatus,
    /// The number of finished cells that the tile's worker has reported.
    pub cells: u64,
    /// The number of samples that the tile's worker has reported.
    pub samples: u64,
    /// The names of the workers that hold the tile.
    pub workers: Vec<String>,
}

impl Scheduler {
    /// Returns the states of a job's tiles in plan order, or `None` for an ended job.
    pub fn tile_statuses(&self, id: JobId) -> Option<Vec<TileStatus>> {
        let job = self.jobs.get(&id)?;
        Some(
            job.tiles
                .iter()
                .map(|tile| self.tile_status(job, tile))
                .collect(),
        )
    }

    /// Returns the tiles of a job with indices in `range`, or `None` if the job has ended or has fewer tiles.
    pub fn live_tiles(&self, id: JobId, range: std::ops::Range<usize>) -> Option<Vec<Live>> {
        let job = self.jobs.get(&id)?;
        let live = |tile: &Tile| {
            let leases: Vec<&Leased> = self.leases_of(tile).collect();
            let name = |lease: &&Leased| self.name_of(lease.worker).map(str::to_owned);
            Live {
                status: self.tile_status(job, tile),
                cells: leases.iter().map(|l| l.cells).max().unwrap_or(0),
                samples: leases.iter().map(|l| l.samples).max().unwrap_or(0),
                workers: leases.iter().filter_map(name).collect(),
            }
        };
        Some(job.tiles.get(range)?.iter().map(live).collect())
    }

    fn tile_status(&self, job: &OpenJob, tile: &Tile) -> TileStatus {
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
            .filter_map(|id| self.leases.table.get(id))
    }
}
