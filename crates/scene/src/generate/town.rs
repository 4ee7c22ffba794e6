//! A town: a grid of streets with houses of one to three storeys. The houses are full of rooms. Each room has
//! a door to every neighbour, windows to the street, and detailed furniture, which is visible through the
//! openings.

use glam::Vec3;

use super::build::Builder;
use super::furniture;
use super::params::{GenerateError, MAX_TRIANGLES, SceneKind, SceneParams, isqrt, within};
use super::plan::{FloorPlan, Wall};
use super::random::Random;

/// The approximate number of triangles of the town in Nirenstein and Blake 2004.
const DEFAULT: u64 = 1_330_000;
/// The number of triangles of a house, in a town that is large enough.
const PER_HOUSE: u64 = 20_000;
/// The number of pieces of furniture in a room.
const THINGS: u64 = 2;
/// The distance between the fronts of neighbouring houses in metres, including the street.
const LOT: f32 = 26.0;
/// The side of a room in metres.
const ROOM: f32 = 4.0;
/// The height of a storey's walls in metres. The sums of this height and the thickness [`THICK`] of walls and
/// floors are exact, so storeys are stacked without cracks.
const STOREY: f32 = 2.75;
const THICK: f32 = 0.25;

pub(super) fn build(b: &mut Builder, params: &SceneParams) -> Result<(), GenerateError> {
    let target = within(
        SceneKind::Town,
        "--triangles",
        params.triangles.unwrap_or(DEFAULT),
        2_000,
        MAX_TRIANGLES,
    )?;
    let houses = (target / PER_HOUSE).max(2);
    let each = target / houses;
    let columns = isqrt(houses - 1) + 1;
    let rows = houses.div_ceil(columns);
    b.object("ground".into(), |b| {
        let p = |i: u64, j: u64| Vec3::new((i as f32 - 0.25) * LOT, 0.0, (j as f32 - 0.25) * LOT);
        for j in 0..rows {
            for i in 0..columns {
                b.quad([p(i, j), p(i, j + 1), p(i + 1, j + 1), p(i + 1, j)], false);
            }
        }
    });
    // Houses come first, and furniture gets the remaining triangles.
    let mut rooms: Vec<(u64, [Vec3; 2])> = Vec::new();
    for house in 0..houses {
        let mut r = Random::new(params.seed, 1 + house);
        let (cols, depth, storeys) = match each {
            0..3_000 => (2, 1, 1),
            3_000..12_000 => (2 + r.below(2), 2, 1),
            _ => (2 + r.below(3), 2 + r.below(2), 1 + r.below(3)),
        };
        let corner = Vec3::new(
            (house % columns) as f32 * LOT,
            0.0,
            (house / columns) as f32 * LOT,
        );
        let plan = |storey: u32| FloorPlan {
            origin: corner + Vec3::Y * (THICK + storey as f32 * (STOREY + THICK)),
            cols,
            rows: depth,
            cell: ROOM,
            height: STOREY,
            thickness: THICK,
        };
        b.object(format!("house {house}"), |b| {
            let front = r.below(cols);
            for storey in 0..storeys {
                build_storey(b, &mut r, &plan(storey), (storey == 0).then_some(front));
            }
            plan(storeys - 1).plate(b, STOREY, STOREY + THICK, 0.4);
        });
        for storey in 0..storeys {
            for j in 0..depth {
                rooms.extend((0..cols).map(|i| (house, plan(storey).floor(i, j))));
            }
        }
    }
    let mut left = rooms.len() as u64 * THINGS;
    let mut r = Random::new(params.seed, 0);
    for (room, (house, floor)) in rooms.into_iter().enumerate() {
        for k in 0..THINGS {
            let budget = (target.saturating_sub(b.len()) / left).max(furniture::LEAST);
            left -= 1;
            b.object(format!("house {house} room {room} thing {k}"), |b| {
                furniture::piece(b, &mut r, furniture::strip(floor, k, THINGS), budget);
            });
        }
    }
    Ok(())
}

/// Adds one storey: its floor, pillars and walls. `front` is the column of the front door on the side of
/// minimum z.
fn build_storey(b: &mut Builder, r: &mut Random, plan: &FloorPlan, front: Option<u32>) {
    // The lowest floor extends below the ground, so that no two surfaces coincide there.
    plan.plate(
        b,
        if front.is_some() {
            -2.0 * THICK
        } else {
            -THICK
        },
        0.0,
        0.0,
    );
    for j in 0..=plan.rows {
        for i in 0..=plan.cols {
            plan.pillar(b, i, j);
        }
    }
    for p in plan.places() {
        let is_front = !p.along_z && p.j == 0 && front == Some(p.i);
        let wall = if is_front || !plan.is_outer(p) {
            Wall::Door
        } else {
            Wall::Window
        };
        plan.wall(b, p, wall, r);
    }
}
