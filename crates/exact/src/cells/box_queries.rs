//! Queries from a view cell to boxes of other cells: a box is visible if a point of the cell sees a point of
//! the box.

use sightline_numbers::Aabb;

use crate::cells::from_cell::{FromCellAnswer, faces_towards, from_cell};
use crate::cells::sources::Sources;
use crate::geometry::Cell;
use crate::occluders::Occluders;
use crate::search::{QueryCost, QueryLimits};

/// Queries whether any point of the box `target` is visible from the cell, and adds the cost to `cost`.
///
/// The result is `None` if the cell and the box share a volume or a part of a face, because a viewpoint may
/// see the box directly through it. A common edge or corner is allowed, because the lines through it do not
/// form an open set.
pub fn box_from_cell(
    scene: &Occluders,
    cell: Cell,
    target: Aabb,
    limits: &QueryLimits,
    stop: &dyn Fn() -> bool,
    cost: &mut QueryCost,
) -> Option<FromCellAnswer> {
    let own = cell.bounds();
    let touching = (0..3)
        .filter(|a| target.max[*a] == own.min[*a] || target.min[*a] == own.max[*a])
        .count();
    if own.touches(&target) && touching < 2 {
        return None;
    }
    let faces = faces_towards(target.min, target.max, cell);
    Some(from_cell(
        scene,
        &Sources::new(cell, None),
        &faces,
        None,
        limits,
        stop,
        cost,
    ))
}
