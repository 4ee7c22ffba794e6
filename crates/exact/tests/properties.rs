//! Properties of any scene, on a coarse grid, where almost all triangles touch each other, and on random
//! floats.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

mod common;

use common::{Corners, World};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use proptest::sample::{Index, select};

/// A scene and two polygons.
#[derive(Clone, Debug)]
struct Case {
    triangles: Vec<Corners>,
    a: Vec<DVec3>,
    b: Vec<DVec3>,
}

impl Case {
    fn sees(&self) -> Result<bool, TestCaseError> {
        sees(&World::new(self.triangles.clone()), &self.a, &self.b)
    }

    /// Returns the case with `f` applied to all points.
    fn mapped(&self, f: impl Fn(DVec3) -> DVec3) -> Self {
        let points = |p: &[DVec3]| p.iter().map(|p| f(*p)).collect();
        Self {
            triangles: self
                .triangles
                .iter()
                .map(|t| t.map(|p| f(p.as_dvec3()).as_vec3()))
                .collect(),
            a: points(&self.a),
            b: points(&self.b),
        }
    }
}

/// Runs a query; an undecided query and a rejected verdict are failures.
fn sees(world: &World, a: &[DVec3], b: &[DVec3]) -> Result<bool, TestCaseError> {
    world.try_sees(a, b).map_err(TestCaseError::fail)
}

fn has_area(p: &[DVec3]) -> bool {
    // The test is exact for the points of these strategies: small integers, or floats that are far from one
    // line.
    (p[1] - p[0]).cross(p[2] - p[0]).length() > 1e-3
}

/// Generates points with even coordinates, so that the middles of edges are on the grid of whole numbers.
fn grid_point(reach: i8) -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-reach..=reach).prop_map(|p| Vec3::from(p.map(|c| 2.0 * f32::from(c))))
}

/// Generates triangles, some of them without area, and occasionally a rectangle across the scene.
fn grid_triangles(reach: i8) -> impl Strategy<Value = Vec<Corners>> {
    let triangle = prop::array::uniform3(grid_point(reach)).prop_map(|t| vec![t]);
    let rectangle = (
        0..3usize,
        -reach..=reach,
        prop::array::uniform4(-reach..=reach),
    )
        .prop_map(move |(axis, at, [x0, x1, y0, y1])| {
            let corner = |x: i8, y: i8| {
                let mut p = [0.0; 3];
                p[axis] = 2.0 * f32::from(at);
                p[(axis + 1) % 3] = 2.0 * f32::from(x);
                p[(axis + 2) % 3] = 2.0 * f32::from(y);
                Vec3::from(p)
            };
            let (x1, y1) = (
                if x1 == x0 { reach + 1 } else { x1 },
                if y1 == y0 { reach + 1 } else { y1 },
            );
            let [a, b, c, d] = [
                corner(x0, y0),
                corner(x1, y0),
                corner(x1, y1),
                corner(x0, y1),
            ];
            vec![[a, b, c], [a, c, d]]
        });
    prop::collection::vec(prop_oneof![3 => triangle, 1 => rectangle], 5..24)
        .prop_map(|t| t.concat())
}

/// Generates a triangle, or the parallelogram of which it is a half.
///
/// The parallelogram is convex and exactly flat.
fn grid_polygon(reach: i8) -> impl Strategy<Value = Vec<DVec3>> {
    (prop::array::uniform3(grid_point(reach)), any::<bool>()).prop_filter_map(
        "no area",
        |(t, whole)| {
            let [a, b, c] = t.map(|p| p.as_dvec3());
            let p = if whole {
                vec![a, b, b + c - a, c]
            } else {
                vec![a, b, c]
            };
            has_area(&p).then_some(p)
        },
    )
}

/// Generates cases on small grids, on which almost all triangles touch each other, and on larger grids.
fn grid_case() -> impl Strategy<Value = Case> {
    select(vec![1i8, 2, 3, 5]).prop_flat_map(|reach| {
        (
            grid_triangles(reach),
            grid_polygon(reach),
            grid_polygon(reach),
        )
            .prop_map(|(triangles, a, b)| Case { triangles, a, b })
    })
}

fn float_case() -> impl Strategy<Value = Case> {
    let point = || prop::array::uniform3(-1.0f32..1.0).prop_map(Vec3::from);
    let polygon = move || {
        prop::array::uniform3(point()).prop_filter_map("no area", |t| {
            let p = t.map(|p| p.as_dvec3()).to_vec();
            has_area(&p).then_some(p)
        })
    };
    (
        prop::collection::vec(prop::array::uniform3(point()), 5..30),
        polygon(),
        polygon(),
    )
        .prop_map(|(triangles, a, b)| Case { triangles, a, b })
}

fn any_case() -> impl Strategy<Value = Case> {
    prop_oneof![3 => grid_case(), 1 => float_case()]
}

fn cases(count: u32) -> ProptestConfig {
    ProptestConfig {
        failure_persistence: None,
        max_shrink_iters: 2000,
        ..ProptestConfig::with_cases(count)
    }
}

proptest! {
    #![proptest_config(cases(2000))]

    #[test]
    fn visibility_is_symmetric(case in any_case()) {
        let world = World::new(case.triangles.clone());
        prop_assert_eq!(sees(&world, &case.a, &case.b)?, sees(&world, &case.b, &case.a)?);
    }

    #[test]
    fn adding_triangles_never_reveals(case in any_case(), kept in 1..5usize) {
        let n = case.triangles.len();
        let few = Case { triangles: case.triangles[..kept.min(n.div_ceil(2))].to_vec(), ..case.clone() };
        let half = Case { triangles: case.triangles[..n.div_ceil(2)].to_vec(), ..case.clone() };
        let seen = [few.sees()?, half.sees()?, case.sees()?];
        prop_assert!(seen[0] >= seen[1] && seen[1] >= seen[2], "{:?}", seen);
    }

    #[test]
    fn growing_polygon_never_hides_it(case in any_case(), corner in any::<Index>(), times in 2..4i32) {
        // The polygon grows away from one of its corners, so the grown polygon contains the original.
        let grown = |p: &[DVec3]| -> Vec<DVec3> {
            let o = p[corner.index(p.len())];
            p.iter().map(|x| o + (*x - o) * f64::from(times)).collect()
        };
        // Sums and multiples of floats with such similar magnitudes are exact in doubles.
        let world = World::new(case.triangles.clone());
        let seen = sees(&world, &case.a, &case.b)?;
        let (a, b) = (grown(&case.a), grown(&case.b));
        let (from_more, of_more) = (sees(&world, &a, &case.b)?, sees(&world, &case.a, &b)?);
        let both = sees(&world, &a, &b)?;
        prop_assert!(from_more >= seen && of_more >= seen, "{seen} {from_more} {of_more}");
        prop_assert!(both >= from_more && both >= of_more, "{from_more} {of_more} {both}");
    }

    #[test]
    fn verdict_is_independent_of_order_of_triangles_and_corners(
        ordered_case in any_case().prop_flat_map(|case| {
            let order: Vec<usize> = (0..case.triangles.len()).collect();
            (Just(case), Just(order).prop_shuffle())
        }),
        turns in prop::collection::vec(0..6usize, 60),
        ends in prop::array::uniform2(any::<Index>()),
    ) {
        let (case, order) = ordered_case;
        let turned = |[a, b, c]: Corners, how: usize| {
            [[a, b, c], [b, c, a], [c, a, b], [c, b, a], [b, a, c], [a, c, b]][how]
        };
        let around = |p: &[DVec3], at: Index, back: bool| {
            let mut p = p.to_vec();
            let at = at.index(p.len());
            p.rotate_left(at);
            if back {
                p.reverse();
            }
            p
        };
        let other = Case {
            triangles: order.iter().map(|i| turned(case.triangles[*i], turns[*i % turns.len()])).collect(),
            a: around(&case.a, ends[0], turns[0] % 2 == 0),
            b: around(&case.b, ends[1], turns[1] % 2 == 0),
        };
        prop_assert_eq!(case.sees()?, other.sees()?);
    }

    #[test]
    fn scaling_turning_and_mirroring_preserve_verdict(
        case in any_case(),
        exponent in -40..40i32,
        axes in Just(vec![0usize, 1, 2]).prop_shuffle(),
        signs in prop::array::uniform3(select(vec![1.0, -1.0])),
    ) {
        let scale = 2f64.powi(exponent);
        let other = case.mapped(|p| {
            DVec3::from([0, 1, 2].map(|i| p[axes[i]])) * DVec3::from(signs) * scale
        });
        prop_assert_eq!(case.sees()?, other.sees()?);
    }

    #[test]
    fn whole_steps_along_grid_preserve_verdict(
        case in grid_case(),
        steps in prop::array::uniform3(-400_000..400_000i32),
    ) {
        let by = DVec3::from(steps.map(f64::from));
        prop_assert_eq!(case.sees()?, case.mapped(|p| p + by).sees()?);
    }

    #[test]
    fn shearing_grid_preserves_verdict(
        case in grid_case(),
        by in prop::array::uniform3(-3..=3i32),
    ) {
        // An affine map maps lines to lines, and whole numbers stay whole numbers.
        let [x, y, z] = by.map(f64::from);
        let sheared = case.mapped(|p| {
            let p = DVec3::new(p.x + x * p.y, p.y, p.z);
            let p = DVec3::new(p.x, p.y + y * p.z, p.z);
            DVec3::new(p.x, p.y, p.z + z * p.x)
        });
        prop_assert_eq!(case.sees()?, sheared.sees()?);
    }

    #[test]
    fn cutting_triangles_preserves_verdict(case in grid_case()) {
        let cut = |[a, b, c]: Corners| {
            let [p, q, r] = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
            [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
        };
        // All triangles are cut, and then every other triangle, which leaves corners on their neighbours'
        // edges.
        let some = |which: usize| Case {
            triangles: case
                .triangles
                .iter()
                .enumerate()
                .flat_map(|(i, t)| if i % which == 0 { cut(*t).to_vec() } else { vec![*t] })
                .collect(),
            ..case.clone()
        };
        let seen = case.sees()?;
        prop_assert_eq!(some(1).sees()?, seen);
        prop_assert_eq!(some(2).sees()?, seen);
    }

    #[test]
    fn polygon_is_visible_if_part_of_it_is(case in grid_case()) {
        let world = World::new(case.triangles.clone());
        let whole = sees(&world, &case.a, &case.b)?;
        // A triangle or parallelogram is cut in two, from a corner to the middle of an edge that does not end
        // there.
        let parts = |p: &[DVec3]| {
            let middle = (p[1] + p[2]) / 2.0;
            let mut rest = vec![p[0], middle];
            rest.extend(&p[2..]);
            [vec![p[0], p[1], middle], rest]
        };
        let (a, b) = (parts(&case.a), parts(&case.b));
        let mut seen = false;
        for (a, b) in a.iter().flat_map(|a| b.iter().map(move |b| (a, b))) {
            seen |= sees(&world, a, b)?;
        }
        prop_assert_eq!(seen, whole);
    }
}
