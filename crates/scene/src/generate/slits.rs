//! Parallel walls with narrow upright slits at known positions. From a point between two walls, everything
//! beyond these walls is visible only through slits, so visibility is known by construction.
//!
//! The walls are unit squares over [−½, ½]² in x and y, one behind the other along z. The scene's bounds
//! equal the bounds of the walls, so no line inside the bounds passes next to a wall. The last wall has no
//! slit. The positions of slits have the precision of `f32`: a width of 1e-7 is three or four steps.

use super::build::Builder;
use super::params::{
    GenerateError, MAX_TRIANGLES, SceneKind, SceneParams, contradiction, isqrt, within,
};
use super::random::Random;

/// The thickness of a wall. Lines through a slit have an angle to the wall's normal whose tangent in x is at
/// most the slit's width divided by this thickness.
pub const THICKNESS: f32 = 0.0078125;
/// The distance between the fronts of neighbouring walls.
pub const DISTANCE: f32 = 0.25;
/// Half the height of a slit, which extends from −[`HALF_HEIGHT`] to [`HALF_HEIGHT`].
pub const HALF_HEIGHT: f32 = 0.375;
/// The number of triangles that a slit adds to a wall. [`PER_WALL`] is the number of triangles of a wall
/// without slits.
const PER_SLIT: u64 = 36;
const PER_WALL: u64 = 28;

/// Computes the slits of each wall except the last as ascending, disjoint intervals in x.
///
/// Wall k extends from z = k·[`DISTANCE`] to z = k·[`DISTANCE`] + [`THICKNESS`].
///
/// # Errors
/// The errors of [`super::generate`] for [`SceneKind::Slits`].
pub fn layout(params: &SceneParams) -> Result<Vec<Vec<[f32; 2]>>, GenerateError> {
    const KIND: SceneKind = SceneKind::Slits;
    let [walls, slits] = match (params.grid, params.triangles) {
        (Some(_), Some(_)) => {
            return Err(contradiction(KIND, "--grid already determines the number"));
        }
        (Some(grid), None) => grid.map(u64::from),
        (None, Some(total)) => {
            within(KIND, "--triangles", total, 140, MAX_TRIANGLES)?;
            let walls = (isqrt(total) / 16).clamp(2, 64);
            [
                walls,
                ((total / (walls - 1)).saturating_sub(PER_WALL) / PER_SLIT).max(1),
            ]
        }
        (None, None) => [5, 4],
    };
    within(KIND, "walls of --grid", walls, 2, 10_000)?;
    within(KIND, "slits of --grid", slits, 1, 1_000_000)?;
    let size = (walls - 1) * (slits * PER_SLIT + PER_WALL);
    within(
        KIND,
        "the number of triangles of the requested walls and slits",
        size,
        1,
        MAX_TRIANGLES,
    )?;
    let width = within(
        KIND,
        "--slit-width",
        params.slit_width.unwrap_or(default_width(slits)),
        1e-7,
        0.1,
    )?;
    // Each slit is in the middle half of a separate strip, so neighbouring slits are disjoint.
    let strip = 1.0 / slits as f32;
    within(
        KIND,
        "--slit-width times the slits per wall",
        width * slits as f32,
        0.0,
        0.25,
    )?;
    Ok((0..walls - 1)
        .map(|wall| {
            let mut r = Random::new(params.seed, wall);
            (0..slits)
                .map(|k| {
                    let from = (k as f32 + r.range(0.25, 0.5)) * strip - 0.5;
                    [from, (from + width).max(from.next_up())]
                })
                .collect()
        })
        .collect())
}

/// Returns the default width: a thousandth of the wall, or a sixteenth of a strip if there are many slits.
fn default_width(slits: u64) -> f32 {
    (0.0625 / slits as f32).clamp(1e-7, 1e-3)
}

pub(super) fn build(b: &mut Builder, params: &SceneParams) -> Result<(), GenerateError> {
    let walls = layout(params)?;
    let depth = |k: usize| [k as f32 * DISTANCE, k as f32 * DISTANCE + THICKNESS];
    let vs = [-0.5, -HALF_HEIGHT, HALF_HEIGHT, 0.5];
    for (k, slits) in walls.iter().enumerate() {
        let mut us = vec![-0.5];
        us.extend(slits.iter().flatten());
        us.push(0.5);
        b.object(format!("wall {k}"), |b| {
            b.slab([0, 1, 2], &us, &vs, depth(k), |i, j| j == 1 && i % 2 == 1);
        });
    }
    let back = walls.len();
    b.object("back wall".into(), |b| {
        b.slab(
            [0, 1, 2],
            &[-0.5, 0.5],
            &[-0.5, 0.5],
            depth(back),
            |_, _| false,
        );
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::generate;

    #[test]
    fn narrowest_slits_are_open_and_disjoint() {
        let p = SceneParams {
            grid: Some([4, 9]),
            slit_width: Some(1e-7),
            ..SceneParams::default()
        };
        let layout = layout(&p).unwrap();
        assert_eq!((layout.len(), layout[0].len()), (3, 9));
        for wall in &layout {
            let cuts: Vec<f32> = wall.iter().flatten().copied().collect();
            assert!(cuts.windows(2).all(|w| w[0] < w[1]) && cuts[0] > -0.5 && cuts[17] < 0.5);
            assert!(
                wall.iter()
                    .all(|[a, b]| f64::from(*b) - f64::from(*a) < 1.5e-7)
            );
        }
        let s = generate(SceneKind::Slits, &p).unwrap();
        assert_eq!(u64::from(s.len()), 3 * (9 * PER_SLIT + PER_WALL) + 12);
        assert!(s.triangles().iter().all(|t| !t.is_degenerate()));
    }
}
