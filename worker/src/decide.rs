//! The exact part of a leaf tile: what sampling has shown of its cells is checked, and what it has not is asked about, first from the box
//! around several cells, then from each.

use std::ops::{Range, RangeInclusive};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rayon::prelude::*;
use sightline_exact::evidence::{Shared, codec};
use sightline_exact::{
    Cell, CellGroup, ExactScene, GroupDecided, Limits, QueryStatistics, Task, decide, decide_group,
};
use sightline_job::{JobSpec, Method};
use sightline_sampling::tile::{CellSet, CellSets, Decision, Node, Watcher};
use sightline_viewcells::{CellBox, Lattice};

/// The part of a time budget that sampling may take: it is fast, and queries about what it would still find are not.
const SAMPLING_SHARE: u32 = 4;

/// When a single query of [`Method::Verified`] gives up: far above what nearly all take, far below what the hardest do.
const QUICK: Limits = Limits { regions: 1000, vectors: 100_000, splits: 32, divisions: 6 };

/// When sampling has to be done for there to be time for queries.
pub fn sampling_deadline(method: Method, deadline: Option<Instant>) -> Option<Instant> {
    let now = Instant::now();
    match (method, deadline) {
        (Method::Aggressive, deadline) => deadline,
        (_, deadline) => deadline.map(|d| now + d.saturating_duration_since(now) / SAMPLING_SHARE),
    }
}

/// Watches the sampling of a tile whose cells are not done when they are sampled.
pub struct Sampling<'a>(pub &'a dyn Watcher);

impl Watcher for Sampling<'_> {
    fn rendered(&self, samples: u64) {
        self.0.rendered(samples);
    }
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Decides the cells of a tile.
///
/// # Errors
/// What the evidence's codec reports, and cells that cannot be decided because they have no volume.
pub fn cells(
    spec: &JobSpec,
    lattice: &Lattice,
    root: &CellBox,
    sets: &mut CellSets,
    scene: &ExactScene,
    (deadline, watcher): (Option<Instant>, &dyn Watcher),
) -> Result<(), String> {
    let (boxes, groups) = boxes(root, &sets.nodes);
    // Half of the time for what is hidden from many cells at once: it saves each of them the question.
    let half = deadline.map(|d| Instant::now() + d.saturating_duration_since(Instant::now()) / 2);
    let mut around = boxes_first(spec, lattice, (&boxes, &groups), sets, scene, (half, watcher))?;
    let one = |((set, at), around): ((&mut CellSet, &CellBox), &mut Around), until: Option<Instant>| {
        let stop = || watcher.cancelled() || until.is_some_and(|u| Instant::now() >= u);
        let done = cell(spec, lattice, (at, around), set, scene, &stop, watcher);
        watcher.cell_done();
        done
    };
    match deadline {
        None => {
            let work = sets.cells.par_iter_mut().zip(&boxes).zip(&mut around).with_max_len(1);
            work.try_for_each(|work| one(work, None))
        }
        // As many at a time as there are threads, with their share of what is left, so that no cell is left without any.
        Some(deadline) => {
            let mut work: Vec<_> = sets.cells.iter_mut().zip(&boxes).zip(&mut around).collect();
            let at_a_time = rayon::current_num_threads();
            let mut left = work.len().div_ceil(at_a_time) as u32;
            for some in work.chunks_mut(at_a_time) {
                let now = Instant::now();
                let share: Duration = deadline.saturating_duration_since(now) / left;
                left -= 1;
                some.par_iter_mut().with_max_len(1).try_for_each(|((set, at), around)| {
                    one(((&mut **set, *at), &mut **around), Some(now + share))
                })?;
            }
            Ok(())
        }
    }
}

fn cell(
    spec: &JobSpec,
    lattice: &Lattice,
    (at, around): (&CellBox, &mut Around),
    set: &mut CellSet,
    scene: &ExactScene,
    stop: &(dyn Fn() -> bool + Sync),
    watcher: &dyn Watcher,
) -> Result<(), String> {
    let mut decided = decide(&Task {
        scene,
        cell: exact_cell(at, lattice)?,
        seen: &set.visible,
        above: &around.hidden,
        limits: limits(spec),
        seed: place(at, spec.seed),
        keep: spec.certificates,
        stop,
        asked: &|| watcher.rendered(1),
    });
    decided.statistics.add_asked(&around.statistics);
    decided.evidence.shared = around.shared.take();
    decided.evidence.above = around.above;
    let evidence = match spec.certificates {
        true => codec::encode(&decided.evidence).map_err(|e| e.to_string())?,
        false => Vec::new(),
    };
    set.visible = decided.visible;
    set.visible.extend(&decided.undecided);
    set.visible.sort_unstable();
    set.decision = Some(Decision {
        undecided: decided.undecided,
        counts: decided.statistics.numbers().to_vec(),
        evidence,
    });
    Ok(())
}

fn limits(spec: &JobSpec) -> Limits {
    if spec.method == Method::Verified { QUICK } else { Limits::default() }
}

/// A seed of its own for every box.
fn place(at: &CellBox, seed: u64) -> u64 {
    let corners = at.lo.iter().chain(&at.hi);
    corners.fold(seed, |h, c| h.wrapping_mul(0x0100_0000_01b3) ^ u64::from(*c))
}

fn exact_cell(at: &CellBox, lattice: &Lattice) -> Result<Cell, String> {
    let (min, max) = at.world(lattice);
    Cell::new(min, max)
        .ok_or_else(|| format!("the cell {min} to {max} has no volume; give fewer or larger cells"))
}

/// How many cells a box is asked about for: fewer do not win what the box takes, and for more it wins nothing more.
const TOGETHER: RangeInclusive<usize> = 4..=8;

/// What is known about a cell from the box around it and others.
#[derive(Default)]
struct Around {
    /// The triangles hidden from it, ascending; the same for all cells in it.
    hidden: Arc<Vec<u32>>,
    /// How many cells before this one the proofs are kept.
    above: Option<u32>,
    /// The proofs, and what was asked: with the first of the cells.
    shared: Option<Shared>,
    statistics: QueryStatistics,
}

/// Finds out what is hidden from boxes around several cells.
fn boxes_first(
    spec: &JobSpec,
    lattice: &Lattice,
    (cells, groups): (&[CellBox], &[(CellBox, Range<usize>)]),
    sets: &CellSets,
    scene: &ExactScene,
    (until, watcher): (Option<Instant>, &dyn Watcher),
) -> Result<Vec<Around>, String> {
    let cells = cells.iter().map(|at| exact_cell(at, lattice)).collect::<Result<Vec<_>, _>>()?;
    let seen: Vec<&[u32]> = sets.cells.iter().map(|set| set.visible.as_slice()).collect();
    let mut around: Vec<Around> = cells.iter().map(|_| Around::default()).collect();
    for (at, range) in groups {
        let GroupDecided { hidden, shared, statistics } = decide_group(&CellGroup {
            scene,
            cells: &cells[range.clone()],
            seen: &seen[range.clone()],
            limits: limits(spec),
            seed: place(at, spec.seed),
            keep: spec.certificates,
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
            around[k].above = spec.certificates.then_some((k - range.start) as u32);
        }
        around[range.start].shared = spec.certificates.then_some(shared);
    }
    Ok(around)
}

/// The boxes of a subtree's cells, in their order; and the largest boxes around no more of them than are worth it, each with its cells.
fn boxes(root: &CellBox, nodes: &[Node]) -> (Vec<CellBox>, Vec<(CellBox, Range<usize>)>) {
    // How many cells are below each node, counted from the last.
    let mut below = vec![1; nodes.len()];
    let mut open: Vec<usize> = Vec::new();
    for (i, node) in nodes.iter().enumerate().rev() {
        if let Node::Split(_) = node {
            let both = open.pop().unwrap_or(0) + open.pop().unwrap_or(0);
            below[i] = both;
        }
        open.push(below[i]);
    }
    let (mut cells, mut groups) = (Vec::new(), Vec::<(CellBox, Range<usize>)>::new());
    let mut waiting = vec![*root];
    for (node, count) in nodes.iter().zip(below) {
        let Some(cell) = waiting.pop() else { break };
        let within = groups.last().is_some_and(|(_, range)| range.contains(&cells.len()));
        if !within && TOGETHER.contains(&count) {
            groups.push((cell, cells.len()..cells.len() + count));
        }
        match node {
            Node::Split(split) => {
                let [below, above] = cell.children(*split);
                waiting.extend([above, below]);
            }
            Node::Cell => cells.push(cell),
        }
    }
    (cells, groups)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_viewcells::Division;

    use super::*;

    /// The subtree of a grid in preorder.
    fn grid(cells: [u32; 3]) -> (CellBox, Vec<Node>) {
        let division = Division::Grid(cells);
        let lattice = division.lattice(Vec3::ZERO, Vec3::ONE).unwrap();
        let root = division.root(&lattice);
        let (mut nodes, mut waiting) = (Vec::new(), vec![(root, 0)]);
        while let Some((cell, depth)) = waiting.pop() {
            match division.split(&lattice, &cell, depth) {
                Some(split) => {
                    nodes.push(Node::Split(split));
                    let [below, above] = cell.children(split);
                    waiting.extend([(above, depth + 1), (below, depth + 1)]);
                }
                None => nodes.push(Node::Cell),
            }
        }
        (root, nodes)
    }

    #[test]
    fn boxes_around_some_cells_hold_them_and_do_not_overlap() {
        for (size, sizes) in [
            ([1, 1, 1], vec![]),
            ([3, 1, 1], vec![]),
            ([2, 2, 1], vec![4]),
            ([2, 2, 2], vec![8]),
            ([5, 1, 1], vec![5]),
            ([4, 4, 2], vec![8; 4]),
            ([4, 4, 4], vec![8; 8]),
            ([9, 1, 1], vec![4, 5]),
        ] {
            let (root, nodes) = grid(size);
            let (cells, groups) = boxes(&root, &nodes);
            assert_eq!(cells.len(), size.iter().product::<u32>() as usize);
            assert_eq!(groups.iter().map(|b| b.1.len()).collect::<Vec<_>>(), sizes, "{size:?}");
            assert!(groups.windows(2).all(|w| w[0].1.end <= w[1].1.start));
            for (at, range) in &groups {
                let volume = |b: &CellBox| (0..3).map(|a| u64::from(b.hi[a] - b.lo[a])).product::<u64>();
                let within = |c: &CellBox| (0..3).all(|a| at.lo[a] <= c.lo[a] && c.hi[a] <= at.hi[a]);
                assert!(cells[range.clone()].iter().all(within));
                assert_eq!(volume(at), cells[range.clone()].iter().map(volume).sum::<u64>());
            }
        }
    }
}
