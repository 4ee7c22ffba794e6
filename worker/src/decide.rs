//! The exact part of a leaf tile: what sampling has shown of its cells is checked, and what it has not is asked about.

use std::time::{Duration, Instant};

use rayon::prelude::*;
use sightline_exact::cell::Cell;
use sightline_exact::evidence::codec;
use sightline_exact::{Limits, Occluders, Task, decide};
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
    let boxes = boxes(root, &sets.nodes);
    let one = |(set, at): (&mut CellSet, &CellBox), until: Option<Instant>| {
        let stop = || watcher.cancelled() || until.is_some_and(|u| Instant::now() >= u);
        let done = cell(spec, lattice, at, set, scene, &stop, watcher);
        watcher.cell_done();
        done
    };
    match deadline {
        None => sets.cells.par_iter_mut().zip(&boxes).with_max_len(1).try_for_each(|work| one(work, None)),
        // As many at a time as there are threads, with their share of what is left, so that no cell is left without any.
        Some(deadline) => {
            let mut work: Vec<_> = sets.cells.iter_mut().zip(&boxes).collect();
            let at_a_time = rayon::current_num_threads();
            let mut left = work.len().div_ceil(at_a_time) as u32;
            for some in work.chunks_mut(at_a_time) {
                let now = Instant::now();
                let share: Duration = deadline.saturating_duration_since(now) / left;
                left -= 1;
                some.par_iter_mut()
                    .with_max_len(1)
                    .try_for_each(|(set, at)| one((&mut **set, *at), Some(now + share)))?;
            }
            Ok(())
        }
    }
}

fn cell(
    spec: &JobSpec,
    lattice: &Lattice,
    at: &CellBox,
    set: &mut CellSet,
    scene: &Occluders,
    stop: &(dyn Fn() -> bool + Sync),
    watcher: &dyn Watcher,
) -> Result<(), String> {
    let (min, max) = at.world(lattice);
    let cell = Cell::new(min, max)
        .ok_or_else(|| format!("the cell {min} to {max} has no volume; give fewer or larger cells"))?;
    let place = at.lo.iter().fold(spec.seed, |h, c| h.wrapping_mul(0x0100_0000_01b3) ^ u64::from(*c));
    let decided = decide(&Task {
        scene,
        cell,
        seen: &set.visible,
        limits: if spec.method == Method::Verified { QUICK } else { Limits::default() },
        seed: place,
        keep: spec.certificates,
        stop,
        asked: &|| watcher.rendered(1),
    });
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

/// The boxes of a subtree's cells, in their order.
fn boxes(root: &CellBox, nodes: &[Node]) -> Vec<CellBox> {
    let mut out = Vec::new();
    let mut waiting = vec![*root];
    for node in nodes {
        let Some(cell) = waiting.pop() else { break };
        match node {
            Node::Split(split) => {
                let [below, above] = cell.children(*split);
                waiting.extend([above, below]);
            }
            Node::Cell => out.push(cell),
        }
    }
    out
}
