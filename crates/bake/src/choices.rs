//! Every choice of this crate that decides bytes, beside the version of the algorithm.
//!
//! Whoever changes a value here, or a value that the crates below use to the same effect, raises
//! [`sightline_model::ALGORITHM_VERSION`] and the number in this file.

use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use sightline_exact::Limits;
use sightline_model::{ALGORITHM_VERSION, Effort};
use sightline_viewcells::CellBox;

const _: () = assert!(
    ALGORITHM_VERSION == 28,
    "the choices in this file belong to another version"
);

/// Cells of a cell group. The queries about a group's box cost more than they save with fewer cells; with
/// more cells fewer triangles are hidden from the box.
pub const GROUP_CELLS: RangeInclusive<usize> = 4..=8;

/// Limits of a single query with [`Effort::Bounded`]: far above the cost of nearly all queries, and far
/// below the cost of the hardest queries.
const BOUNDED: Limits = Limits {
    regions: 1000,
    vectors: 100_000,
    splits: 32,
    divisions: 6,
};

/// The fraction of a time budget that sampling may take, as a divisor. Sampling is fast; queries for
/// triangles that it would still find are not.
const SAMPLING_SHARE: u32 = 4;

/// The fraction of a cell query's time that cell groups may take, and then of what is left that pairs of
/// cells may take, as a divisor: a triangle hidden from a group is not a target for any of its cells.
pub const GROUP_SHARE: u32 = 2;

/// Returns the limits of a single query.
pub fn exact_limits(effort: Effort) -> Limits {
    match effort {
        Effort::Full => Limits::default(),
        Effort::Bounded => BOUNDED,
    }
}

/// The seed of the random numbers of a box, from the job's seed and the box's lattice corners.
pub fn box_seed(at: &CellBox, seed: u64) -> u64 {
    let corners = at.lo.iter().chain(&at.hi);
    corners.fold(seed, |h, c| {
        h.wrapping_mul(0x0100_0000_01b3) ^ u64::from(*c)
    })
}

/// Returns the time at which sampling ends. Where triangles are decided, most of the time is left to queries.
pub fn sampling_deadline(is_decided: bool, deadline: Option<Instant>) -> Option<Instant> {
    let share = |end: Instant| -> Instant {
        let now = Instant::now();
        let left: Duration = end.saturating_duration_since(now);
        now + left / SAMPLING_SHARE
    };
    match is_decided {
        false => deadline,
        true => deadline.map(share),
    }
}
