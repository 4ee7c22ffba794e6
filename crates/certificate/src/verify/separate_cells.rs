//! The check of the pairs of cells that do not see each other. In each pair, one cell must lie in a box that
//! is hidden from the other.

use sightline_numbers::Aabb;

use super::{BakedResult, NOT_REACHED};
use crate::checker::{CellClaims, CellRefusal, Claim, Triangles, check_box_claim};

/// Checks that every pair of cells that the result does not list as visible has a hidden box. `boxes`
/// contains the hidden boxes of each cell, whose proofs [`verify`](super::verify) checks separately. Returns
/// the number of pairs of cells that do not see each other, or the cell of the first fault and the reason.
pub(super) fn check(result: &dyn BakedResult, boxes: &[Vec<Aabb>]) -> Result<u64, (u32, String)> {
    let cells = boxes.len() as u32;
    let mut bounds = Vec::with_capacity(boxes.len());
    let mut reached = Vec::with_capacity(boxes.len());
    for cell in 0..cells {
        let flags = result.flags(cell).map_err(|e| (cell, e))?;
        bounds.push(
            result
                .cell_bounds(cell)
                .ok_or_else(|| (cell, "the result has no bounds for the cell".to_owned()))?,
        );
        reached.push(flags & NOT_REACHED == 0);
    }
    let holds = |outer: &Aabb, cell: u32| {
        let Aabb { min, max } = bounds[cell as usize];
        outer.min.cmple(min).all() && outer.max.cmpge(max).all()
    };
    let covered = |a: u32, b: u32| boxes[a as usize].iter().any(|outer| holds(outer, b));
    let mut apart = 0;
    for a in 0..cells {
        let Some(seen) = result.seen_cells(a).map_err(|e| (a, e))? else {
            return Ok(0);
        };
        let mut seen = seen.into_iter().filter(|b| *b >= a).peekable();
        for b in a..cells {
            if seen.next_if_eq(&b).is_some() || !(reached[a as usize] || reached[b as usize]) {
                continue;
            }
            if a == b || !(covered(a, b) || covered(b, a)) {
                return Err((
                    a,
                    format!(
                        "the result states that no point of this cell sees cell {b}, but no proof shows this"
                    ),
                ));
            }
            apart += 1;
        }
    }
    Ok(apart)
}

/// Checks the selected boxes of a cell that makes no claims about triangles.
pub(super) fn check_boxes(
    scene: &Triangles<'_>,
    claims: &CellClaims<'_>,
    wanted: &(dyn Fn(Claim) -> bool + Sync),
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<(), CellRefusal> {
    for at in (0..claims.certificate.apart.len()).filter(|at| wanted(Claim::Apart(*at))) {
        if cancelled() {
            return Err(CellRefusal::Cancelled);
        }
        check_box_claim(scene, claims, at)?;
    }
    Ok(())
}
