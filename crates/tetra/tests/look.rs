//! Tests of known sets and solid angles.

#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::f64::consts::PI;

use glam::Vec3;
use sightline_scene::{Object, Scene, Triangle};
use sightline_tetra::Quiet;
use sightline_tetra::cells::{Tetrahedra, cells};
use sightline_tetra::delaunay::Delaunay;
use sightline_tetra::point_query::{
    Engine, Hierarchy, Looker, Mode, Scratch, Target, View, VisibleTriangles,
};
use sightline_tetra::surfaces::Surfaces;

fn scene(triangles: &[[[f32; 3]; 3]]) -> Scene {
    let triangles: Vec<Triangle> = triangles
        .iter()
        .map(|t| Triangle {
            v: t.map(Vec3::from_array),
        })
        .collect();
    let count = triangles.len() as u32;
    Scene::new(
        "test",
        triangles,
        vec![Object {
            name: "all".into(),
            first: 0,
            count,
        }],
    )
    .unwrap()
}

fn look_as(triangles: &[[[f32; 3]; 3]], x: [f64; 3], view: &View, mode: Mode) -> VisibleTriangles {
    let surfaces = Surfaces::new(&scene(triangles)).unwrap();
    let hierarchy = Hierarchy::new(surfaces.view());
    let mut scratch = Scratch::default();
    Looker::new(surfaces.view(), hierarchy.view())
        .look(x, view, mode, &mut scratch)
        .unwrap()
        .clone()
}

fn look(triangles: &[[[f32; 3]; 3]], x: [f64; 3]) -> VisibleTriangles {
    let view = View {
        witnesses: true,
        ..View::default()
    };
    look_as(triangles, x, &view, Mode::Exact)
}

/// Returns the rectangle with four corners as two triangles.
fn quad(a: [f32; 3], b: [f32; 3], c: [f32; 3], d: [f32; 3]) -> [[[f32; 3]; 3]; 2] {
    [[a, b, c], [a, c, d]]
}

/// Returns the twelve triangles of a box.
fn cube(low: [f32; 3], high: [f32; 3]) -> Vec<[[f32; 3]; 3]> {
    let p =
        |x: usize, y: usize, z: usize| [[low, high][x][0], [low, high][y][1], [low, high][z][2]];
    let mut all = Vec::new();
    all.extend(quad(p(0, 0, 0), p(0, 1, 0), p(1, 1, 0), p(1, 0, 0)));
    all.extend(quad(p(0, 0, 1), p(1, 0, 1), p(1, 1, 1), p(0, 1, 1)));
    all.extend(quad(p(0, 0, 0), p(1, 0, 0), p(1, 0, 1), p(0, 0, 1)));
    all.extend(quad(p(0, 1, 0), p(0, 1, 1), p(1, 1, 1), p(1, 1, 0)));
    all.extend(quad(p(0, 0, 0), p(0, 0, 1), p(0, 1, 1), p(0, 1, 0)));
    all.extend(quad(p(1, 0, 0), p(1, 1, 0), p(1, 1, 1), p(1, 0, 1)));
    all
}

fn total(seen: &VisibleTriangles) -> f64 {
    seen.areas.iter().sum::<f64>() + seen.sky + seen.unseen + seen.dropped
}

/// Computes the solid angle of a rectangle in the plane at distance h.
///
/// The rectangle has the opposite corners (a, b) and (c, d).
///
/// The result is a sum of the arctangents of the four corners.
fn rectangle(a: f64, b: f64, c: f64, d: f64, h: f64) -> f64 {
    let f = |x: f64, y: f64| libm::atan2(x * y, h * (x * x + y * y + h * h).sqrt());
    f(c, d) - f(a, d) - f(c, b) + f(a, b)
}

#[test]
fn closed_box_is_fully_visible_from_inside() {
    let room = cube([0.0; 3], [1.0, 2.0, 3.0]);
    for x in [[0.5, 1.0, 1.5], [0.01, 0.02, 2.9], [0.1, 1.7, 0.3]] {
        let seen = look(&room, x);
        assert_eq!(seen.visible, (0..12).collect::<Vec<u32>>());
        assert_eq!(seen.sky, 0.0);
        assert!((total(&seen) - 4.0 * PI).abs() < 1e-12, "{}", total(&seen));
        assert!(seen.witnesses.iter().all(Option::is_some));
    }
    let seen = look(&room, [5.0, 1.0, 1.5]);
    assert_eq!(seen.visible, [10, 11]);
    let side = rectangle(-1.0, -1.5, 1.0, 1.5, 4.0);
    assert!(
        (seen.areas.iter().sum::<f64>() - side).abs() < 1e-13,
        "{:?} {side}",
        seen.areas
    );
}

#[test]
fn slit_shows_wall_behind() {
    for width in [0.1f32, 1e-3, 1e-6] {
        // The scene is a wall of two parts with a slit between them, and a wall behind it.
        let (a, b) = (-width / 2.0, width / 2.0);
        let mut all = Vec::new();
        all.extend(quad(
            [-9.0, -9.0, 1.0],
            [a, -9.0, 1.0],
            [a, 9.0, 1.0],
            [-9.0, 9.0, 1.0],
        ));
        all.extend(quad(
            [b, -9.0, 1.0],
            [9.0, -9.0, 1.0],
            [9.0, 9.0, 1.0],
            [b, 9.0, 1.0],
        ));
        all.extend(quad(
            [-9.0, -9.0, 2.0],
            [9.0, -9.0, 2.0],
            [9.0, 9.0, 2.0],
            [-9.0, 9.0, 2.0],
        ));
        let seen = look(&all, [0.0; 3]);
        assert_eq!(seen.visible, [0, 1, 2, 3, 4, 5], "{width}");
        let slit = f64::from(width) / 2.0;
        // As directions at z = 1, the visible part has the width of the slit and the height of the wall
        // behind.
        let truth = rectangle(-slit, -4.5, slit, 4.5, 1.0);
        let behind = seen.areas[4] + seen.areas[5];
        assert!((behind - truth).abs() < 1e-12, "{width}: {behind} {truth}");
        assert!((total(&seen) - 4.0 * PI).abs() < 1e-12);
    }
}

/// Returns a wall in the plane z with a window from (a, b) to (c, d).
///
/// The wall consists of four rectangles of two triangles.
fn wall(z: f32, [a, b, c, d]: [f32; 4]) -> Vec<[[f32; 3]; 3]> {
    let part = |x0: f32, y0: f32, x1: f32, y1: f32| {
        quad([x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z])
    };
    [
        part(-9.0, -9.0, a, 9.0),
        part(c, -9.0, 9.0, 9.0),
        part(a, -9.0, c, b),
        part(a, d, c, 9.0),
    ]
    .concat()
}

/// Three walls have staggered windows. The directions through all three windows form a rectangle.
#[test]
fn staggered_windows_show_common_part() {
    // The windows are in the planes z = 1, 2 and 3. Divided by z, their coordinates are directions at z = 1.
    let windows = [
        [-0.5f32, -0.5, 0.25, 0.25],
        [0.0, -1.0, 1.0, 0.0],
        [-1.5, -0.75, 0.375, 1.5],
    ];
    let mut all: Vec<_> = (1u8..)
        .zip(windows)
        .flat_map(|(z, w)| wall(f32::from(z), w))
        .collect();
    all.extend(quad(
        [-50.0, -50.0, 9.0],
        [50.0, -50.0, 9.0],
        [50.0, 50.0, 9.0],
        [-50.0, 50.0, 9.0],
    ));
    // The common part has x from 0, where the second window begins, to 0.125, where the third window ends. It
    // has y from −0.25, where the third window begins, to 0, where the second window ends.
    let truth = rectangle(0.0, -0.25, 0.125, 0.0, 1.0);
    for (scale, shift) in [
        (1.0f32, 0.0f32),
        (3.0, 0.0),
        (0.01, 0.0),
        (100.0, 0.0),
        (1.0, 64.0),
        (8.0, -1024.0),
    ] {
        for turn in 0..3 {
            let moved = |p: [f32; 3]| std::array::from_fn(|k| p[(k + turn) % 3] * scale + shift);
            let there: Vec<_> = all.iter().map(|t| t.map(moved)).collect();
            let seen = look(&there, moved([0.0; 3]).map(f64::from));
            let last = all.len() - 2;
            let area: f64 = seen
                .visible
                .iter()
                .zip(&seen.areas)
                .filter(|v| *v.0 as usize >= last)
                .map(|v| v.1)
                .sum();
            // The products of 3 or 0.01 and a coordinate are rounded.
            let bound = if scale == 3.0 || scale == 0.01 || scale == 100.0 {
                1e-7
            } else {
                1e-13
            };
            assert!(
                (area - truth).abs() < bound,
                "{scale} {shift} {turn}: {area} {truth}"
            );
            assert!((total(&seen) - 4.0 * PI).abs() < 1e-12);
        }
    }
    // A window that begins where the previous window ends hides everything behind it.
    let shut = wall(3.0, [-1.5, -0.75, 0.0, 1.5]);
    all.splice(16..24, shut);
    assert!(look(&all, [0.0; 3]).visible.iter().all(|t| *t < 24));
}

#[test]
fn closed_seams_hide_everything_behind() {
    // The wall consists of strips with corners that do not agree (T-junctions). Its coordinates are not exact
    // in binary.
    let mut all = Vec::new();
    let cut = |k: u32, n: u32| -3.0 + 6.0 * (k as f32) / (n as f32);
    for (row, (z0, z1)) in [(-3.0f32, -0.7f32), (-0.7, 1.1), (1.1, 3.0)]
        .into_iter()
        .enumerate()
    {
        let n = 3 + row as u32 * 2;
        for k in 0..n {
            let (p, q) = (cut(k, n), cut(k + 1, n));
            all.extend(quad([p, 1.3, z0], [q, 1.3, z0], [q, 1.3, z1], [p, 1.3, z1]));
        }
    }
    let walls = all.len() as u32;
    all.extend(quad(
        [-0.5, 1.9, -0.5],
        [0.5, 1.9, -0.5],
        [0.5, 1.9, 0.5],
        [-0.5, 1.9, 0.5],
    ));
    let seen = look(&all, [0.1, 0.2, 0.3]);
    assert_eq!(seen.visible, (0..walls).collect::<Vec<u32>>());
}

#[test]
fn overlap_area_belongs_to_smallest_id() {
    let t = [[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0f32]];
    let turned = [t[0], t[2], t[1]];
    let shifted = t.map(|p| [p[0] + 0.5, p[1], p[2]]);
    let seen = look(&[t, turned, shifted, t], [0.0; 3]);
    assert_eq!(seen.visible, [0, 1, 2, 3]);
    let alone = look(&[t], [0.0; 3]).areas[0];
    let union = look(&[shifted], [0.0; 3]);
    assert!((seen.areas[0] - alone).abs() < 1e-14);
    assert_eq!((seen.areas[1], seen.areas[3]), (0.0, 0.0));
    assert!(seen.areas[2] > 0.0 && seen.areas[2] < union.areas[0]);
    assert!((total(&seen) - 4.0 * PI).abs() < 1e-12);
}

#[test]
fn conservative_mode_decides_doubled_triangles() {
    // Walls with two sides cover each octant completely.
    let mut room = cube([0.0; 3], [1.0, 2.0, 3.0]);
    room.extend(room.clone().iter().map(|t| [t[0], t[2], t[1]]));
    let view = View {
        witnesses: true,
        ..View::default()
    };
    let seen = look_as(&room, [0.4, 0.9, 1.3], &view, Mode::Conservative(PI));
    assert_eq!(seen.visible, (0..24).collect::<Vec<u32>>());
    assert_eq!(seen.dropped, 0.0);
    assert!((total(&seen) - 4.0 * PI).abs() < 1e-12);
}

/// The viewpoint is so near to a corner that products of the vectors to the other corners underflow.
#[test]
fn viewpoint_at_corner_sees_same_set_as_nearby() {
    let t = [[0.0, 0.0, 0.0], [0.375, 0.625, 0.0], [0.5625, 0.0, 0.9375]];
    let near = look(&[t], [1e-100; 3]);
    for x in [5e-324, 1e-320, 1e-300, 1e-200] {
        let seen = look(&[t], [x; 3]);
        assert_eq!(seen.visible, near.visible, "{x}");
        assert!(
            (seen.areas[0] - near.areas[0]).abs() < 1e-12,
            "{x}: {:?} {:?}",
            seen.areas,
            near.areas
        );
    }
}

/// Beams of a distant viewpoint exclude as many boxes as beams of a near viewpoint.
///
/// So the number of boxes per beam does not grow with the scene.
#[test]
fn boxes_per_beam_stay_bounded_for_distant_scenes() {
    let crowd: Vec<_> = (0..3000u16)
        .map(|k| {
            let part = |by: f32| (f32::from(k) * by).fract();
            let p = [part(0.7548), part(0.5698), part(0.3247)];
            [p, [p[0], p[1] + 0.01, p[2]], [p[0], p[1], p[2] + 0.01]]
        })
        .collect();
    let boxes_a_beam = |x: f64| {
        let seen = look(&crowd, [x, 0.1, 0.2]);
        seen.cells as f64 / seen.beams as f64
    };
    let (near, far) = (boxes_a_beam(5.0), boxes_a_beam(3e5));
    assert!(
        far < 4.0 * near,
        "{near} boxes a beam nearby, {far} far away"
    );
}

#[test]
fn crossing_rectangles_hide_half_of_each_other() {
    let mut all = Vec::new();
    all.extend(quad(
        [-1.0, -1.0, 2.0],
        [1.0, -1.0, 4.0],
        [1.0, 1.0, 4.0],
        [-1.0, 1.0, 2.0],
    ));
    all.extend(quad(
        [-1.0, -1.0, 4.0],
        [1.0, -1.0, 2.0],
        [1.0, 1.0, 2.0],
        [-1.0, 1.0, 4.0],
    ));
    let seen = look(&all, [0.0; 3]);
    assert_eq!(seen.visible, [0, 1, 2, 3]);
    let halves = [seen.areas[0] + seen.areas[1], seen.areas[2] + seen.areas[3]];
    assert!((halves[0] - halves[1]).abs() < 1e-13, "{halves:?}");
}

#[test]
fn viewpoint_in_triangle_sees_both_sides() {
    let t = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0f32]];
    let up = t.map(|p| [p[0], p[1], 1.0]);
    let down = t.map(|p| [p[0], p[1], -1.0]);
    let flat = t.map(|p| [p[0] + 5.0, p[1], p[2]]);
    let all = [t, up, down, flat];
    // These viewpoints are inside the triangle, on an edge, and at a corner.
    for x in [[0.0, 0.0, 0.0], [0.0, -1.0, 0.0], [1.0, -1.0, 0.0]] {
        let seen = look(&all, x);
        assert_eq!(seen.visible, [0, 1, 2], "{x:?}");
        assert_eq!(seen.areas[0], 0.0);
    }
    // This viewpoint is in the triangle's plane but outside of the triangle.
    assert_eq!(look(&all, [0.0, 1.5, 0.0]).visible, [1, 2]);
}

#[test]
fn cones_and_distances_limit_view() {
    let room = cube([-1.0; 3], [1.0; 3]);
    let cap = |half: f64| 2.0 * PI * (1.0 - half.cos());
    for degrees in [1.0f64, 40.0, 90.0, 150.0, 179.0, 200.0, 300.0, 360.0] {
        let view = View {
            direction: Some([0.3, -0.2, 0.9]),
            angle: degrees.to_radians(),
            ..View::default()
        };
        let seen = look_as(&room, [0.1, 0.2, -0.1], &view, Mode::Exact);
        let truth = cap(degrees.to_radians() / 2.0);
        assert!(
            (total(&seen) - truth).abs() < 1e-9,
            "{degrees}: {} {truth}",
            total(&seen)
        );
    }
    // The wall is at distance 1, so a distance of 2 leaves a disk of 60 degrees around the wall's normal.
    let wall = quad(
        [-90.0, -90.0, 1.0],
        [90.0, -90.0, 1.0],
        [90.0, 90.0, 1.0],
        [-90.0, 90.0, 1.0],
    );
    let view = View {
        distance: Some(2.0),
        ..View::default()
    };
    let seen = look_as(&wall, [0.0; 3], &view, Mode::Exact);
    assert!(
        (seen.areas.iter().sum::<f64>() - cap(PI / 3.0)).abs() < 1e-12,
        "{:?}",
        seen.areas
    );
    assert!((total(&seen) - 4.0 * PI).abs() < 1e-12);
    let view = View {
        distance: Some(0.99),
        ..View::default()
    };
    assert!(
        look_as(&wall, [0.0; 3], &view, Mode::Exact)
            .visible
            .is_empty()
    );
}

#[test]
fn sees_computes_shares_of_boxes() {
    // A wall hides the lower half of a box's front.
    let wall = quad(
        [-9.0, -9.0, 1.0],
        [9.0, -9.0, 1.0],
        [9.0, 0.0, 1.0],
        [-9.0, 0.0, 1.0],
    );
    let surfaces = Surfaces::new(&scene(&wall)).unwrap();
    let hierarchy = Hierarchy::new(surfaces.view());
    let looker = Looker::new(surfaces.view(), hierarchy.view());
    let mut scratch = Scratch::default();
    let mut share = |low, high| {
        looker
            .sees(
                [0.0; 3],
                &Target { low, high },
                &View::default(),
                Mode::Exact,
                &mut scratch,
            )
            .unwrap()
    };
    assert!((share([-1.0, -1.0, 2.0], [1.0, 1.0, 3.0]) - 0.5).abs() < 1e-12);
    assert_eq!(share([-1.0, -3.0, 2.0], [1.0, -1.0, 3.0]), 0.0);
    assert_eq!(share([-1.0, 1.0, 2.0], [1.0, 2.0, 3.0]), 1.0);
    // One box is in front of the wall, one is around the point, and one has no thickness.
    assert_eq!(share([-1.0, -1.0, 0.5], [1.0, 1.0, 0.75]), 1.0);
    assert_eq!(share([-1.0, -1.0, -0.5], [1.0, 1.0, 0.75]), 1.0);
    assert!((share([-1.0, -1.0, 2.0], [1.0, 1.0, 2.0]) - 0.5).abs() < 1e-12);
    // The wall cuts through this box.
    assert!((share([-1.0, -2.0, 0.5], [1.0, 1.0, 3.0]) - 1.0).abs() < 1e-12);
}

/// Prints the times of the scene whose path is in `TETRA_SCENE`.
///
/// Run `TETRA_SCENE=F cargo test -p sightline-tetra --test look -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn print_times() {
    let scene = sightline_scene::load(std::path::Path::new(&std::env::var("TETRA_SCENE").unwrap()))
        .unwrap();
    let surfaces = Surfaces::new(&scene).unwrap();
    let hierarchy = Hierarchy::new(surfaces.view());
    let start = std::time::Instant::now();
    let Delaunay {
        points,
        tetrahedra,
        neighbours,
    } = &Delaunay::new(&surfaces.points).unwrap();
    let (cells, counts) = cells(
        &surfaces,
        &Tetrahedra {
            points,
            tetrahedra,
            neighbours,
        },
        &Quiet,
    )
    .unwrap();
    println!(
        "{} triangles, {} tetrahedra, {} cells, {:?}, {:.1} s",
        surfaces.triangles.len(),
        tetrahedra.len(),
        cells.view().cell_count(),
        counts,
        start.elapsed().as_secs_f64()
    );
    let looker = Looker::with_cells(surfaces.view(), hierarchy.view(), cells.view());
    let mut scratch = Scratch::default();
    let bounds = scene.bounds();
    let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    for k in 0..12u32 {
        let part = glam::DVec3::new(
            0.5 + 0.4 * (f64::from(k) * 2.4).sin(),
            0.5 + 0.4 * (f64::from(k) * 3.7).sin(),
            0.5 + 0.4 * (f64::from(k) * 1.3).sin(),
        );
        let x = low + (high - low) * part;
        for engine in [Engine::Boxes, Engine::Cells] {
            let view = View {
                engine,
                ..View::default()
            };
            let start = std::time::Instant::now();
            let seen = looker
                .look(x.to_array(), &view, Mode::Exact, &mut scratch)
                .unwrap();
            let time = start.elapsed().as_secs_f64();
            println!(
                "{engine:?} {:6} seen {:9} beams {:10} boxes {:10} signs {:7} {:8.1} ms {:6.1} us {:.1e}",
                seen.visible.len(),
                seen.beams,
                seen.cells,
                seen.decided,
                seen.integers,
                time * 1e3,
                time * 1e6 / seen.visible.len().max(1) as f64,
                seen.areas.iter().sum::<f64>() + seen.sky + seen.unseen - 4.0 * PI,
            );
        }
    }
}
