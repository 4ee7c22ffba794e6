//! The exact part of a leaf tile: what sampling has shown of its cells is checked, and what it has not is asked about, first from the box
//! around several cells, then from each.

use std::ops::Range;
use std::time::{Duration, Instant};

use rayon::prelude::*;
use sightline_exact::cell::Cell;
use sightline_exact::evidence::{Above, Shared, codec};
use sightline_exact::{Effort, Limits, Occluders, Task, Together, decide, together};
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
    scene: &Occluders,
    (deadline, watcher): (Option<Instant>, &dyn Watcher),
) -> Result<(), String> {
    // Here and not on a thread of rayon's: finding the surfaces uses rayon itself, and a pool's thread that waits inside could take
    // up another cell and come back to the same lock.
    scene.surfaces();
    let (boxes, blocks) = boxes(root, &sets.nodes);
    // Half of the time for what is hidden from many cells at once: it saves each of them the question.
    let half = deadline.map(|d| Instant::now() + d.saturating_duration_since(Instant::now()) / 2);
    let around = blocks_first(spec, lattice, (&boxes, &blocks), sets, scene, (half, watcher))?;
    let one = |((set, at), around): ((&mut CellSet, &CellBox), &Around), until: Option<Instant>| {
        let stop = || watcher.cancelled() || until.is_some_and(|u| Instant::now() >= u);
        let done = cell(spec, lattice, (at, around), set, scene, &stop, watcher);
        watcher.cell_done();
        done
    };
    match deadline {
        None => {
            let work = sets.cells.par_iter_mut().zip(&boxes).zip(&around).with_max_len(1);
            work.try_for_each(|work| one(work, None))
        }
        // As many at a time as there are threads, with their share of what is left, so that no cell is left without any.
        Some(deadline) => {
            let mut work: Vec<_> = sets.cells.iter_mut().zip(&boxes).zip(&around).collect();
            let at_a_time = rayon::current_num_threads();
            let mut left = work.len().div_ceil(at_a_time) as u32;
            for some in work.chunks_mut(at_a_time) {
                let now = Instant::now();
                let share: Duration = deadline.saturating_duration_since(now) / left;
                left -= 1;
                some.par_iter_mut().with_max_len(1).try_for_each(|((set, at), around)| {
                    one(((&mut **set, *at), *around), Some(now + share))
                })?;
            }
            Ok(())
        }
    }
}

fn cell(
    spec: &JobSpec,
    lattice: &Lattice,
    (at, around): (&CellBox, &Around),
    set: &mut CellSet,
    scene: &Occluders,
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
    decided.effort.add_asked(&around.effort);
    decided.evidence.shared.clone_from(&around.shared);
    decided.evidence.above.clone_from(&around.above);
    let evidence = match spec.certificates {
        true => codec::encode(&decided.evidence).map_err(|e| e.to_string())?,
        false => Vec::new(),
    };
    set.visible = decided.visible;
    set.visible.extend(&decided.undecided);
    set.visible.sort_unstable();
    set.decision =
        Some(Decision { undecided: decided.undecided, counts: decided.effort.numbers().to_vec(), evidence });
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

/// Fewest cells that are worth a look at the box around them, and how many times fewer than in the last box there are in the next.
const BLOCK: usize = 4;
const STEP: usize = 8;

/// What is known about a cell from the boxes around it.
#[derive(Clone, Default)]
struct Around {
    /// The triangles hidden from them, ascending.
    hidden: Vec<u32>,
    /// Where the proofs are.
    above: Vec<Above>,
    /// The proofs themselves, and what was asked: with the first cell of each box.
    shared: Vec<Shared>,
    effort: Effort,
}

/// Finds out what is hidden from boxes around several cells, the largest first.
fn blocks_first(
    spec: &JobSpec,
    lattice: &Lattice,
    (boxes, blocks): (&[CellBox], &[(CellBox, Range<usize>)]),
    sets: &CellSets,
    scene: &Occluders,
    (until, watcher): (Option<Instant>, &dyn Watcher),
) -> Result<Vec<Around>, String> {
    let cells = boxes.iter().map(|at| exact_cell(at, lattice)).collect::<Result<Vec<_>, _>>()?;
    let seen: Vec<&[u32]> = sets.cells.iter().map(|set| set.visible.as_slice()).collect();
    let mut around = vec![Around::default(); boxes.len()];
    for (at, range) in blocks {
        let (hidden, shared, effort) = together(&Together {
            scene,
            cells: &cells[range.clone()],
            seen: &seen[range.clone()],
            above: &around[range.start].hidden,
            limits: limits(spec),
            seed: place(at, spec.seed),
            keep: spec.certificates,
            stop: &|| watcher.cancelled() || until.is_some_and(|u| Instant::now() >= u),
            asked: &|| watcher.rendered(1),
        });
        let first = &mut around[range.start];
        first.effort.add_asked(&effort);
        if hidden.is_empty() {
            continue;
        }
        let place = first.shared.len() as u32;
        if spec.certificates {
            first.shared.push(shared);
        }
        for k in range.clone() {
            let of = &mut around[k];
            of.hidden.extend(&hidden);
            of.hidden.sort_unstable();
            if spec.certificates {
                of.above.push(Above { back: (k - range.start) as u32, at: place });
            }
        }
    }
    Ok(around)
}

/// The boxes of a subtree's cells, in their order; and those around several that are to be looked at, each with its cells and none
/// before one that it lies in.
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
    let (mut cells, mut blocks) = (Vec::new(), Vec::new());
    // Each with the fewest cells that the next box within may have too many of.
    let mut waiting = vec![(*root, usize::MAX)];
    for (node, count) in nodes.iter().zip(below) {
        let Some((cell, most)) = waiting.pop() else { break };
        match node {
            Node::Split(split) => {
                let most = if count >= BLOCK && count <= most {
                    blocks.push((cell, cells.len()..cells.len() + count));
                    count / STEP
                } else {
                    most
                };
                let [below, above] = cell.children(*split);
                waiting.extend([(above, most), (below, most)]);
            }
            Node::Cell => cells.push(cell),
        }
    }
    (cells, blocks)
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
    fn boxes_around_many_cells_hold_them_and_come_before_those_within() {
        for (size, sizes) in [
            ([1, 1, 1], vec![]),
            ([3, 1, 1], vec![]),
            ([2, 2, 1], vec![4]),
            ([2, 2, 2], vec![8]),
            ([5, 1, 1], vec![5]),
            ([4, 4, 4], [vec![64], vec![8; 8]].concat()),
        ] {
            let (root, nodes) = grid(size);
            let (cells, blocks) = boxes(&root, &nodes);
            assert_eq!(cells.len(), size.iter().product::<u32>() as usize);
            assert_eq!(blocks.iter().map(|b| b.1.len()).collect::<Vec<_>>(), sizes, "{size:?}");
            for (at, range) in &blocks {
                let volume = |b: &CellBox| (0..3).map(|a| u64::from(b.hi[a] - b.lo[a])).product::<u64>();
                let within = |c: &CellBox| (0..3).all(|a| at.lo[a] <= c.lo[a] && c.hi[a] <= at.hi[a]);
                assert!(cells[range.clone()].iter().all(within));
                assert_eq!(volume(at), cells[range.clone()].iter().map(volume).sum::<u64>());
            }
        }
    }
}
