//! Selections of done tiles whose results are no longer trusted.

use std::collections::{BTreeMap, BTreeSet};

use sightline_records::ids::{JobId, TileIndex};
use sightline_records::{TileRecord, TileState};

use crate::api::Queries;
use crate::error::StoreError;

/// A selection of done tiles.
#[derive(Clone, Debug, Default)]
pub struct TileFilter {
    /// The job of the selected tiles; `None` to select tiles of all jobs.
    pub job: Option<JobId>,
    /// The indices of the selected tiles; empty to select all tiles.
    pub tiles: BTreeSet<TileIndex>,
    /// The name or signature of a worker that may have contributed; `None` to select tiles of all workers.
    pub worker: Option<String>,
    /// The earliest commit time, in milliseconds since 1970. Tiles without a time are always selected.
    pub from_ms: u64,
    /// The latest commit time, in milliseconds since 1970.
    pub to_ms: u64,
}

impl TileFilter {
    /// Returns true if the filter selects a tile.
    pub fn selects(&self, record: &TileRecord) -> bool {
        let TileState::Done { stats, .. } = &record.state else {
            return false;
        };
        let timed = stats.at_ms == 0 || (self.from_ms..=self.to_ms).contains(&stats.at_ms);
        let named = self.tiles.is_empty() || self.tiles.contains(&record.tile);
        timed
            && named
            && self
                .worker
                .as_ref()
                .is_none_or(|name| stats.may_be_of(name))
    }
}

/// Returns the done tiles of each job that must be computed again when these workers are quarantined.
///
/// These are the tiles to which a worker contributed and that were committed after its last confirmed result,
/// and the condemned tile.
///
/// # Errors
/// The [`StoreError`] of a failed query.
pub fn untrusted_tiles(
    store: &dyn Queries,
    workers: &[String],
    condemned: Option<(JobId, TileIndex)>,
) -> Result<BTreeMap<JobId, BTreeSet<TileIndex>>, StoreError> {
    let agreed = agreements(store, workers)?;
    let of_worker = |worker: &String| {
        let from_ms = agreed.get(worker).map_or(0, |at| at + 1);
        TileFilter {
            worker: Some(worker.clone()),
            from_ms,
            to_ms: u64::MAX,
            ..TileFilter::default()
        }
    };
    let all: Vec<TileFilter> = workers.iter().map(of_worker).collect();
    let mut untrusted = BTreeMap::new();
    for job in store.jobs()? {
        let is_done = |tile: &TileRecord| matches!(tile.state, TileState::Done { .. });
        let is_meant = |tile: &TileRecord| {
            all.iter().any(|filter| filter.selects(tile))
                || is_done(tile) && condemned == Some((job.id, tile.tile))
        };
        let tiles = store.tiles(job.id)?;
        let tiles: BTreeSet<TileIndex> = tiles
            .iter()
            .filter(|t| is_meant(t))
            .map(|t| t.tile)
            .collect();
        if !tiles.is_empty() {
            untrusted.insert(job.id, tiles);
        }
    }
    Ok(untrusted)
}

/// Returns the time of each worker's last confirmed result, in milliseconds since 1970.
///
/// A result is confirmed if two workers computed the same bytes. The time is the commit time for a
/// contributor to the tile, and the time of the check for the confirming worker.
fn agreements(
    store: &dyn Queries,
    workers: &[String],
) -> Result<BTreeMap<String, u64>, StoreError> {
    let mut last: BTreeMap<String, u64> = BTreeMap::new();
    for job in store.jobs()? {
        for tile in store.tiles(job.id)? {
            let (TileState::Done { stats, .. }, Some(check)) = (&tile.state, &tile.check) else {
                continue;
            };
            for worker in workers {
                let at = if check.worker == *worker {
                    check.at_ms
                } else if stats.worker == *worker || stats.helpers.contains(worker) {
                    stats.at_ms
                } else {
                    continue;
                };
                let known = last.entry(worker.clone()).or_default();
                *known = at.max(*known);
            }
        }
    }
    Ok(last)
}
