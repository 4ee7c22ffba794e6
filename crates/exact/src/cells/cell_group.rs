//! Cell groups: the triangles hidden from a box around several cells, decided once for all of them.
//!
//! Enlarging a cell never hides a triangle, so a triangle hidden from the box is hidden from every cell in
//! it. A triangle seen from the box is queried again from each cell. So triangles that some cell is known to
//! see, and triangles that all cells are known not to see, are not queried from the box.

use rayon::prelude::*;
use sightline_certificate::GroupCertificate;
use sightline_numbers::Aabb;

use crate::cells::exact_scene::ExactScene;
use crate::cells::sources::ExactViewRegion;
use crate::cells::statistics::QueryStatistics;
use crate::cells::task::Task;
use crate::cells::work::{State, Work};
use crate::geometry::Cell;
use crate::search::Limits;

/// A group of cells whose common hidden triangles are to be found.
pub struct CellGroup<'a> {
    /// The prepared scene.
    pub scene: &'a ExactScene,
    /// The cells, which fill a box.
    pub cells: &'a [Cell],
    /// Where in space viewpoints are; `None` for everywhere.
    pub places: Option<&'a dyn ExactViewRegion>,
    /// For each cell, triangles that sampling has shown, ascending.
    pub seen: &'a [&'a [u32]],
    /// For each cell, [`Task::listed`]; empty for none.
    pub listed: &'a [Option<Vec<u32>>],
    /// The limits of a single query.
    pub limits: Limits,
    /// Seed of the rays.
    pub seed: u64,
    /// Whether to keep proofs.
    pub keep: bool,
    /// Called before every region of every query: whether to stop with the results so far.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called after every query.
    pub asked: &'a (dyn Fn() + Sync),
}

/// The decisions about a group of cells.
#[derive(Debug, PartialEq)]
pub struct GroupDecided {
    /// Triangles hidden from the box around the cells, ascending.
    pub hidden: Vec<u32>,
    /// The box, and the proofs if they are kept.
    pub shared: GroupCertificate,
    /// Work done.
    pub statistics: QueryStatistics,
}

/// The triangles proved hidden from the box around the cells, ascending; with the proofs, if they are kept,
/// and the query statistics.
pub fn decide_group(task: &CellGroup<'_>) -> GroupDecided {
    let bounds = task
        .cells
        .iter()
        .fold(Aabb::EMPTY, |all: Aabb, cell| all.union(cell.bounds()));
    let nothing = |statistics| GroupDecided {
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
    let whole = Task {
        scene: task.scene,
        cell,
        places: task.places,
        seen: &[],
        above: &[],
        listed: None,
        limits: task.limits,
        seed: task.seed,
        keep: task.keep,
        stop: task.stop,
        asked: task.asked,
    };
    let mut work = Work::new(&whole);
    if task.scene.occluders().targets().is_empty() || (task.stop)() {
        return nothing(QueryStatistics::default());
    }
    work.meeting();
    // The states before any query, for a few cells at a time: a large scene has many triangles and a tile may
    // have many cells, so all states at once would take much memory.
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
        let known: Vec<Vec<State>> = some
            .par_iter()
            .map(|((cell, seen), listed)| before_asking(&whole, **cell, seen, *listed))
            .collect();
        let counts = seen_by_any.par_iter_mut().zip(&mut hidden_from).enumerate();
        counts.for_each(|(id, (seen, hidden))| {
            *seen |= known.iter().any(|cell| cell[id] == State::Visible);
            *hidden += known
                .iter()
                .filter(|cell| cell[id] == State::Hidden)
                .count();
        });
    }
    for (id, state) in work
        .state
        .iter_mut()
        .enumerate()
        .filter(|(_, state)| **state == State::Open)
    {
        if seen_by_any[id] {
            *state = State::Visible;
        } else if hidden_from[id] == task.cells.len() {
            *state = State::Hidden;
        }
    }
    let before = work.state.clone();
    work.search();
    let found = |id: &u32| {
        let at = *id as usize;
        work.state[at] == State::Hidden && before[at] == State::Open
    };
    let hidden = (0..before.len() as u32).filter(found).collect();
    let shared = GroupCertificate {
        bounds,
        hidden: std::mem::take(&mut work.decided.certificate.hidden),
    };
    GroupDecided {
        hidden,
        shared,
        statistics: work.decided.statistics,
    }
}

/// The states of the triangles for one of the cells before any query; triangles that sampling has shown count
/// as visible.
fn before_asking(whole: &Task<'_>, cell: Cell, seen: &[u32], listed: Option<&[u32]>) -> Vec<State> {
    let own = Task {
        cell,
        seen,
        listed,
        keep: false,
        ..*whole
    };
    let mut work = Work::new(&own);
    work.meeting();
    work.keep_to_listed();
    work.enclose();
    let mut state = work.state;
    for id in seen {
        let triangle_state = &mut state[*id as usize];
        if *triangle_state == State::Open {
            *triangle_state = State::Visible;
        }
    }
    state
}
