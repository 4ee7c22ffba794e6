//! Tests of point location, and of points in closed solids, in cavities and on borders.

#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use glam::Vec3;
use proptest::prelude::*;
use sightline_scene::{Kinds, Object, Scene, SurfaceKind, Triangle};
use sightline_tetra::check::check;
use sightline_tetra::file::write;
use sightline_tetra::{Quiet, Scratch, Tets, build};

type T = [[f32; 3]; 3];

/// Returns the twelve triangles of a box; the normals point out if `out` is true, otherwise in.
fn cube(low: [f32; 3], high: [f32; 3], out: bool) -> Vec<T> {
    let corner = |bits: usize| -> [f32; 3] {
        std::array::from_fn(|k| if bits >> k & 1 == 1 { high[k] } else { low[k] })
    };
    let sides = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let halves = sides
        .into_iter()
        .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
    halves
        .map(|[a, b, c]| if out { [a, b, c] } else { [a, c, b] }.map(corner))
        .collect()
}

fn tets(triangles: &[T]) -> Tets {
    tets_with(triangles, &[])
}

/// Builds the cells of triangles of which some are see-through.
fn tets_with(triangles: &[T], see_through: &[u32]) -> Tets {
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
    let kind = |id: u32| {
        if see_through.contains(&id) {
            SurfaceKind::SeeThrough
        } else {
            SurfaceKind::Opaque
        }
    };
    let kinds = Kinds::from_runs((0..count).map(|id| (1, kind(id), "a test")), Vec::new());
    let scene = Scene::new("test", triangles, vec![object])
        .unwrap()
        .with_kinds("test", kinds)
        .unwrap();
    let built = build(&scene, &Quiet).unwrap();
    assert_eq!(check(&built.contents()), Ok(()));
    let mut file = Vec::new();
    write(&mut file, &built.contents()).unwrap();
    Tets::from_bytes(&file).unwrap()
}

fn inside(tets: &Tets, x: [f64; 3]) -> bool {
    tets.inside(x, &mut Scratch::default()).unwrap()
}

#[test]
fn solid_contains_inside_but_not_border() {
    let tets = tets(&cube([0.0; 3], [1.0; 3], true));
    for (x, expected) in [
        ([0.5; 3], true),
        ([1e-300, 0.5, 0.5], true),
        ([0.0, 0.5, 0.5], false),
        ([1.0; 3], false),
        ([-0.001, 0.5, 0.5], false),
        // The first point is in the box around all cells, the second point is outside of it.
        ([1.03, 0.5, 0.5], false),
        ([1e30, 0.5, 0.5], false),
    ] {
        assert_eq!(inside(&tets, x), expected, "{x:?}");
    }
    assert!(
        tets.inside([f64::NAN, 0.0, 0.0], &mut Scratch::default())
            .is_err()
    );
}

#[test]
fn cavities_are_inside_but_rooms_and_open_boxes_are_not() {
    let mut hollow = cube([0.0; 3], [4.0; 3], true);
    hollow.extend(cube([1.0; 3], [3.0; 3], false));
    let hollow = tets(&hollow);
    assert!(
        [0.5, 1.2, 2.0, 3.5]
            .into_iter()
            .all(|at| inside(&hollow, [at; 3]))
    );
    // The scene is a crate in a room whose walls face in.
    let mut level = cube([0.0; 3], [4.0; 3], false);
    level.extend(cube([1.5; 3], [2.5; 3], true));
    let level = tets(&level);
    assert!(inside(&level, [2.0; 3]) && !inside(&level, [1.0; 3]) && !inside(&level, [4.2; 3]));
    let room = cube([0.0; 3], [4.0; 3], false);
    assert!(!inside(&tets(&room), [2.0; 3]));
    assert!(!inside(
        &tets(&cube([0.0; 3], [4.0; 3], true)[1..]),
        [2.0; 3]
    ));
    // A box with a window is open, and a pane on a box does not open the box.
    let closed = cube([0.0; 3], [4.0; 3], true);
    assert!(!inside(&tets_with(&closed, &[3]), [2.0; 3]));
    let mut with_pane = closed.clone();
    with_pane.push([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, -1.0, 2.0]]);
    assert!(
        !inside(&tets(&with_pane), [2.0; 3]) && inside(&tets_with(&with_pane, &[12]), [2.0; 3])
    );
    // There are two solids that overlap, and two that touch. The function tests if a point is inside their
    // union.
    let mut two = cube([0.0; 3], [1.0; 3], true);
    two.extend(cube([0.25, 0.25, 0.25], [2.0; 3], true));
    let two = tets(&two);
    assert!(inside(&two, [0.5; 3]) && inside(&two, [0.1; 3]) && inside(&two, [1.5; 3]));
    assert!(inside(&two, [1.0, 0.5, 0.5]) && !inside(&two, [1.5, 0.1, 0.1]));
    let mut touching = cube([0.0; 3], [1.0; 3], true);
    touching.extend(cube([1.0, 0.25, 0.25], [2.0, 0.75, 0.75], true));
    let touching = tets(&touching);
    assert!(inside(&touching, [1.0, 0.5, 0.5]) && !inside(&touching, [1.0, 0.1, 0.5]));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// A point is inside if it is in a box whose normals point out; boxes may cross one another.
    ///
    /// From any start cell, the walk ends in a cell that contains the point.
    #[test]
    fn points_are_inside_boxes_that_face_out(
        boxes in prop::collection::vec(
            (prop::array::uniform3(0i8..6), prop::array::uniform3(1i8..4), any::<bool>()),
            1..4,
        ),
        points in prop::collection::vec(prop::array::uniform3(-1.0f64..9.0), 8),
        hint in any::<u32>(),
    ) {
        let mut triangles = Vec::new();
        let place = |k: usize, v: i8| f32::from(v) + 0.125 * k as f32;
        let all: Vec<([f32; 3], [f32; 3], bool)> = boxes
            .iter()
            .enumerate()
            // The offset prevents that two boxes share a side, so that no two surfaces become one.
            .map(|(n, (low, size, out))| {
                (low.map(|v| place(n, v)), std::array::from_fn(|k| place(n, low[k] + size[k])), *out)
            })
            .collect();
        all.iter().for_each(|(low, high, out)| triangles.extend(cube(*low, *high, *out)));
        let tets = tets(&triangles);
        let mut scratch = Scratch::default();
        for x in points {
            let within = |low: &[f32; 3], high: &[f32; 3]| {
                (0..3).all(|k| f64::from(low[k]) < x[k] && x[k] < f64::from(high[k]))
            };
            let solids = all
                .iter()
                .filter(|(low, high, out)| *out && within(low, high))
                .count();
            prop_assert_eq!(tets.inside(x, &mut scratch).unwrap(), solids > 0, "{:?}", x);
            let cells = tets.contents().cells.cell_count() as u32;
            let found = [None, Some(hint), Some(hint % cells)].map(|hint| tets.locate(x, hint).unwrap());
            prop_assert_eq!(found[0].is_some(), found[1].is_some());
            prop_assert_eq!(found[0].is_some(), found[2].is_some());
        }
    }
}
