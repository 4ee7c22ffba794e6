//! Queries from a view cell to boxes of other cells: whether a point of one sees a point of the other.

use sightline_numbers::Aabb;

use crate::cells::from_cell::{Found, faces_towards, from_cell};
use crate::cells::sources::Sources;
use crate::geometry::Cell;
use crate::occluders::Occluders;
use crate::search::{Cost, Limits};

/// Whether any point of a box is seen from the cell; `None` when both share a volume or a part of a face,
/// through which they may see each other directly. Edges and corners may be common: lines through them are no
/// open set.
pub fn box_from_cell(
    scene: &Occluders,
    cell: Cell,
    of: Aabb,
    (limits, stop): (&Limits, &dyn Fn() -> bool),
    cost: &mut Cost,
) -> Option<Found> {
    let own = cell.bounds();
    let touching = (0..3)
        .filter(|a| of.max[*a] == own.min[*a] || of.min[*a] == own.max[*a])
        .count();
    if own.touches(&of) && touching < 2 {
        return None;
    }
    let faces = faces_towards(of.min, of.max, cell);
    Some(from_cell(
        scene,
        &Sources::new(cell, None),
        (&faces, None),
        (limits, stop),
        cost,
    ))
}
