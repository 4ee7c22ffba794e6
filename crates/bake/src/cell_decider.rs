//! The exact part of a leaf tile: the decision about every triangle of every cell.
//!
//! The members of a crew share the cells, unless the job has a time budget. Each member computes the steps
//! before the cells itself. Triangles that sampling showed get a witness. The other triangles are targets of
//! exact queries, first from the box around a cell group, then from each cell.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::{CellCertificate, GroupCertificate, HiddenBox, codec};
use sightline_exact::{
    Cell, CellGroup as GroupTask, CellTask, ExactScene, ExactViewRegion, GroupDecisions,
    QueryStatistics, decide, decide_group,
};
use sightline_model::{CellSet, CellSets, Decision, DecisionStats};
use sightline_numbers::Aabb;
use sightline_portals::{Partition, sights};
use sightline_sample::Watcher;
use sightline_sample::crew::Crew;
use sightline_viewcells::{CellBox, Lattice};

use crate::cell_phase::{Undecided, decide_shared};
use crate::choices::{GROUP_SHARE, box_seed};
use crate::decide_pairs;
use crate::deciding::Deciding;
use crate::groups::{CellGroup, cells_and_groups};

/// The inputs of the decisions about the cells of a tile.
#[derive(Clone, Copy)]
pub struct CellDecider<'a> {
    /// The rules of the decisions, and the cells.
    pub deciding: &'a Deciding<'a>,
    /// The scene.
    pub scene: &'a ExactScene,
    /// The region of viewpoints; `None` if viewpoints are everywhere in the cells.
    pub region: Option<&'a dyn ExactViewRegion>,
    /// The partition of the scene by portals; `None` if the tile uses no portals.
    pub partition: Option<&'a Partition>,
    /// The watcher, which receives the progress and can cancel the work.
    pub watcher: &'a dyn Watcher,
}

/// Decides the cells of a tile whose subtree has the root `root`. `sets` contains the sampled sets and
/// receives the decided sets. Walls in the faces of open cells block.
///
/// # Errors
/// [`Undecided::Cancelled`] if the tile is cancelled; [`Undecided::Fault`] if a certificate cannot be encoded
/// or a cell has no volume.
pub fn cells(
    decider: CellDecider<'_>,
    root: &CellBox,
    sets: &mut CellSets,
    deadline: Option<Instant>,
    crew: &dyn Crew,
) -> Result<(), Undecided> {
    let CellDecider {
        deciding,
        scene,
        watcher,
        ..
    } = decider;
    let lattice = &deciding.scope.lattice;
    let (boxes, mut groups) = cells_and_groups(root, &sets.nodes);
    // Cells without viewpoints have no queries, so a group with such a cell has no common work.
    groups.retain(|group| {
        sets.cells[group.cells.clone()]
            .iter()
            .all(|cell| !cell.unreached)
    });
    let share = |d: Instant| d.saturating_duration_since(Instant::now()) / GROUP_SHARE;
    let half = deadline.map(|d| Instant::now() + share(d));
    let exact_cells: Vec<(CellBox, Cell)> = boxes
        .iter()
        .map(|at| Ok((*at, exact_cell(at, lattice)?)))
        .collect::<Result<_, String>>()?;
    let stop = || watcher.cancelled() || half.is_some_and(|u| Instant::now() >= u);
    let listed = all_listed(decider, &boxes, sets, &stop);
    let mut around = groups_first(decider, &boxes, &groups, sets, &listed, half)?;
    // Pairs of cells have the same share of the remaining time.
    let half = deadline.map(|d| Instant::now() + share(d));
    let stop = || watcher.cancelled() || half.is_some_and(|u| Instant::now() >= u);
    let apart = decide_pairs::decide(deciding, &exact_cells, sets, scene, &stop);
    around
        .iter_mut()
        .zip(apart)
        .for_each(|(around, apart)| around.apart = apart);
    around
        .iter_mut()
        .zip(listed)
        .for_each(|(around, listed)| around.listed = listed);
    let one =
        |set: &mut CellSet,
         at: &CellBox,
         around: &GroupContext,
         stop: &(dyn Fn() -> bool + Sync)| { cell(decider, at, around, set, stop) };
    match deadline {
        None => {
            let compute = |item: usize, is_needless: &(dyn Fn() -> bool + Sync)| {
                let mut set = sets.cells[item].clone();
                let stop = || watcher.cancelled() || is_needless();
                one(&mut set, &boxes[item], &around[item], &stop).map(|()| set)
            };
            sets.cells = decide_shared(
                crew,
                &sets.cells,
                scene.occluders().len() as u32,
                &compute,
                watcher,
            )?;
            Ok(())
        }
        // As many cells are decided at a time as there are threads. Each cell has a share of the remaining
        // time, so that every cell gets some time.
        Some(deadline) => {
            let mut work: Vec<_> = sets.cells.iter_mut().zip(&boxes).zip(&around).collect();
            let at_a_time = rayon::current_num_threads();
            let mut left = work.len().div_ceil(at_a_time) as u32;
            for some in work.chunks_mut(at_a_time) {
                let now = Instant::now();
                let share: Duration = deadline.saturating_duration_since(now) / left;
                left -= 1;
                let stop = || watcher.cancelled() || Instant::now() >= now + share;
                some.par_iter_mut()
                    .with_max_len(1)
                    .try_for_each(|((set, at), around)| {
                        let done = one(set, at, around, &stop);
                        watcher.cell_done();
                        done
                    })?;
            }
            Ok(())
        }
    }
}

/// Decides one cell.
fn cell(
    decider: CellDecider<'_>,
    at: &CellBox,
    around: &GroupContext,
    set: &mut CellSet,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(), String> {
    let CellDecider {
        deciding,
        scene,
        region,
        watcher,
        ..
    } = decider;
    let lattice = &deciding.scope.lattice;
    let apart = around.apart.clone();
    if set.unreached {
        // A cell without viewpoints has no queries about triangles.
        let certificate = match apart.is_empty() {
            true => Vec::new(),
            false => codec::encode(&CellCertificate {
                apart,
                ..CellCertificate::default()
            })
            .map_err(|e| e.to_string())?,
        };
        set.decision = Some(Decision {
            certificate,
            ..Decision::default()
        });
        return Ok(());
    }
    let mut decided = decide(&CellTask {
        scene,
        cell: exact_cell(at, lattice)?,
        region,
        seen: &set.visible,
        above: &around.hidden,
        listed: around.listed.as_deref(),
        limits: deciding.limits,
        seed: box_seed(at, deciding.scope.seed),
        keep: deciding.certificates,
        stop,
        asked: &|| watcher.rendered(1),
    });
    decided.statistics.add_asked(&around.statistics);
    decided.certificate.shared = around.shared.clone();
    decided.certificate.above = around.above;
    decided.certificate.apart = apart;
    let certificate = match deciding.certificates {
        true => codec::encode(&decided.certificate).map_err(|e| e.to_string())?,
        false => Vec::new(),
    };
    set.visible = decided.visible;
    set.visible.extend(&decided.undecided);
    set.visible.sort_unstable();
    if let Some(far) = deciding.far {
        let near = |id: &u32| is_within(scene, *id, at.world(lattice), far);
        set.visible.retain(near);
        decided.undecided.retain(near);
    }
    set.undecided = decided.undecided;
    set.decision = Some(Decision {
        counts: statistics(&decided.statistics).numbers().to_vec(),
        certificate,
    });
    Ok(())
}

/// Returns true if a triangle may be within a distance of a cell, by the triangle's bounding box.
///
/// The squares of differences of single-precision numbers have relative errors of a few units in the last
/// place of a double. The factor more than covers these errors.
pub fn is_within(scene: &ExactScene, id: u32, cell: (Vec3, Vec3), far: f64) -> bool {
    let (min, max) = cell;
    let bounds = Aabb::around(*scene.occluders().triangle(id));
    let apart = (0..3).map(|a| {
        let gap = f64::from(bounds.min[a]) - f64::from(max[a]);
        gap.max(f64::from(min[a]) - f64::from(bounds.max[a]))
            .max(0.0)
    });
    apart.map(|gap| gap * gap).sum::<f64>() <= far * far * (1.0 + 1e-12)
}

pub fn exact_cell(at: &CellBox, lattice: &Lattice) -> Result<Cell, String> {
    let (min, max) = at.world(lattice);
    Cell::new(min, max)
        .ok_or_else(|| format!("the cell {min} to {max} has no volume; give fewer or larger cells"))
}

/// The facts about a cell that are computed before the cell is decided, mostly from the box of its group.
#[derive(Default)]
struct GroupContext {
    /// The triangles hidden from the group's box, in ascending order; the same for all cells of the group.
    hidden: Arc<Vec<u32>>,
    /// The number of cells from the group's first cell to this cell. The first cell stores the group's
    /// certificate.
    above: Option<u32>,
    /// The group's certificate, only in the group's first cell.
    shared: Option<GroupCertificate>,
    /// The boxes around other cells that are hidden from the cell, with proofs.
    apart: Vec<HiddenBox>,
    /// The triangles that portals do not hide.
    listed: Option<Vec<u32>>,
    /// The statistics of the group's queries, only in the group's first cell.
    statistics: QueryStatistics,
}

/// Computes the triangles that portals do not hide from a closed or an open cell, in ascending order. Returns
/// `None` if `stop` ends the work.
pub fn listed(
    partition: &Partition,
    cell: (Vec3, Vec3),
    is_open: bool,
    stop: &dyn Fn() -> bool,
) -> Option<Vec<u32>> {
    sights(partition, Aabb::new(cell.0, cell.1), is_open, stop)
}

/// Computes the triangles that portals do not hide from each cell. A list is `None` if the tile has no
/// partition, the cell has no viewpoint, or `stop` ended the work.
fn all_listed(
    decider: CellDecider<'_>,
    boxes: &[CellBox],
    sets: &CellSets,
    stop: &(dyn Fn() -> bool + Sync),
) -> Vec<Option<Vec<u32>>> {
    let scope = decider.deciding.scope;
    let one = |(at, set): (&CellBox, &CellSet)| {
        let partition = decider.partition.filter(|_| !set.unreached)?;
        listed(partition, at.world(&scope.lattice), scope.is_open, stop)
    };
    boxes.par_iter().zip(&sets.cells).map(one).collect()
}

/// Finds the triangles that are hidden from the box around each cell group.
fn groups_first(
    decider: CellDecider<'_>,
    cells: &[CellBox],
    groups: &[CellGroup],
    sets: &CellSets,
    listed: &[Option<Vec<u32>>],
    until: Option<Instant>,
) -> Result<Vec<GroupContext>, String> {
    let CellDecider {
        deciding,
        scene,
        region,
        watcher,
        ..
    } = decider;
    let cells = cells
        .iter()
        .map(|at| exact_cell(at, &deciding.scope.lattice))
        .collect::<Result<Vec<_>, _>>()?;
    let seen: Vec<&[u32]> = sets
        .cells
        .iter()
        .map(|set| set.visible.as_slice())
        .collect();
    let mut around: Vec<GroupContext> = cells.iter().map(|_| GroupContext::default()).collect();
    for CellGroup {
        around: at,
        cells: range,
    } in groups
    {
        let GroupDecisions {
            hidden,
            shared,
            statistics,
        } = decide_group(&GroupTask {
            scene,
            cells: &cells[range.clone()],
            region,
            seen: &seen[range.clone()],
            listed: listed.get(range.clone()).unwrap_or_default(),
            limits: deciding.limits,
            seed: box_seed(at, deciding.scope.seed),
            keep: deciding.certificates,
            stop: &|| watcher.cancelled() || until.is_some_and(|u| Instant::now() >= u),
            asked: &|| watcher.rendered(1),
        });
        around[range.start].statistics = statistics;
        if hidden.is_empty() {
            continue;
        }
        let hidden = Arc::new(hidden);
        for k in range.clone() {
            around[k].hidden = Arc::clone(&hidden);
            around[k].above = deciding.certificates.then_some((k - range.start) as u32);
        }
        around[range.start].shared = deciding.certificates.then_some(shared);
    }
    Ok(around)
}

/// Converts the statistics of a decided cell to the columns of a result.
pub fn statistics(taken: &QueryStatistics) -> DecisionStats {
    let QueryStatistics {
        rays,
        queries,
        boxes,
        enclosed,
        hidden,
        above,
        missed,
        refuted,
        open,
        cost,
    } = *taken;
    let [
        undecided_stopped,
        undecided_regions,
        undecided_memory,
        undecided_divisions,
    ] = open;
    DecisionStats {
        rays,
        queries,
        boxes,
        enclosed,
        hidden,
        missed,
        refuted,
        undecided_stopped,
        undecided_regions,
        undecided_memory,
        undecided_divisions,
        regions: cost.regions,
        lines: cost.lines,
        occluders: cost.occluders,
        signs_filtered: cost.decisions.filtered,
        signs_refined: cost.decisions.refined,
        signs_spanned: cost.decisions.spanned,
        signs_exact: cost.decisions.exact,
        vectors: cost.vectors,
        above,
    }
}
