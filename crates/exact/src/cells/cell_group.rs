//! Cell groups: the triangles hidden from a box around several cells, decided once for all of the cells.
//!
//! Enlarging a cell never hides a triangle, so a triangle hidden from the box is hidden from every cell in
//! it. For a triangle visible from the box, the search must query each cell again. So the group search
//! queries only triangles that no cell is known to see and that are not known to be hidden from all cells.

use rayon::prelude::*;
use sightline_certificate::GroupCertificate;
use sightline_numbers::Aabb;

use crate::cells::exact_scene::ExactScene;
use crate::cells::sources::ExactViewRegion;
use crate::cells::statistics::QueryStatistics;
use crate::cells::task::CellTask;
use crate::cells::work::{CellWork, TriangleState};
use crate::geometry::Cell;
use crate::search::QueryLimits;

/// A group of cells, and the parameters of the search for their common hidden triangles.
pub struct CellGroup<'a> {
    /// The prepared scene.
    pub scene: &'a ExactScene,
    /// The cells of the group, which together fill a box.
    pub cells: &'a [Cell],
    /// The part of space that contains viewpoints; `None` for all space.
    pub region: Option<&'a dyn ExactViewRegion>,
    /// For each cell, the triangles that sampling has shown, in ascending order.
    pub seen: &'a [&'a [u32]],
    /// For each cell, the value of [`CellTask::listed`]; an empty slice if no cell has one.
    pub listed: &'a [Option<Vec<u32>>],
    /// The limits of a single query.
    pub limits: QueryLimits,
    /// The seed of the rays.
    pub seed: u64,
    /// True if the result contains the proofs.
    pub keep: bool,
    /// The stop callback, called before every region of every query. If it returns true, the search ends with
    /// the results so far.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// The progress callback, called after every query.
    pub asked: &'a (dyn Fn() + Sync),
}

/// The decisions about a group of cells.
#[derive(Debug, PartialEq)]
pub struct GroupDecisions {
    /// The triangles hidden from the box around the cells, in ascending order.
    pub hidden: Vec<u32>,
    /// The box around the cells, and the proofs if [`CellGroup::keep`] is true.
    pub shared: GroupCertificate,
    /// The work done for the group.
    pub statistics: QueryStatistics,
}

/// Searches for the triangles that are hidden from the box around the cells.
pub fn decide_group(task: &CellGroup<'_>) -> GroupDecisions {
    let bounds = task
        .cells
        .iter()
        .fold(Aabb::EMPTY, |all: Aabb, cell| all.union(cell.bounds()));
    let nothing = |statistics| GroupDecisions {
        hidden: Vec::new(),
        shared: GroupCertificate {
            bounds,
            hidden: Vec::new(),
        },
        statistics,
    };
    let Some(cell) = Cell::new(bounds.min, bounds.max) else {
        return nothing(QueryStatistics::default());
    };
    let whole = CellTask {
        scene: task.scene,
        cell,
        region: task.region,
        seen: &[],
        above: &[],
        listed: None,
        limits: task.limits,
        seed: task.seed,
        keep: task.keep,
        stop: task.stop,
        asked: task.asked,
    };
    let mut work = CellWork::new(&whole);
    if task.scene.occluders().targets().is_empty() || (task.stop)() {
        return nothing(QueryStatistics::default());
    }
    work.meeting();
    // Compute the states before any query for a few cells at a time. A large scene has many triangles and a
    // tile may have many cells, so all states together would need much memory.
    let mut seen_by_any = vec![false; work.state.len()];
    let mut hidden_from = vec![0; work.state.len()];
    let listed = task
        .listed
        .iter()
        .map(Option::as_deref)
        .chain(std::iter::repeat(None));
    let pairs: Vec<_> = task.cells.iter().zip(task.seen).zip(listed).collect();
    for some in pairs.chunks(rayon::current_num_threads()) {
        if (task.stop)() {
            return nothing(QueryStatistics::default());
        }
        let known: Vec<Vec<TriangleState>> = some
            .par_iter()
            .map(|((cell, seen), listed)| before_asking(&whole, **cell, seen, *listed))
            .collect();
        let counts = seen_by_any.par_iter_mut().zip(&mut hidden_from).enumerate();
        counts.for_each(|(id, (seen, hidden))| {
            *seen |= known.iter().any(|cell| cell[id] == TriangleState::Visible);
            *hidden += known
                .iter()
                .filter(|cell| cell[id] == TriangleState::Hidden)
                .count();
        });
    }
    for (id, state) in work
        .state
        .iter_mut()
        .enumerate()
        .filter(|(_, state)| **state == TriangleState::Open)
    {
        if seen_by_any[id] {
            *state = TriangleState::Visible;
        } else if hidden_from[id] == task.cells.len() {
            *state = TriangleState::Hidden;
        }
    }
    let before = work.state.clone();
    work.search();
    let found = |id: &u32| {
        let at = *id as usize;
        work.state[at] == TriangleState::Hidden && before[at] == TriangleState::Open
    };
    let hidden = (0..before.len() as u32).filter(found).collect();
    let shared = GroupCertificate {
        bounds,
        hidden: std::mem::take(&mut work.decided.certificate.hidden),
    };
    GroupDecisions {
        hidden,
        shared,
        statistics: work.decided.statistics,
    }
}

/// Computes the states that the triangles have for one of the cells before any query.
///
/// Triangles that sampling has shown count as visible.
fn before_asking(
    whole: &CellTask<'_>,
    cell: Cell,
    seen: &[u32],
    listed: Option<&[u32]>,
) -> Vec<TriangleState> {
    let own = CellTask {
        cell,
        seen,
        listed,
        keep: false,
        ..*whole
    };
    let mut work = CellWork::new(&own);
    work.meeting();
    work.keep_to_listed();
    work.enclose();
    let mut state = work.state;
    for id in seen {
        let triangle_state = &mut state[*id as usize];
        if *triangle_state == TriangleState::Open {
            *triangle_state = TriangleState::Visible;
        }
    }
    state
}
