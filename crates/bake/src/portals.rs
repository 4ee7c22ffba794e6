//! A tile of the method portals: triangles that portals do not hide have a witness or are undecided.
//!
//! No tracer is used. The computation only adds, multiplies and divides doubles and extracts square roots.
//! These operations have the same result on every machine, so the bytes depend only on the specification and
//! the scene.

use std::time::Instant;

use rayon::prelude::*;
use sightline_exact::{CellTask, decide_listed};
use sightline_model::{
    CellSet, CellSets, Decision, Effort, PlannedJob, SubtreeNode, TileOutput, Visibility, codec,
};
use sightline_portals::{NoPartition, OpenFaces, Partition, table};
use sightline_pvs::Portals;
use sightline_scene::Scene;
use sightline_viewcells::{CellBox, TileIndex};

use crate::cell_decider::{exact_cell, is_within, listed, statistics};
use crate::cell_phase::decide_shared;
use crate::choices::{box_seed, exact_limits};
use crate::groups::cells_and_groups;
use crate::job_region::JobRegion;
use crate::outcome::{BakeError, Control, TileDone, tile_error};
use crate::scene::BakeScene;
use crate::scope::TileScope;

/// Computes tile `number` of a job of the method portals.
///
/// # Errors
/// [`BakeError::Cancelled`] if the watcher cancels the tile; [`BakeError::Tile`] if the tile cannot be
/// computed.
///
/// # Panics
/// Panics on a thread of rayon's pool, because the thread could wait for itself.
pub fn run(
    job: &PlannedJob,
    task: &Visibility,
    number: TileIndex,
    scene: &BakeScene,
    control: Control<'_>,
) -> Result<TileDone, BakeError> {
    let scope = TileScope::new(job, task, number)?;
    let (tile, lattice) = (&scope.tile, &scope.lattice);
    let job_region =
        JobRegion::from_viewpoints(task.viewpoints(), scene.scene()).map_err(tile_error)?;
    let sets = empty_cells(&scope);
    let (boxes, _) = cells_and_groups(&tile.cell, &sets.nodes);
    let watcher = control.watcher;
    let late = || control.deadline.is_some_and(|end| Instant::now() >= end);
    let partition = match scene.partition(task, &|| watcher.cancelled() || late()) {
        // Triangles for which the time did not suffice may be visible.
        Err(NoPartition::Stopped) => None,
        made => Some(made.map_err(tile_error)?),
    };
    let exact = scene.exact().map_err(BakeError::Tile)?;
    let region = job_region.as_ref().map(JobRegion::exact);
    let faces = scope
        .is_open
        .then(|| OpenFaces::new(scene.scene(), scope.view_box, region));
    let region = faces.as_ref().map(|faces| faces as _).or(region);
    let compute = |item: usize, stop: &(dyn Fn() -> bool + Sync)| -> Result<CellSet, String> {
        let mut set = sets.cells[item].clone();
        if set.unreached {
            set.decision = Some(Decision::default());
            return Ok(set);
        }
        let world = boxes[item].world(lattice);
        let all = || (0..scene.scene().len()).collect();
        let found = partition
            .as_ref()
            .and_then(|p| listed(p, world, scope.is_open, stop))
            .unwrap_or_else(all);
        let decided = decide_listed(&CellTask {
            scene: exact,
            cell: exact_cell(&boxes[item], lattice)?,
            region,
            seen: &[],
            above: &[],
            listed: Some(&found),
            limits: exact_limits(Effort::Full),
            seed: box_seed(&boxes[item], scope.seed),
            keep: false,
            stop,
            asked: &|| {},
        });
        watcher.rendered(decided.statistics.rays);
        let mut undecided = decided.undecided;
        set.visible = decided.visible;
        set.visible.extend(&undecided);
        set.visible.sort_unstable();
        if let Some(far) = task.far {
            let near = |id: &u32| is_within(exact, *id, world, far.get());
            set.visible.retain(near);
            undecided.retain(near);
        }
        let counts = statistics(&decided.statistics).numbers().to_vec();
        set.undecided = undecided;
        set.decision = Some(Decision {
            counts,
            ..Decision::default()
        });
        Ok(set)
    };
    let cells = match control.deadline {
        None => {
            let compute = |item: usize, is_needless: &(dyn Fn() -> bool + Sync)| {
                compute(item, &|| watcher.cancelled() || is_needless())
            };
            decide_shared(
                control.crew,
                &sets.cells,
                scene.scene().len(),
                &compute,
                watcher,
            )?
        }
        Some(deadline) => {
            let stop = || watcher.cancelled() || Instant::now() >= deadline;
            let one = |item: usize| {
                let cell = compute(item, &stop);
                watcher.cell_done();
                cell
            };
            let cells = (0..boxes.len()).into_par_iter().with_max_len(1).map(one);
            cells
                .collect::<Result<Vec<_>, _>>()
                .map_err(BakeError::Tile)?
        }
    };
    if watcher.cancelled() {
        return Err(BakeError::Cancelled);
    }
    if control.deadline.is_none() {
        control.crew.end()?;
    }
    let rays = |cell: &CellSet| cell.decision.as_ref().map_or(0, Decision::rays);
    let samples = cells.iter().map(rays).sum();
    // Only the first tile has the portals, so that the result contains the portals once.
    let portals = if number == TileIndex(0) {
        encoded(partition.as_deref(), scene.scene())
    } else {
        Vec::new()
    };
    let output = TileOutput::Cells(CellSets {
        cells,
        portals,
        ..sets
    });
    let bytes = codec::encode(&output).map_err(tile_error)?;
    Ok(TileDone {
        bytes,
        samples,
        recomputed: Vec::new(),
    })
}

/// Encodes the scene's division along its walls for the result. Without a partition, the scene is one leaf.
pub fn encoded(partition: Option<&Partition>, scene: &Scene) -> Vec<u8> {
    partition
        .map_or_else(|| Portals::undivided(scene.len()), table)
        .encode()
}

/// Returns the cells of a tile with empty sets. Cells without viewpoints are marked as unreached.
fn empty_cells(scope: &TileScope) -> CellSets {
    let mut sets = CellSets::default();
    let mut open: Vec<(CellBox, u32)> = vec![(scope.tile.cell, scope.tile.depth)];
    while let Some((at, depth)) = open.pop() {
        match scope.division.split(&scope.lattice, &at, depth) {
            Some(split) => {
                sets.nodes.push(SubtreeNode::Split(split));
                let [below, above] = at.children(split);
                open.extend([(above, depth + 1), (below, depth + 1)]);
            }
            None => {
                sets.nodes.push(SubtreeNode::Cell);
                let unreached = scope.marks(&at) == 0;
                sets.cells.push(CellSet {
                    unreached,
                    ..CellSet::default()
                });
            }
        }
    }
    sets
}
