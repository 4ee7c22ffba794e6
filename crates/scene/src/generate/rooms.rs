//! One storey of furnished rooms with a floor and a ceiling, without windows. Every branch of a spanning tree
//! of the rooms and a third of the other inner walls have a door.

use glam::Vec3;

use super::build::Builder;
use super::params::{GenerateError, MAX_TRIANGLES, SceneKind, SceneParams, within};
use super::plan::{FloorPlan, Wall};
use super::random::Random;
use super::{furniture, maze};

/// The number of triangles of a room if only `triangles`, only `grid` or neither is given.
const PER_ROOM: u64 = 800;
/// The number of pieces of furniture in a room.
const PIECES: u64 = 3;

pub(super) fn build(b: &mut Builder, params: &SceneParams) -> Result<(), GenerateError> {
    if let Some(total) = params.triangles {
        within(SceneKind::Rooms, "--triangles", total, 300, MAX_TRIANGLES)?;
    }
    let [cols, rows] = maze::grid(SceneKind::Rooms, params, PER_ROOM, [6, 4], 300)?;
    let rooms = u64::from(cols) * u64::from(rows);
    // The number of triangles of a room's pillar, walls, doors and coarsest furniture, and of the border.
    let least = 150 * rooms + 30 * (u64::from(cols) + u64::from(rows));
    let target = params.triangles.unwrap_or(rooms * PER_ROOM);
    within(
        SceneKind::Rooms,
        "the number of triangles for the requested rooms",
        target,
        least,
        MAX_TRIANGLES,
    )?;
    let plan = FloorPlan {
        origin: Vec3::ZERO,
        cols,
        rows,
        cell: 5.0,
        height: 2.8,
        thickness: 0.2,
    };
    let mut r = Random::new(params.seed, 0);
    let open = maze::carve(cols, rows, &mut r);
    b.object("floor".into(), |b| plan.plate(b, -0.2, 0.0, 0.0));
    b.object("ceiling".into(), |b| {
        plan.plate(b, plan.height, plan.height + 0.2, 0.0)
    });
    for j in 0..=rows {
        for i in 0..=cols {
            b.object(format!("pillar {i} {j}"), |b| plan.pillar(b, i, j));
        }
    }
    for p in plan.places() {
        let door = !plan.is_outer(p) && (open.between(p) || r.below(3) == 0);
        let wall = if door { Wall::Door } else { Wall::Solid };
        b.object(maze::wall_name(p), |b| plan.wall(b, p, wall, &mut r));
    }
    // The remaining triangles are divided equally among the remaining pieces. A later piece gets the
    // triangles that an earlier piece does not use.
    let mut left = rooms * PIECES;
    for j in 0..rows {
        for i in 0..cols {
            for k in 0..PIECES {
                let budget = target.saturating_sub(b.len()) / left;
                left -= 1;
                b.object(format!("furniture {i} {j} {k}"), |b| {
                    let place = furniture::strip(plan.floor(i, j), k, PIECES);
                    furniture::piece(b, &mut r, place, budget.max(furniture::LEAST));
                });
            }
        }
    }
    Ok(())
}
