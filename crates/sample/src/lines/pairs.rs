//! The pairs of cells that see each other, from a tile's lines.

use sightline_model::TilePairs;
use sightline_trace::lines::pairs::Pairs;

use crate::context::JobContext;

/// Returns the pairs of a tile's lines. With restricted viewpoints, pairs of two cells without viewpoints are
/// omitted.
pub fn of_tile(job: &JobContext<'_>, pairs: Option<&Pairs>) -> Option<TilePairs> {
    let counts = |cell: u32| {
        job.viewpoints
            .is_none_or(|marks| marks.parts(cell as usize) != 0)
    };
    pairs.map(|pairs| TilePairs {
        seen: pairs.table(counts),
        hidden: None,
    })
}
