//! The tiles of a job for display: bounds, states and costs.

use sightline_records::ids::{JobId, TileIndex};
use sightline_records::{TileFailure, TileState};
use sightline_scheduler::TileStatus;
use sightline_store::StoreError;
use sightline_viewcells::TileKind;

use crate::coordinator::Coordinator;
use crate::jobs::stored_spec;

/// A tile of a job.
#[derive(Clone, Debug)]
pub(crate) struct TileView {
    pub(crate) tile: TileIndex,
    pub(crate) status: TileStatus,
    /// The tile's part of the view box, in world space. `None` if another version of the program planned the
    /// job, or if the job has receivers and no cells.
    pub(crate) bounds: Option<[glam::Vec3; 2]>,
    /// The number of view cells of the tile, by the plan.
    pub(crate) cells: u64,
    pub(crate) cells_done: u64,
    pub(crate) samples: u64,
    pub(crate) millis: u64,
    pub(crate) workers: Vec<String>,
    pub(crate) failures: Vec<TileFailure>,
    pub(crate) conflicts: u32,
    /// True if other tiles use the samples of this tile.
    pub(crate) is_pack: bool,
}

/// A page of the tiles of a job.
pub(crate) struct Page {
    pub(crate) tiles: Vec<TileView>,
    /// The tile at which the next page starts. `None` if this page is the last.
    pub(crate) next: Option<TileIndex>,
    /// The total number of tiles of the job.
    pub(crate) total: u32,
}

/// Returns the states of all tiles of a job. Blocks on the disk if the job has ended.
pub(crate) fn statuses(c: &Coordinator, id: JobId) -> Result<Vec<TileStatus>, StoreError> {
    if let Some(live) = c.dispatcher.read(|scheduler| scheduler.tile_statuses(id)) {
        return Ok(live);
    }
    let status_of = |state: &TileState| match state {
        TileState::Open => TileStatus::Waiting,
        TileState::Done { .. } => TileStatus::Done,
        TileState::SetAside { .. } => TileStatus::SetAside,
    };
    Ok(c.records
        .tiles(id)?
        .iter()
        .map(|tile| status_of(&tile.state))
        .collect())
}

/// Returns at most `most` tiles of a job, starting at the tile `first`. If `states` is not empty, returns
/// only tiles in one of these states.
pub(crate) fn list(
    c: &Coordinator,
    id: JobId,
    first: TileIndex,
    most: usize,
    states: &[TileStatus],
) -> Result<Page, StoreError> {
    let record = c
        .records
        .job(id)?
        .ok_or(StoreError::UnknownJob { job: id })?;
    let records = c.records.tiles(id)?;
    let live = c
        .dispatcher
        .read(|scheduler| scheduler.live_tiles(id, 0..records.len()));
    let planned = stored_spec::without_viewpoints(&*c.blobs, &record.spec).ok();
    let planned = planned.filter(|job| job.plan().tiles.len() == records.len());
    let total = records.len() as u32;
    let (mut tiles, mut next) = (Vec::new(), None);
    for (at, record) in records.into_iter().enumerate().skip(first.at()) {
        if tiles.len() == most {
            next = Some(TileIndex(at as u32));
            break;
        }
        let live = live.as_ref().and_then(|live| live.get(at));
        let status = match (&record.state, live) {
            (TileState::Done { .. }, _) => TileStatus::Done,
            (TileState::SetAside { .. }, _) => TileStatus::SetAside,
            (TileState::Open, Some(live)) => live.status,
            (TileState::Open, None) => TileStatus::Waiting,
        };
        if !states.is_empty() && !states.contains(&status) {
            continue;
        }
        let mut view = TileView {
            tile: record.tile,
            status,
            bounds: None,
            cells: 0,
            cells_done: 0,
            samples: 0,
            millis: 0,
            workers: Vec::new(),
            failures: record.failures,
            conflicts: record.conflicts,
            is_pack: false,
        };
        if let Some(job) = &planned {
            let tile = &job.plan().tiles[at];
            view.bounds = job.lattice().map(|lattice| tile.cell.world(lattice).into());
            (view.cells, view.is_pack) = (tile.cells, tile.kind != TileKind::Leaf);
        }
        match (record.state, live) {
            (TileState::Done { stats, .. }, _) => {
                (view.cells_done, view.samples, view.millis) =
                    (stats.cells, stats.samples, stats.millis);
                view.workers.push(stats.worker);
                view.workers.extend(stats.helpers);
            }
            (_, Some(live)) => {
                (view.cells_done, view.samples) = (live.cells, live.samples);
                view.workers.clone_from(&live.workers);
            }
            _ => {}
        }
        tiles.push(view);
    }
    Ok(Page { tiles, next, total })
}
