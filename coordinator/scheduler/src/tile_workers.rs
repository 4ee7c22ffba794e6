//! The workers that currently compute a job's tiles, for display.

use sightline_records::ids::{JobId, TileIndex, WorkerId};

use super::state::Scheduler;

/// Maximum number of listed tiles.
const MOST_TILES: usize = 20;

/// A leased tile and its workers, by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileWorkers {
    /// The leased tile.
    pub tile: TileIndex,
    /// The name of the worker that holds the tile.
    pub leader: String,
    /// True if the worker has begun the tile; otherwise it fetches the scene or computes another tile.
    pub has_begun: bool,
    /// The names of the workers that help with the tile.
    pub helpers: Vec<String>,
}

impl Scheduler {
    /// Returns the first 20 leases on a job's tiles with their workers, or an empty list if the job has
    /// ended.
    pub fn tile_workers(&self, id: JobId) -> Vec<TileWorkers> {
        let Some(job) = self.jobs.get(&id) else {
            return Vec::new();
        };
        let name = |id: &WorkerId| self.roster.workers.get(id).map(|w| w.name.clone());
        let leased = job.tiles.iter().flat_map(|tile| tile.leases).flatten();
        leased
            .filter_map(|id| {
                let lease = self.leases.table.get(&id)?;
                let helpers = self
                    .queues
                    .crews
                    .get(&id)
                    .map(|crew| crew.helpers.keys().filter_map(name).collect());
                Some(TileWorkers {
                    tile: lease.tile,
                    leader: name(&lease.worker)?,
                    has_begun: lease.begun.is_some(),
                    helpers: helpers.unwrap_or_default(),
                })
            })
            .take(MOST_TILES)
            .collect()
    }
}
