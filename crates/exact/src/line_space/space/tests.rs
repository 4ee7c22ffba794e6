//! Tests of the error bounds: every ray is as near to its integers as its bound, however it was computed.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::DVec3;
use proptest::prelude::*;

use super::solved_rays::Solved;
use super::{Space, VectorId, klein_exact};
use crate::arithmetic::double_double::DoubleDouble;
use crate::arithmetic::number::rounded_double_double;
use crate::arithmetic::random::Random;
use crate::geometry::frame::Frame;
use crate::geometry::parts::parts;
use crate::geometry::polygon::Polygon;
use crate::geometry::predicates::sign;
use crate::line_space::cone::Region;
use crate::line_space::stabbing_polyhedron;

fn point() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-64i32..64).prop_map(|p| DVec3::from(p.map(f64::from)) / 64.0)
}

/// Returns the largest distance of a vector's components from integers that represent the same vector.
///
/// The integers are scaled to agree in their largest component.
fn off(x: [DoubleDouble; 6], exact: &[IBig; 6]) -> f64 {
    let y = rounded_double_double(exact);
    let k = (0..6)
        .max_by(|i, j| y[*i].0.abs().total_cmp(&y[*j].0.abs()))
        .unwrap();
    let scale = x[k].over(y[k]);
    assert!(scale.0 > 0.0, "turned round: {x:?} {y:?}");
    (0..6)
        .map(|i| x[i].minus(y[i].times(scale)).0.abs())
        .fold(0.0, f64::max)
}

/// Creates regions between two triangles, cut by lines through points and by lines through points next to
/// them.
///
/// These lines meet at all angles, including small angles.
fn regions(
    a: [DVec3; 3],
    b: [DVec3; 3],
    cuts: &[(DVec3, DVec3, f64)],
) -> Option<(Space, Vec<Region>)> {
    let (a, b) = (Polygon::triangle(a)?, Polygon::triangle(b)?);
    let [x, y] = parts(&a, &b).into_iter().next()?;
    let mut space = Space::new(Frame::around(&x.0.rounded(), &y.0.rounded()));
    let pair = stabbing_polyhedron::stabbing(&mut space, &x.0, &x.1, &y.0, &y.1).ok()?;
    let mut regions = pair.regions;
    let mut sides = Vec::new();
    for (p, q, near) in cuts {
        for by in [0.0, *near] {
            let ends = [*p, *q + DVec3::new(by, -by, 0.0)].map(|p| {
                let p = space.frame().given(p);
                space.point(p)
            });
            let line = space.join(ends[0], ends[1]);
            let mut next = Vec::new();
            for region in regions {
                region.sides(&mut space, line, &mut sides);
                let both = [std::cmp::Ordering::Less, std::cmp::Ordering::Greater]
                    .map(|s| sides.contains(&s));
                if both == [true, true] {
                    next.extend(region.split(&mut space, line, &sides).ok()?);
                } else {
                    next.push(region);
                }
            }
            next.truncate(6);
            regions = next;
        }
    }
    Some((space, regions))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn rays_stay_within_error_bounds(
        a in prop::array::uniform3(point()), b in prop::array::uniform3(point()),
        cuts in prop::collection::vec(
            (point(), point(), prop_oneof![Just(0.01), Just(1e-5), Just(1e-9)]),
            1..7,
        ),
    ) {
        let Some((mut space, regions)) = regions(a, b.map(|p| p + DVec3::new(0.0, 0.0, 3.0)), &cuts) else {
            return Ok(());
        };
        for region in &regions {
            for i in 0..region.rays.len() {
                let [found, all] = region.neighbours_twice(i);
                prop_assert_eq!(found, all);
            }
            for (ray, tight) in &region.rays {
                let x = space.rounded(*ray).map(|c| DoubleDouble(c, 0.0));
                let error = space.error(*ray);
                let lines: Vec<VectorId> = region.tight(*tight).collect();
                let near = *space.rounded(*ray);
                let solved = [false, true].map(|best| space.solved(near, error, &lines, best));
                let exact = space.exact(*ray).clone();
                // The ray from the lines that contain it is the same as the ray from its cuts.
                space.vectors[ray.index()].exact = None;
                space.sharpen_from(*ray, &lines);
                if let Some(again) = &space.vectors[ray.index()].exact {
                    let k = (0..6).find(|k| !exact[*k].is_zero()).unwrap();
                    prop_assert_eq!(exact[k].sign(), again[k].sign());
                    prop_assert!((0..6).all(|i| &exact[i] * &again[k] == &exact[k] * &again[i]));
                }
                // A vector that agrees in the largest component is off by up to three times the error.
                prop_assert!(off(x, &exact) <= 3.1 * error + 1e-30, "{} {error}", off(x, &exact));
                for solved in solved.into_iter().flatten() {
                    let (x, error) = match solved {
                        Solved::Doubles(x, error) => (x.map(|c| DoubleDouble(c, 0.0)), error),
                        Solved::Pairs(x, error) => (x, error),
                    };
                    prop_assert!(off(x, &exact) <= 3.1 * error + 1e-30, "{} {error}", off(x, &exact));
                }
            }
        }
    }

    /// The lines join few points, so that many meet and some are dependent.
    #[test]
    fn surely_independent_lines_are_independent(
        points in prop::array::uniform6(prop::array::uniform3(-2i32..3)),
        near in prop_oneof![Just(0.0), Just(1e-3), Just(1e-15)],
    ) {
        let mut at = points.map(|p| DVec3::from(p.map(f64::from)));
        at[5].x += near;
        prop_assume!(at[0] != at[1] && at[2] != at[3] && at[4] != at[5]);
        let mut space = Space::new(Frame::around(&at[..3], &at[3..]));
        let lines = [0, 2, 4].map(|k| {
            let ends = [at[k], at[k + 1]].map(|p| {
                let p = space.frame().given(p);
                space.point(p)
            });
            space.join(ends[0], ends[1])
        });
        if space.surely_independent(lines) {
            let truth = super::small::dependent([[at[0], at[1]], [at[2], at[3]], [at[4], at[5]]]);
            prop_assert!(truth != Some(true));
        } else if near == 0.0 {
            // Doubles decide small integers: a triple that is not surely independent is dependent.
            let truth = super::small::dependent([[at[0], at[1]], [at[2], at[3]], [at[4], at[5]]]);
            prop_assert_eq!(truth, Some(true));
        }
    }
}

/// Uses regions cut by edges of few points, including corners of the polygons.
///
/// Many of these rays are lines, and many are combinations of lines that contain other rays. Half of the
/// polygon pairs are apart; the other half have edges on one line.
#[test]
fn rules_find_forms_that_are_0() {
    let mut random = Random::new(3, 0);
    // The numbers of forms that are 0, of two rays and of a ray with a line: in total, and without a reason
    // that a rule found.
    let (mut zeros, mut unexplained) = ([0; 2], [0; 2]);
    for round in 0..400 {
        let mut any = |n: i32| (random.unit() * f64::from(n)) as i32;
        let a = [[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let b = if round % 2 == 0 {
            a.map(|p| p + 2.0 * DVec3::Z)
        } else {
            [
                DVec3::new(2.0, -1.0, 0.0),
                DVec3::new(3.0, -1.0, 0.0),
                DVec3::new(2.0, 0.0, 2.0),
            ]
        };
        let middle = (a[0] + a[1] + a[2] + b[0] + b[1] + b[2]) / 6.0;
        let mut at: Vec<DVec3> = (0..5)
            .map(|_| middle + DVec3::from([any(5), any(5), any(5)].map(|c| f64::from(c - 2))) / 4.0)
            .collect();
        at.extend(a.iter().chain(&b));
        let cuts: Vec<_> = (0..5)
            .map(|_| (any(at.len() as i32) as usize, any(at.len() as i32) as usize))
            .filter(|(p, q)| at[*p] != at[*q])
            .map(|(p, q)| (at[p], at[q], 0.0))
            .collect();
        let Some((mut space, regions)) = regions(a, b, &cuts) else {
            continue;
        };
        for region in &regions {
            let on: Vec<Vec<VectorId>> = region
                .rays
                .iter()
                .map(|(_, t)| region.tight(*t).collect())
                .collect();
            for (i, (a, _)) in region.rays.iter().enumerate() {
                let mut check =
                    |side: Ordering, space: &mut Space, b: VectorId, kind: usize, before: u64| {
                        let [x, y] = [*a, b].map(|x| space.exact(x).clone());
                        assert_eq!(side, sign(&klein_exact(&x, &y)), "round {round}");
                        zeros[kind] += u32::from(side == Ordering::Equal);
                        let seen = space.decisions.spanned > before;
                        unexplained[kind] += u32::from(side == Ordering::Equal && !seen);
                    };
                for (j, (b, _)) in region.rays.iter().enumerate().skip(i) {
                    let before = space.decisions.spanned;
                    let side = space.rays_side(*a, &on[i], *b, &on[j]);
                    check(side, &mut space, *b, 0, before);
                }
                for line in region.halves.iter() {
                    let before = space.decisions.spanned;
                    let side = space.unfiltered_ray_side(*a, *line, on[i].iter().copied());
                    check(side, &mut space, *line, 1, before);
                }
            }
        }
    }
    // Most zeros have a reason. Without either rule, more than a tenth has none.
    assert!(
        (0..2).all(|k| unexplained[k] * 10 < zeros[k]),
        "{unexplained:?} of {zeros:?}"
    );
}
