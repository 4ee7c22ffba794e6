//! Who works on a job's tiles at present: for people.

use sightline_records::ids::{JobId, TileIndex, WorkerId};

use super::state::Scheduler;

/// Tiles that are listed.
const MOST_TILES: usize = 20;

/// A leased tile and its workers, by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Team {
    /// The tile.
    pub tile: TileIndex,
    /// The worker that holds the tile.
    pub leader: String,
    /// Whether it has begun; if not, it fetches the scene or is busy with another tile.
    pub has_begun: bool,
    /// Those that help it.
    pub helpers: Vec<String>,
}

impl Scheduler {
    /// The first leased tiles of a job with their workers; none for a job that has ended.
    pub fn teams(&self, id: JobId) -> Vec<Team> {
        let Some(job) = self.jobs.get(&id) else {
            return Vec::new();
        };
        let name = |id: &WorkerId| self.workers.get(id).map(|w| w.name.clone());
        let leased = job.tiles.iter().flat_map(|tile| tile.leases).flatten();
        leased
            .filter_map(|id| {
                let lease = self.leases.get(&id)?;
                let helpers = self
                    .crews
                    .get(&id)
                    .map(|crew| crew.helpers.keys().filter_map(name).collect());
                Some(Team {
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
