//! Tests of sets from points in random scenes.
//!
//! The sets are compared with rays, with other triangle orders, and between modes.

#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::f64::consts::PI;

mod meshes;
mod shapes;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_scene::{Object, Scene, Triangle};
use sightline_tetra::check::check as check_cells;
use sightline_tetra::point_query::{
    BvhNode, Engine, Looker, Mode, Scratch, Target, View, VisibleTriangles,
};
use sightline_tetra::{Built, Quiet, build};

use meshes::{few_points, sheets};
use shapes::{T, lattice_of_cubes, saddle, schonhardt};

struct World(Built);

impl World {
    fn new(triangles: &[T]) -> Self {
        let triangles: Vec<Triangle> = triangles
            .iter()
            .map(|t| Triangle {
                v: t.map(Vec3::from_array),
            })
            .collect();
        let count = triangles.len() as u32;
        let object = Object {
            name: "all".into(),
            first: 0,
            count,
        };
        Self(
            build(
                &Scene::new("test", triangles, vec![object]).unwrap(),
                &Quiet,
            )
            .unwrap(),
        )
    }

    fn look(&self, x: [f64; 3], mode: Mode) -> VisibleTriangles {
        self.look_by(Engine::Boxes, x, mode)
    }

    fn look_by(&self, engine: Engine, x: [f64; 3], mode: Mode) -> VisibleTriangles {
        let view = View {
            witnesses: true,
            engine,
            ..View::default()
        };
        let mut scratch = Scratch::default();
        let looker = Looker::with_cells(
            self.0.surfaces.view(),
            self.0.hierarchy.view(),
            self.0.cells.view(),
        );
        looker.look(x, &view, mode, &mut scratch).unwrap().clone()
    }

    fn sees(&self, x: [f64; 3], target: &Target, mode: Mode) -> f64 {
        let mut scratch = Scratch::default();
        Looker::new(self.0.surfaces.view(), self.0.hierarchy.view())
            .sees(x, target, &View::default(), mode, &mut scratch)
            .unwrap()
    }
}

/// Generates triangles on a coarse lattice, on which edges, planes and corners often coincide.
fn lattice() -> impl Strategy<Value = Vec<T>> {
    prop::collection::vec(
        prop::array::uniform3(prop::array::uniform3(-3..=3i8)),
        1..24,
    )
    .prop_map(|all| {
        all.into_iter()
            .map(|t| t.map(|p| p.map(f32::from)))
            .collect()
    })
}

/// Generates many small triangles, so that beams exclude boxes.
fn crowd() -> impl Strategy<Value = Vec<T>> {
    let small = (
        prop::array::uniform3(-6..=6i8),
        prop::array::uniform3(prop::array::uniform3(-1..=1i8)),
    );
    prop::collection::vec(small, 100..400).prop_map(|all| {
        let corner = |at: [i8; 3], by: [i8; 3]| std::array::from_fn(|k| f32::from(at[k] + by[k]));
        all.into_iter()
            .map(|(at, t)| t.map(|by| corner(at, by)))
            .collect()
    })
}

/// Generates triangles at any position.
fn scattered() -> impl Strategy<Value = Vec<T>> {
    prop::collection::vec(
        prop::array::uniform3(prop::array::uniform3(-3.0..3.0f32)),
        1..24,
    )
}

/// Generates points on the half units of the lattice, and at any position.
fn point() -> impl Strategy<Value = [f64; 3]> {
    prop_oneof![
        prop::array::uniform3(-9..=9i8).prop_map(|p| p.map(|c| f64::from(c) / 2.0)),
        prop::array::uniform3(-5.0..5.0f64),
    ]
}

/// Returns the triangles that a ray meets first; several if they are in one plane.
///
/// Returns `None` if the ray passes near the border of a triangle.
fn first(triangles: &[T], x: DVec3, way: DVec3) -> Option<Vec<u32>> {
    let mut hits: Vec<(f64, u32)> = Vec::new();
    for (id, t) in (0..).zip(triangles) {
        let [a, b, c] = t.map(|p| DVec3::from(p.map(f64::from)) - x);
        let normal = (b - a).cross(c - a);
        let height = a.dot(normal);
        if normal.length() == 0.0 || height.abs() < 1e-12 {
            continue;
        }
        let turns = [a.cross(b), b.cross(c), c.cross(a)].map(|n| n.dot(way) * height.signum());
        if turns.iter().any(|t| t.abs() < 1e-7) {
            return None;
        }
        if turns.iter().all(|t| *t > 0.0) {
            hits.push((height / normal.dot(way), id));
        }
    }
    let nearest = hits.iter().map(|h| h.0).fold(f64::INFINITY, f64::min);
    Some(
        hits.iter()
            .filter(|h| h.0 <= nearest * (1.0 + 1e-12))
            .map(|h| h.1)
            .collect(),
    )
}

fn way(k: u32, n: u32) -> DVec3 {
    // The directions form a spiral over the sphere.
    let z = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(n);
    let turn = f64::from(k) * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * libm::cos(turn), r * libm::sin(turn), z)
}

fn check(triangles: &[T], x: [f64; 3]) -> Result<(), TestCaseError> {
    let world = World::new(triangles);
    let exact = world.look(x, Mode::Exact);
    let sum = exact.areas.iter().sum::<f64>() + exact.sky;
    prop_assert!(
        (sum - 4.0 * PI).abs() < 1e-11,
        "the parts add up to {}",
        sum
    );
    let at = DVec3::from(x);
    let rays = 500;
    for k in 0..rays {
        if let Some(hits) = first(triangles, at, way(k, rays)) {
            for hit in hits {
                prop_assert!(exact.visible.contains(&hit), "a ray meets {} first", hit);
            }
        }
    }
    for ((id, area), witness) in exact.visible.iter().zip(&exact.areas).zip(&exact.witnesses) {
        let Some(witness) = witness else {
            prop_assert!(
                *area < 1e-9,
                "{} has an area of {} and no witness",
                id,
                area
            );
            continue;
        };
        if let Some(hits) = first(triangles, at, DVec3::from(*witness).normalize()) {
            prop_assert!(hits.contains(id), "the witness of {} meets {:?}", id, hits);
        }
    }
    let cells = world.look_by(Engine::Cells, x, Mode::Exact);
    prop_assert_eq!(check_cells(&world.0.contents()), Ok(()));
    prop_assert_eq!(&exact.visible, &cells.visible, "boxes and cells differ");
    for (a, b) in exact.areas.iter().zip(&cells.areas) {
        prop_assert!((a - b).abs() < 1e-11, "{} and {}", a, b);
    }
    // The order of the triangles affects only their ids.
    let turned: Vec<T> = triangles.iter().rev().copied().collect();
    let last = triangles.len() as u32 - 1;
    let mut other: Vec<u32> = World::new(&turned)
        .look(x, Mode::Exact)
        .visible
        .iter()
        .map(|t| last - t)
        .collect();
    other.sort_unstable();
    prop_assert_eq!(&exact.visible, &other);
    for degrees in [0.5f64, 5.0, 40.0] {
        let angle = degrees.to_radians();
        for engine in [Engine::Boxes, Engine::Cells] {
            let less = world.look_by(engine, x, Mode::Aggressive(angle));
            let more = world.look_by(engine, x, Mode::Conservative(angle));
            prop_assert!(less.visible.iter().all(|t| exact.visible.contains(t)));
            prop_assert!(exact.visible.iter().all(|t| more.visible.contains(t)));
            for seen in [&less, &more] {
                let sum = seen.areas.iter().sum::<f64>() + seen.sky + seen.dropped;
                prop_assert!((sum - 4.0 * PI).abs() < 1e-11);
            }
        }
    }
    let target = Target {
        low: [-1.0, -2.0, 0.5],
        high: [1.5, -0.5, 2.0],
    };
    let share = world.sees(x, &target, Mode::Exact);
    prop_assert!(world.sees(x, &target, Mode::Aggressive(0.1)) <= share + 1e-12);
    let fraction = share_of_rays(triangles, at, &target);
    if let Some((part, of)) = fraction {
        // The tolerance is five standard deviations for this number of rays, which are spread more evenly
        // than at random.
        let spread = 5.0 * (0.25 / f64::from(of)).sqrt();
        prop_assert!(
            (f64::from(part) / f64::from(of) - share).abs() < spread,
            "{} of {}: {}",
            part,
            of,
            share
        );
    }
    Ok(())
}

/// Returns the number of rays that reach a box first, and of all rays that meet the box.
fn share_of_rays(triangles: &[T], x: DVec3, target: &Target) -> Option<(u32, u32)> {
    let (low, high) = (DVec3::from(target.low), DVec3::from(target.high));
    if x.cmpge(low).all() && x.cmple(high).all() {
        return None;
    }
    let (mut part, mut of) = (0, 0);
    for k in 0..4000 {
        let way = way(k, 4000);
        let (a, b) = ((low - x) / way, (high - x) / way);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        if near > far || far <= 0.0 {
            continue;
        }
        let Some(hits) = first(triangles, x, way) else {
            continue;
        };
        of += 1;
        let end = x + way * near;
        let before = hits.first().is_some_and(|t| {
            let [a, b, c] = triangles[*t as usize].map(|p| DVec3::from(p.map(f64::from)));
            let normal = (b - a).cross(c - a);
            (x - a).dot(normal) * (end - a).dot(normal) < -1e-12
        });
        part += u32::from(!before);
    }
    (of >= 100).then_some((part, of))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn lattice_sets_agree_with_rays_and_orders(triangles in lattice(), x in point()) {
        check(&triangles, x)?;
    }

    #[test]
    fn scattered_sets_agree_with_rays_and_orders(triangles in scattered(), x in point()) {
        check(&triangles, x)?;
    }

    #[test]
    fn few_point_sets_agree_with_rays_and_orders(triangles in few_points(), x in point()) {
        check(&triangles, x)?;
    }

    #[test]
    fn sheet_sets_agree_with_rays_and_orders(triangles in sheets(), x in point()) {
        check(&triangles, x)?;
    }

    #[test]
    fn excluded_boxes_contain_no_visible_triangle(triangles in crowd(), x in point()) {
        let mut world = World::new(&triangles);
        let seen = world.look(x, Mode::Exact);
        let few = world.look(x, Mode::Conservative(0.05));
        // All triangles are in one box, so no box is excluded.
        let all = world.0.hierarchy.nodes.first().copied();
        if let Some(all) = all {
            let count = world.0.hierarchy.order.len() as u32;
            world.0.hierarchy.nodes = vec![BvhNode { first: 0, count, ..all }];
        }
        prop_assert_eq!(&seen.visible, &world.look(x, Mode::Exact).visible);
        prop_assert_eq!(&seen.visible, &world.look_by(Engine::Cells, x, Mode::Exact).visible);
        let sum = seen.areas.iter().sum::<f64>() + seen.sky;
        prop_assert!((sum - 4.0 * PI).abs() < 1e-10);
        prop_assert!(seen.visible.iter().all(|t| few.visible.contains(t)));
    }

    #[test]
    fn scaling_by_power_of_two_keeps_result(triangles in lattice(), x in point(), power in -90..90i32) {
        let by = f64::powi(2.0, power);
        let scaled: Vec<T> =
            triangles.iter().map(|t| t.map(|p| p.map(|c| (f64::from(c) * by) as f32))).collect();
        let here = World::new(&triangles).look(x, Mode::Exact);
        let there = World::new(&scaled).look(x.map(|c| c * by), Mode::Exact);
        prop_assert_eq!(here.visible, there.visible);
        prop_assert_eq!(here.areas, there.areas);
    }
}

#[test]
fn speck_in_huge_box_is_visible() {
    let far = 1e7f32;
    let p = |k: usize| {
        [
            if k & 1 == 0 { -far } else { far },
            if k & 2 == 0 { -far } else { far },
            far,
        ]
    };
    let speck = [
        [1.0, 1.0, 1.0],
        [1.0 + 1e-6, 1.0, 1.0],
        [1.0, 1.0 + 1e-6, 1.0f32],
    ];
    let all = [[p(0), p(1), p(3)], [p(0), p(3), p(2)], speck];
    let seen = World::new(&all).look([0.9, 0.8, -3.0], Mode::Exact);
    assert_eq!(seen.visible, [0, 1, 2]);
    assert!(seen.areas[2] > 0.0 && seen.areas[2] < 1e-12);
}

/// Looks at the shapes that are hard to divide from points in, on and around them.
///
/// The points are in the middle of a shape, in planes and lines of its faces, and away from it.
#[test]
fn engines_agree_on_hard_shapes() {
    for x in [
        [0.05, 0.0, 0.02],
        [0.5, 0.5, 0.5],
        [0.0, 0.0, 1.0],
        [1.5, 0.25, 0.5],
        [-7.0, 3.0, 20.0],
    ] {
        for shape in [
            schonhardt(),
            saddle(),
            lattice_of_cubes(1.0, 0.0),
            lattice_of_cubes(0.1, 0.25),
        ] {
            check(&shape, x).unwrap();
        }
    }
}
