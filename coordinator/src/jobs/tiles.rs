//! The tiles of a job, as people see them: where they are, how they stand, and what they cost.

use sightline_records::ids::{JobId, TileIndex};
use sightline_records::{TileFailure, TileState};
use sightline_scheduler::TileStatus;
use sightline_store::StoreError;
use sightline_viewcells::TileKind;

use crate::jobs::stored_spec;
use crate::state::Coordinator;

/// A tile of a job.
#[derive(Clone, Debug)]
pub(crate) struct TileView {
    pub(crate) tile: TileIndex,
    pub(crate) standing: TileStatus,
    /// Its part of the view box, in world space; `None` if another version of the program planned the job, or
    /// if it has receivers and no cells.
    pub(crate) bounds: Option<[glam::Vec3; 2]>,
    /// View cells by the plan.
    pub(crate) cells: u64,
    pub(crate) cells_done: u64,
    pub(crate) samples: u64,
    pub(crate) millis: u64,
    pub(crate) workers: Vec<String>,
    pub(crate) failures: Vec<TileFailure>,
    pub(crate) conflicts: u32,
    /// Whether it yields samples for other tiles.
    pub(crate) is_pack: bool,
}

/// Some tiles of a job.
pub(crate) struct Page {
    pub(crate) tiles: Vec<TileView>,
    /// The first tile that was not looked at, if there is one.
    pub(crate) next: Option<TileIndex>,
    /// Tiles of the job.
    pub(crate) total: u32,
}

/// How all tiles of a job stand. Blocks on the disk for one that has ended.
pub(crate) fn standings(c: &Coordinator, id: JobId) -> Result<Vec<TileStatus>, StoreError> {
    if let Some(live) = c.lock().scheduler.standings(id) {
        return Ok(live);
    }
    let status_of = |state: &TileState| match state {
        TileState::Open => TileStatus::Waiting,
        TileState::Done { .. } => TileStatus::Done,
        TileState::SetAside { .. } => TileStatus::SetAside,
    };
    Ok(c.store
        .tiles(id)?
        .iter()
        .map(|tile| status_of(&tile.state))
        .collect())
}

/// At most `most` tiles of a job from `first` on, of those in one of these states, or of all.
pub(crate) fn list(
    c: &Coordinator,
    id: JobId,
    first: TileIndex,
    most: usize,
    wanted: &[TileStatus],
) -> Result<Page, StoreError> {
    let record = c.store.job(id)?.ok_or(StoreError::UnknownJob { job: id })?;
    let records = c.store.tiles(id)?;
    let live = c.lock().scheduler.live_tiles(id, 0..records.len());
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
        let standing = match (&record.state, live) {
            (TileState::Done { .. }, _) => TileStatus::Done,
            (TileState::SetAside { .. }, _) => TileStatus::SetAside,
            (TileState::Open, Some(live)) => live.standing,
            (TileState::Open, None) => TileStatus::Waiting,
        };
        if !wanted.is_empty() && !wanted.contains(&standing) {
            continue;
        }
        let mut view = TileView {
            tile: record.tile,
            standing,
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
