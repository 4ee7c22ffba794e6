//! The choices of this crate that determine bytes, in addition to the version of the algorithm.
//!
//! If you change a value in this file, or a value of the same effect in the crates that this crate uses,
//! increase [`sightline_model::ALGORITHM_VERSION`] and the number in this file.

use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use sightline_exact::QueryLimits;
use sightline_model::{ALGORITHM_VERSION, Effort};
use sightline_viewcells::CellBox;

const _: () = assert!(
    ALGORITHM_VERSION == 31,
    "the choices in this file belong to another version"
);

/// The number of cells of a cell group. With fewer cells, the queries about a group's box cost more than they
/// save. With more cells, fewer triangles are hidden from the box.
pub const GROUP_CELLS: RangeInclusive<usize> = 4..=8;

/// The limits of a single query with [`Effort::Bounded`].
///
/// These limits are far above the cost of nearly all queries, and far below the cost of the hardest queries.
const BOUNDED: QueryLimits = QueryLimits {
    regions: 1000,
    vectors: 100_000,
    splits: 32,
    divisions: 6,
};

/// The share of a time budget that sampling may use, as a divisor. Sampling is fast; the queries for
/// triangles that more sampling would find are slow.
const SAMPLING_SHARE: u32 = 4;

/// The share of the time for queries that cell groups may use, as a divisor. Pairs of cells may use the same
/// share of the remaining time. A triangle hidden from a group is not a target for any cell of the group.
pub const GROUP_SHARE: u32 = 2;

/// Returns the limits of a single query.
pub fn exact_limits(effort: Effort) -> QueryLimits {
    match effort {
        Effort::Full => QueryLimits::default(),
        Effort::Bounded => BOUNDED,
    }
}

/// Computes the seed of the random numbers of a box from the job's seed and the box's lattice corners.
pub fn box_seed(at: &CellBox, seed: u64) -> u64 {
    let corners = at.lo.iter().chain(&at.hi);
    corners.fold(seed, |h, c| {
        h.wrapping_mul(0x0100_0000_01b3) ^ u64::from(*c)
    })
}

/// Returns the time at which sampling ends. If triangles are decided, most of the time remains for queries.
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
