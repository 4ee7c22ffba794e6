//! Openness compared with closed forms, in the original frame and in rotated and scaled frames.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec3};
use sightline_ambient::Falloff;
use sightline_ambient::Light;
use sightline_ambient::Openness;
use sightline_ambient::Receiver;
use sightline_ambient::{AmbientScene, BlockMemory, ReceiverResult, Solver, SolverSettings};
use sightline_scene::{Kinds, Object, Scene, SurfaceKind, Triangle, TriangleId};

/// The tolerance of values, because scenes round coordinates to single precision.
const NEAR: f64 = 1e-6;

fn scene(triangles: &[[DVec3; 3]]) -> Scene {
    let triangles: Vec<Triangle> = triangles
        .iter()
        .map(|t| Triangle {
            v: t.map(DVec3::as_vec3),
        })
        .collect();
    let object = Object {
        name: "all".to_owned(),
        first: 0,
        count: triangles.len() as u32,
    };
    Scene::new("test", triangles, vec![object]).unwrap()
}

/// Creates the two triangles of a parallelogram.
fn quad(at: DVec3, u: DVec3, v: DVec3) -> [[DVec3; 3]; 2] {
    [[at, at + u, at + u + v], [at, at + u + v, at + v]]
}

fn rectangle(min: [f64; 3], max: [f64; 3]) -> Vec<[DVec3; 3]> {
    let (min, max) = (DVec3::from(min), DVec3::from(max));
    let d = max - min;
    let axes: Vec<DVec3> = [DVec3::X * d.x, DVec3::Y * d.y, DVec3::Z * d.z]
        .into_iter()
        .filter(|a| *a != DVec3::ZERO)
        .collect();
    quad(min, axes[0], axes[1]).to_vec()
}

fn answer(
    triangles: &[[DVec3; 3]],
    settings: SolverSettings,
    receiver: Receiver,
) -> ReceiverResult {
    let prepared = AmbientScene::new(&scene(triangles), settings.fragments).unwrap();
    Solver::new(&prepared, settings)
        .solve(&[receiver], |_| {})
        .remove(0)
}

/// Creates a receiver at the origin that looks up.
fn up() -> Receiver {
    Receiver {
        point: DVec3::ZERO,
        normal: DVec3::Z,
        triangle: None,
    }
}

/// Computes the openness of the origin looking up, in several frames, and checks that all results agree.
fn open(triangles: &[[DVec3; 3]], distance: f64) -> f64 {
    open_within(triangles, distance, NEAR)
}

fn open_within(triangles: &[[DVec3; 3]], distance: f64, near: f64) -> f64 {
    let mut first = None;
    for (axis, angle, scale) in [
        (DVec3::X, 0.0, 1.0),
        (DVec3::new(1.0, 2.0, 3.0), 0.7, 0.01),
        (DVec3::new(-3.0, 1.0, 2.0), 2.1, 100.0),
    ] {
        let turn = DMat3::from_quat(DQuat::from_axis_angle(axis.normalize(), angle)) * scale;
        let moved: Vec<[DVec3; 3]> = triangles.iter().map(|t| t.map(|v| turn * v)).collect();
        let receiver = Receiver {
            point: DVec3::ZERO,
            normal: turn * DVec3::Z,
            triangle: None,
        };
        for fragments in [false, true] {
            let settings = SolverSettings {
                fragments,
                ..SolverSettings::new(distance * scale)
            };
            let answer = answer(&moved, settings, receiver);
            let expected = *first.get_or_insert(answer.openness.open);
            let Openness { open, bound, .. } = answer.openness;
            assert!(
                (open - expected).abs() < near,
                "{open} and {expected}, fragments {fragments}"
            );
            assert!(bound < 1e-8, "{bound}");
            if fragments {
                let sum: f64 = answer.fragments.iter().map(|f| f.factor).sum();
                assert!((sum + open - 1.0).abs() < 1e-12, "{sum} {open}");
            }
        }
    }
    first.unwrap()
}

fn assert_near(value: f64, expected: f64) {
    assert!((value - expected).abs() < NEAR, "{value}, not {expected}");
}

#[test]
fn endless_wall_matches_closed_form() {
    // An endless wall, except for the missing ends: the factor of Howell's rectangle at a right angle.
    let (d, h, w) = (2.0f64, 3.0f64, 60.0f64);
    let (x, y) = (h / w, d / w);
    let half = ((1.0 / y).atan() - y / x.hypot(y) * (1.0 / x.hypot(y)).atan()) / (2.0 * PI);
    let endless = (1.0 + d / d.hypot(h)) / 2.0;
    assert!((1.0 - 2.0 * half - endless).abs() < 1e-3);
    let wall = rectangle([d, -w, 0.0], [d, w, h]);
    assert_near(open(&wall, f64::INFINITY), 1.0 - 2.0 * half);
}

#[test]
fn rectangles_have_howells_factors() {
    let (a, b, c) = (2.0f64, 3.0f64, 1.5f64);
    // A rectangle parallel to the receiver, with a corner above it (Howell, configuration B-3).
    let (x, y) = (a / c, b / c);
    let (p, q) = (x.hypot(1.0), y.hypot(1.0));
    let above = (x / p * (y / p).atan() + y / q * (x / q).atan()) / (2.0 * PI);
    assert_near(
        open(&rectangle([0.0, 0.0, c], [a, b, c]), f64::INFINITY),
        1.0 - above,
    );
    // A rectangle at a right angle to the receiver, with its foot at a distance (B-4).
    let (x, y) = (a / b, c / b);
    let beside = ((1.0 / y).atan() - y / x.hypot(y) * (1.0 / x.hypot(y)).atan()) / (2.0 * PI);
    assert_near(
        open(&rectangle([c, 0.0, 0.0], [c, b, a]), f64::INFINITY),
        1.0 - beside,
    );
}

#[test]
fn polygon_openness_lies_between_disks() {
    let (r, h, n) = (1.0f64, 2.0f64, 64u32);
    let at = |k: u32| {
        let (y, x) = (f64::from(k) / f64::from(n) * 2.0 * PI).sin_cos();
        DVec3::new(r * x, r * y, h)
    };
    let fan: Vec<[DVec3; 3]> = (0..n).map(|k| [DVec3::Z * h, at(k), at(k + 1)]).collect();
    let disk = |r: f64| 1.0 - r * r / (r * r + h * h);
    let value = open(&fan, f64::INFINITY);
    assert!(
        disk(r) < value && value < disk(r * (PI / f64::from(n)).cos()),
        "{value}"
    );
}

#[test]
fn sphere_matches_closed_form() {
    let (radius, away) = (1.0f64, 3.0f64);
    let tilt = 0.8f64;
    let centre = DVec3::new(away * tilt.sin(), 0.0, away * tilt.cos());
    let n = 96u32;
    let at = |i: u32, j: u32| {
        let (sp, cp) = (f64::from(i) / f64::from(n) * PI).sin_cos();
        let (st, ct) = (f64::from(j) / f64::from(n) * PI).sin_cos();
        centre + DVec3::new(sp * ct, sp * st, cp) * radius
    };
    let mut all = Vec::new();
    for i in 0..n {
        for j in 0..2 * n {
            all.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            all.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    all.retain(|t| (t[1] - t[0]).cross(t[2] - t[0]).length() > 1e-9);
    let value = answer(&all, SolverSettings::new(f64::INFINITY), up())
        .openness
        .open;
    let expected = 1.0 - radius * radius * tilt.cos() / (away * away);
    // Chords lie inside the sphere.
    assert!(
        expected <= value && value < expected + 3e-4,
        "{value} {expected}"
    );
}

#[test]
fn valley_is_open_between_slopes() {
    // A point on the floor between two endless slopes, which begin at the sides of the floor.
    let (slope, width, long) = (0.9f64, 1.0f64, 1e5f64);
    let far = 1e5;
    let (s, c) = slope.sin_cos();
    let right = quad(
        DVec3::new(width, -long, 0.0),
        DVec3::Y * 2.0 * long,
        DVec3::new(c, 0.0, s) * far,
    );
    let left = quad(
        DVec3::new(-width, -long, 0.0),
        DVec3::Y * 2.0 * long,
        DVec3::new(-c, 0.0, s) * far,
    );
    let value = open(&[right, left].concat(), f64::INFINITY);
    assert!((value - slope.cos()).abs() < 1e-4, "{value}");
}

fn walls(min: [f64; 3], max: [f64; 3]) -> Vec<[DVec3; 3]> {
    let mut all = Vec::new();
    for axis in 0..3 {
        for end in [min, max] {
            let (mut lo, mut hi) = (min, max);
            (lo[axis], hi[axis]) = (end[axis], end[axis]);
            all.extend(rectangle(lo, hi));
        }
    }
    all
}

#[test]
fn hole_lights_closed_box() {
    let closed = walls([-1.0, -2.0, -0.5], [1.5, 1.0, 2.0]);
    assert!(open(&closed, f64::INFINITY).abs() < 1e-12);
    // The ceiling, z = 2, with a hole of 0.5 by 0.5 above the point's corner.
    let mut holed: Vec<[DVec3; 3]> = closed
        .into_iter()
        .filter(|t| t.iter().any(|v| v.z != 2.0))
        .collect();
    for (min, max) in [
        ([-1.0, -2.0, 2.0], [0.0, 1.0, 2.0]),
        ([0.5, -2.0, 2.0], [1.5, 1.0, 2.0]),
        ([0.0, -2.0, 2.0], [0.5, 0.0, 2.0]),
        ([0.0, 0.5, 2.0], [0.5, 1.0, 2.0]),
    ] {
        holed.extend(rectangle(min, max));
    }
    let x = 0.25f64;
    let p = x.hypot(1.0);
    let hole = 2.0 * (x / p * (x / p).atan()) / (2.0 * PI);
    assert_near(open(&holed, f64::INFINITY), hole);
}

#[test]
fn slits_are_exact_to_one_thousandth() {
    for width in [1e-3, 1e-5] {
        // Two plates at height 1 with a slit along y between them.
        let far = 1e4;
        let plates = [
            rectangle([-far, -far, 1.0], [-width / 2.0, far, 1.0]),
            rectangle([width / 2.0, -far, 1.0], [far, far, 1.0]),
        ]
        .concat();
        let value = answer(&plates, SolverSettings::new(f64::INFINITY), up())
            .openness
            .open;
        // The factor of the strip, and the part that the plates leave open at the horizon.
        let half = f64::from((width / 2.0) as f32);
        let strip = half / half.hypot(1.0);
        let beyond = {
            let x = far;
            let p = x.hypot(1.0);
            1.0 - 4.0 * (2.0 * (x / p * (x / p).atan()) / (2.0 * PI))
        };
        assert!(
            (value - strip - beyond).abs() < 1e-3 * strip,
            "{value} {strip} {beyond}"
        );
    }
}

#[test]
fn duplicated_occluders_do_not_change_openness() {
    let one = rectangle([0.5, -1.0, 1.0], [2.0, 1.0, 1.0]);
    let value = open(&one, f64::INFINITY);
    let mut thrice = one.clone();
    for scale in [1.5, 0.5] {
        thrice.extend(one.iter().map(|t| t.map(|v| v * scale)));
    }
    assert_near(open(&thrice, f64::INFINITY), value);
    // Identical triangles, too.
    assert_near(open(&[one.clone(), one].concat(), f64::INFINITY), value);
}

#[test]
fn crossing_quads_hide_union() {
    // Two squares that cross along a line above the point, and their union in pieces that do not cross.
    let a = quad(
        DVec3::new(-1.0, -1.0, 1.0),
        DVec3::X * 2.0,
        DVec3::new(0.0, 2.0, 1.0),
    );
    let b = quad(
        DVec3::new(-1.0, -1.0, 2.0),
        DVec3::X * 2.0,
        DVec3::new(0.0, 2.0, -1.0),
    );
    let crossing = open(&[a, b].concat(), f64::INFINITY);
    let lower = quad(
        DVec3::new(-1.0, -1.0, 1.0),
        DVec3::X * 2.0,
        DVec3::new(0.0, 1.0, 0.5),
    );
    let upper = quad(
        DVec3::new(-1.0, 0.0, 1.5),
        DVec3::X * 2.0,
        DVec3::new(0.0, 1.0, -0.5),
    );
    assert_near(crossing, open(&[lower, upper].concat(), f64::INFINITY));
}

#[test]
fn near_plane_hides_circle() {
    let (h, d) = (0.7, 2.0);
    let ceiling = rectangle([-10.0, -10.0, h], [10.0, 10.0, h]);
    assert_near(open(&ceiling, d), (h / d) * (h / d));
    assert_near(open(&ceiling, 0.6), 1.0);
    // Two layers, and a duplicated layer.
    let two = [
        ceiling.clone(),
        rectangle([-10.0, -10.0, 0.9], [10.0, 10.0, 0.9]),
        ceiling,
    ]
    .concat();
    assert_near(open(&two, d), (h / d) * (h / d));
}

#[test]
fn near_wall_hides_circle_segment() {
    let (h, d) = (0.7f64, 2.0f64);
    let wall = rectangle([h, -10.0, 0.0], [h, 10.0, 10.0]);
    let alpha = (h / d).acos();
    assert_near(
        open(&wall, d),
        1.0 - (alpha - alpha.sin() * alpha.cos()) / PI,
    );
}

#[test]
fn many_triangles_hide_as_much_as_square() {
    let square = rectangle([-0.5, -1.0, 1.0], [1.5, 1.0, 1.0]);
    let value = open(&square, f64::INFINITY);
    // 400 triangles over random points of a grid whose corners were moved within the square.
    let n = 14usize;
    let mut state = 1u64;
    let mut random = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
    };
    let mut grid = vec![vec![DVec3::ZERO; n + 1]; n + 1];
    for (i, row) in grid.iter_mut().enumerate() {
        for (j, corner) in row.iter_mut().enumerate() {
            let inner = |k: usize| if k == 0 || k == n { 0.0 } else { 0.6 };
            let (x, y) = (
                i as f64 + inner(i) * random(),
                j as f64 + inner(j) * random(),
            );
            *corner = DVec3::new(-0.5 + 2.0 * x / n as f64, -1.0 + 2.0 * y / n as f64, 1.0);
        }
    }
    let mut all = Vec::new();
    for i in 0..n {
        for j in 0..n {
            let [a, b, c, d] = [
                grid[i][j],
                grid[i + 1][j],
                grid[i + 1][j + 1],
                grid[i][j + 1],
            ];
            all.extend([[a, b, c], [a, c, d]]);
        }
    }
    assert_eq!(all.len(), 392);
    // The rotated frames round the triangles, but shared edges stay shared.
    assert_near(open(&all, f64::INFINITY), value);
    assert_near(open(&all, 1.3), open(&square, 1.3));
}

#[test]
fn triangle_that_contains_point_is_ignored() {
    let floor = rectangle([-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]);
    assert_near(open(&floor, f64::INFINITY), 1.0);
    let wall = rectangle([0.0, -1.0, -1.0], [0.0, 1.0, 1.0]);
    assert_near(open(&wall, f64::INFINITY), 1.0);
}

#[test]
fn sqrt_falloff_matches_closed_form() {
    let (h, d) = (0.7f64, 2.0f64);
    let c = h / d;
    let expected = 4.0 / 3.0 * c.sqrt() - c * c / 3.0;
    let settings = SolverSettings {
        falloff: Falloff::Sqrt,
        ..SolverSettings::new(d)
    };
    let ceiling = rectangle([-10.0, -10.0, h], [10.0, 10.0, h]);
    assert_near(
        answer(&ceiling, settings.clone(), up()).openness.open,
        expected,
    );
    // Triangles behind the ceiling, and divided or duplicated triangles, do not change the result.
    let mut more = ceiling.clone();
    more.extend(rectangle([-10.0, -10.0, 0.9], [10.0, 10.0, 0.9]));
    more.extend(rectangle([-1.0, -10.0, h], [10.0, 10.0, h]));
    assert_near(answer(&more, settings, up()).openness.open, expected);
}

#[test]
fn wall_hides_half_of_light() {
    // A square light over the point, and a wall below half of it.
    let (a, h) = (1.0f64, 2.0f64);
    let light = Light::new(&[[-a, -a, h], [a, -a, h], [a, a, h], [-a, a, h]]).unwrap();
    let (x, p) = (a / h, (a / h).hypot(1.0));
    let whole = 4.0 * (2.0 * (x / p * (x / p).atan()) / (2.0 * PI));
    let lit = |triangles: &[[DVec3; 3]]| {
        let settings = SolverSettings {
            lights: vec![light.clone()],
            ..SolverSettings::new(0.5)
        };
        answer(triangles, settings, up()).lights[0]
    };
    let aside = rectangle([50.0, 50.0, 0.0], [51.0, 51.0, 0.0]);
    assert_near(lit(&aside), whole);
    let half = rectangle([0.0, -5.0, 1.0], [5.0, 5.0, 1.0]);
    assert_near(lit(&half), whole / 2.0);
    // A wall behind the light does not hide it. A wall that crosses its plane hides it with the nearer part.
    // The light's own face in the scene does not hide it.
    assert_near(lit(&rectangle([-5.0, -5.0, 3.0], [5.0, 5.0, 3.0])), whole);
    assert_near(lit(&rectangle([-a, -a, h], [a, a, h])), whole);
    let crossing = quad(
        DVec3::new(0.0, -5.0, 1.0),
        DVec3::Y * 10.0,
        DVec3::new(3.0, 0.0, 9.0),
    );
    let seen = lit(&crossing);
    assert!(seen > whole / 2.0 && seen < whole, "{seen} {whole}");
}

#[test]
fn points_in_closed_solid_are_inside() {
    let closed = |outward: bool| {
        let turn = |t: [DVec3; 3]| {
            let (n, c) = ((t[1] - t[0]).cross(t[2] - t[0]), t[0] + t[1] + t[2]);
            if (n.dot(c) > 0.0) == outward {
                t
            } else {
                [t[0], t[2], t[1]]
            }
        };
        walls([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])
            .into_iter()
            .map(turn)
            .collect::<Vec<_>>()
    };
    let at = |triangles: &[[DVec3; 3]], point: DVec3, normal: DVec3| {
        answer(
            triangles,
            SolverSettings::new(f64::INFINITY),
            Receiver {
                point,
                normal,
                triangle: None,
            },
        )
        .inside
    };
    let (solid, room) = (closed(true), closed(false));
    assert!(at(&solid, DVec3::new(0.1, 0.2, 0.3), DVec3::Z));
    assert!(!at(&solid, DVec3::new(0.1, 0.2, 1.3), DVec3::Z));
    // The point on the surface: above the surface, and below it.
    assert!(!at(&solid, DVec3::new(0.1, 0.2, 1.0), DVec3::Z));
    assert!(at(&solid, DVec3::new(0.1, 0.2, 1.0), DVec3::NEG_Z));
    // A room is not a solid.
    assert!(!at(&room, DVec3::new(0.1, 0.2, 0.3), DVec3::Z));
    // A surface that a see-through pane closes is not a solid either.
    let runs = [
        (solid.len() as u32 - 1, SurfaceKind::Opaque, "a test"),
        (1, SurfaceKind::SeeThrough, "a test"),
    ];
    let pane = scene(&solid)
        .with_kinds("test", Kinds::from_runs(runs, Vec::new()))
        .unwrap();
    let prepared = AmbientScene::new(&pane, false).unwrap();
    let point = Receiver {
        point: DVec3::new(0.1, 0.2, 0.3),
        normal: DVec3::Z,
        triangle: None,
    };
    let answer = Solver::new(&prepared, SolverSettings::new(f64::INFINITY))
        .solve(&[point], |_| {})
        .remove(0);
    assert!(!answer.inside);
}

/// Asserts that an answer is correct within its own bound, for coordinates that single precision represents.
fn assert_bounded(answer: &ReceiverResult, expected: f64) {
    let Openness { open, bound, .. } = answer.openness;
    assert!(
        (open - expected).abs() <= bound + 1e-15,
        "{open} is off by {:e}, {bound:e}",
        open - expected
    );
}

#[test]
fn circles_that_touch_borders_are_correct_within_bounds() {
    // A ceiling at height 3 that ends at x = 4, exactly at the circle of the distance 5.
    let ceiling = rectangle([-32.0, -32.0, 3.0], [4.0, 32.0, 3.0]);
    for fragments in [false, true] {
        let settings = SolverSettings {
            fragments,
            ..SolverSettings::new(5.0)
        };
        assert_bounded(&answer(&ceiling, settings, up()), 0.36);
    }
    // Two ceilings whose circles touch each other.
    let tilted = quad(
        DVec3::new(-64.0, -64.0, -45.0),
        DVec3::Y * 128.0,
        DVec3::new(64.0, 0.0, 48.0),
    );
    let both = [ceiling, tilted.to_vec()].concat();
    let joint = answer(&both, SolverSettings::new(5.0), up());
    assert!(joint.openness.open <= 0.36 + joint.openness.bound);
}

#[test]
fn large_near_planes_are_correct_within_bounds() {
    let (d, height) = (0.125, 0.0625);
    let plane = [[
        DVec3::new(-16384.0, -8192.0, height),
        DVec3::new(16384.0, -8192.0, height),
        DVec3::new(0.0, 16384.0, height),
    ]];
    for fragments in [false, true] {
        let settings = SolverSettings {
            fragments,
            ..SolverSettings::new(d)
        };
        assert_bounded(&answer(&plane, settings, up()), 0.25);
    }
}

/// The bound of a receiver near an edge grows in inverse proportion to the distance from the edge. The
/// receiver of a vertex can lie one rounding error away from the edge of a wall on its surface. The plane
/// through point and edge is known only to about 10⁻¹⁵ L/d.
#[test]
fn bound_beside_edge_grows_as_distance_shrinks() {
    let (wide, high) = (4.0f64, 8.0f64);
    let wall = rectangle([0.0, -wide, 0.0], [0.0, wide, high]);
    let mut last = 0.0;
    for power in 3..=12 {
        let d = 10f64.powi(-power);
        let receiver = Receiver {
            point: DVec3::new(-d, 0.0, 0.0),
            ..up()
        };
        let answer = answer(&wall, SolverSettings::new(f64::INFINITY), receiver);
        let slope = d.hypot(high);
        let hidden = ((wide / d).atan() - d / slope * (wide / slope).atan()) / PI;
        assert_bounded(&answer, 1.0 - hidden);
        let bound = answer.openness.bound;
        assert!(bound <= 1e-14 * high / d, "{bound:e} at {d:e}");
        assert!(bound > last, "{bound:e} at {d:e} after {last:e}");
        last = bound;
    }
}

#[test]
fn surface_of_receiver_does_not_hide() {
    // Single precision cannot represent a tenth, so the points are below the quad.
    let floor = quad(DVec3::new(0.0, 0.0, 0.1), DVec3::X, DVec3::Y);
    let ceiling = quad(DVec3::new(0.0, 0.0, 0.2), DVec3::X, DVec3::Y);
    let at = |x: f64, y: f64, z: f64, normal: DVec3, triangle| Receiver {
        point: DVec3::new(x, y, z),
        normal,
        triangle: Some(TriangleId(triangle)),
    };
    let up = |x, y, triangle| at(x, y, 0.1, DVec3::Z, triangle);
    for fragments in [false, true] {
        let settings = SolverSettings {
            fragments,
            ..SolverSettings::new(10.0)
        };
        let prepared = AmbientScene::new(&scene(&floor), fragments).unwrap();
        let solver = Solver::new(&prepared, settings.clone());
        for answer in solver.solve(&[up(0.7, 0.2, 0), up(0.2, 0.7, 1)], |_| {}) {
            assert_near(answer.openness.open, 1.0);
        }
        // A block with receivers on two surfaces, which the solver does not create: the two surfaces still
        // hide each other.
        let prepared = AmbientScene::new(&scene(&[floor, ceiling].concat()), fragments).unwrap();
        let solver = Solver::new(&prepared, settings);
        let block = [up(0.5, 0.4, 0), at(0.5, 0.4, 0.2, DVec3::NEG_Z, 2)];
        for answer in solver.block(&block, &mut BlockMemory::default()) {
            assert!(answer.openness.open < 0.2, "{}", answer.openness.open);
        }
    }
}

#[test]
fn point_on_solid_is_not_inside() {
    // The top of the cube is at the single-precision tenth, slightly above the point.
    let cube: Vec<[DVec3; 3]> = walls([0.0, 0.0, 0.0], [0.1, 0.1, 0.1])
        .into_iter()
        .map(|t| {
            let outwards = (t[1] - t[0])
                .cross(t[2] - t[0])
                .dot(t[0] + t[1] + t[2] - DVec3::splat(0.15))
                > 0.0;
            if outwards { t } else { [t[0], t[2], t[1]] }
        })
        .collect();
    let top = |t: &[DVec3; 3]| {
        t.iter().all(|v| v.z > 0.09) && (t[0].x - t[1].x).abs() + (t[0].y - t[1].y).abs() > 0.0
    };
    let id = cube.iter().position(top).unwrap() as u32;
    let point = DVec3::new(0.03, 0.05, 0.1);
    for (triangle, inside) in [(id, false), (id + 1, false)] {
        // Select the triangle of the top that contains the point.
        let [a, b, c] = cube[triangle as usize];
        let on = [(a, b), (b, c), (c, a)]
            .iter()
            .all(|(p, q)| (*q - *p).cross(point - *p).z > 0.0);
        if on {
            let receiver = Receiver {
                point,
                normal: DVec3::Z,
                triangle: Some(TriangleId(triangle)),
            };
            assert_eq!(
                answer(&cube, SolverSettings::new(1.0), receiver).inside,
                inside
            );
        }
    }
}

#[test]
fn light_with_near_corners_is_hidden() {
    let light = Light::new(&[
        [0.0, 0.0, 10.0],
        [1.0, 0.0, 10.0],
        [1.0, 1.0, 10.0],
        [0.0, 1e-20, 10.0],
    ])
    .unwrap();
    let settings = SolverSettings {
        lights: vec![light],
        ..SolverSettings::new(1.0)
    };
    let wall = rectangle([-5.0, -5.0, 5.0], [5.0, 5.0, 5.0]);
    assert!(answer(&wall, settings.clone(), up()).lights[0] < 1e-12);
    let aside = rectangle([50.0, 50.0, 5.0], [51.0, 51.0, 5.0]);
    assert!(answer(&aside, settings, up()).lights[0] > 1e-3);
}
