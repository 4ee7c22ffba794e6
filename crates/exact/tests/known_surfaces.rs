//! Tests of seams and closed surfaces whose visibility is known by construction, at many scales and
//! rotations.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

mod common;

use std::cmp::Ordering;

use common::truth::{hidden, visible};
use common::{Draft, Random, exact, ordered, rounded};
use glam::{DVec3, Vec3};
use sightline_geometry::predicates::orient3d_sign;

#[test]
fn shared_edge_of_two_triangles_leaves_no_crack() {
    for place in exact().iter().chain(&ordered()).chain(&rounded()) {
        let mut draft = Draft::new(place);
        // The shared edge runs from (−4, −4) to (4, 4).
        draft.rectangle(1.0, [-4.0, 4.0], [-4.0, 4.0]);
        let world = draft.done();
        // The lines pass through the edge, which appears as a point (from the side), as a line, and from a
        // slit of the same shape.
        let (a, b) = (
            place.square([0.0, 0.0, 0.0], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        hidden(&world, &a, &b, place);
        let thin = |z: f64| {
            place.polygon(&[
                [-1.0, -1.0, z],
                [1.0, 1.0, z],
                [0.9, 0.91, z],
                [-0.9, -0.89, z],
            ])
        };
        hidden(&world, &thin(0.0), &thin(2.0), place);
        let tall =
            |z: [f64; 2]| place.polygon(&[[-1.0, -1.0, z[0]], [1.0, 1.0, z[0]], [0.0, 0.0, z[1]]]);
        hidden(&world, &tall([0.5, 0.25]), &tall([1.5, 1.75]), place);
        hidden(&world, &tall([0.25, 0.5]), &thin(2.0), place);
    }
    for place in &exact() {
        let mut draft = Draft::new(place);
        draft.rectangle(1.0, [-4.0, 4.0], [-4.0, 4.0]);
        let world = draft.done();
        // The lines run along the edge: both ends touch the wall's plane, across the edge's line, on
        // different sides of the wall.
        let end = |c: f64, z: f64| {
            place.polygon(&[
                [c + 1.0, c - 1.0, 1.0],
                [c - 1.0, c + 1.0, 1.0],
                [c - 1.0, c + 1.0, z],
                [c + 1.0, c - 1.0, z],
            ])
        };
        hidden(&world, &end(-2.0, 2.0), &end(2.0, 0.0), place);
        // If both ends are on the same side, the wall is not in between.
        visible(&world, &end(-2.0, 2.0), &end(2.0, 2.0), place);
        visible(&world, &end(-2.0, 2.0), &end(2.0, 1.5), place);
    }
}

#[test]
fn roof_is_closed_along_ridge() {
    for place in exact().iter().chain(&rounded()) {
        for bend in [-1.0, -0.001, 0.001, 1.0] {
            let mut draft = Draft::new(place);
            draft.quad([
                [0.0, -4.0, 4.0],
                [0.0, 4.0, 4.0],
                [4.0, 4.0, 4.0 + bend],
                [4.0, -4.0, 4.0 + bend],
            ]);
            draft.quad([
                [0.0, -4.0, 4.0],
                [-4.0, -4.0, 4.0 + bend],
                [-4.0, 4.0, 4.0 + bend],
                [0.0, 4.0, 4.0],
            ]);
            let world = draft.done();
            let (a, b) = (
                place.square([0.0, 0.0, 2.0], 1.0),
                place.square([0.0, 0.0, 6.0], 1.0),
            );
            hidden(&world, &a, &b, place);
            // These polygons are in the plane of symmetry, through the ridge.
            let upright = |z: [f64; 2]| {
                place.polygon(&[[0.0, -1.0, z[0]], [0.0, 1.0, z[0]], [0.0, 0.0, z[1]]])
            };
            hidden(&world, &a, &upright([6.0, 7.0]), place);
            hidden(&world, &upright([2.0, 1.0]), &b, place);
        }
    }
}

#[test]
fn corners_on_edges_leave_no_cracks() {
    for place in exact().iter().chain(&ordered()) {
        let mut draft = Draft::new(place);
        for (x, rows) in [
            ([-4.0, 0.25], vec![-4.0, 0.0, 4.0]),
            ([0.25, 4.0], vec![-4.0, -0.3, 0.125, 0.3, 4.0]),
        ] {
            for row in rows.windows(2) {
                draft.rectangle(1.0, x, [row[0], row[1]]);
            }
        }
        let world = draft.done();
        let (a, b) = (
            place.square([0.0, 0.0, 0.0], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        hidden(&world, &a, &b, place);
    }
    for place in &exact() {
        // One triangle is above the diagonal. Many below meet it at `middle` and at other corners.
        let wall = |middle: [f64; 2]| {
            let mut draft = Draft::new(place);
            draft.triangle([[-4.0, -4.0, 1.0], [4.0, 4.0, 1.0], [-4.0, 4.0, 1.0]]);
            let on = [[-4.0, -4.0], [-1.0, -1.0], middle, [1.5, 1.5], [4.0, 4.0]];
            for pair in on.windows(2) {
                let [p, q] = [pair[0], pair[1]];
                draft.triangle([[p[0], p[1], 1.0], [4.0, -4.0, 1.0], [q[0], q[1], 1.0]]);
            }
            draft.done()
        };
        let (a, b) = (
            place.square([0.0, 0.0, 0.0], 2.0),
            place.square([0.0, 0.0, 2.0], 2.0),
        );
        hidden(&wall([0.5, 0.5]), &a, &b, place);
        hidden(&wall([0.25, 0.25]), &a, &b, place);
        // The corner is a unit in the last place beyond the edge, which overlaps, or before the edge, which
        // leaves a crack.
        hidden(&wall([0.5, f64::from(0.5f32.next_up())]), &a, &b, place);
        visible(&wall([0.5, f64::from(0.5f32.next_down())]), &a, &b, place);
    }
}

/// Creates a triangle with each corner at a random position in a ball.
fn somewhere(random: &mut Random, centre: DVec3, radius: f64) -> [[f64; 3]; 3] {
    [0; 3].map(|_| (centre + random.direction() * random.between(0.3, 1.0) * radius).to_array())
}

#[test]
fn closed_mesh_hides_outside_from_inside() {
    let mut random = Random::new(1);
    for place in exact().iter().chain(&rounded()) {
        for sphere in [false, true] {
            let mut draft = Draft::new(place);
            if sphere {
                draft.sphere([0.0; 3], 1.0, 1);
            } else {
                draft.solid([-1.0; 3], [1.0; 3]);
            }
            let world = draft.done();
            for _ in 0..4 {
                let inside = place.polygon(&somewhere(&mut random, DVec3::ZERO, 0.7));
                // The sphere is within 1 of the middle, the box within 1.8.
                let away = random.direction() * 3.0;
                let outside = place.polygon(&somewhere(&mut random, away, 0.9));
                hidden(&world, &inside, &outside, place);
                let other = place.polygon(&somewhere(&mut random, DVec3::ZERO, 0.7));
                visible(&world, &inside, &other, place);
                let beside = place.polygon(&somewhere(&mut random, away, 0.9));
                visible(&world, &outside, &beside, place);
            }
        }
    }
}

#[test]
fn polygon_sees_faces_of_ball_turned_towards_it() {
    let mut random = Random::new(2);
    for place in exact().iter().chain(&rounded()).filter(|p| p.scale == 1.0) {
        let mut draft = Draft::new(place);
        draft.sphere([0.0; 3], 1.0, 1);
        let world = draft.done();
        let mirrored = place.turn.determinant() < 0.0;
        let inside = place.polygon(&somewhere(&mut random, DVec3::ZERO, 0.7));
        let away = random.direction() * 2.2;
        let outside: [Vec3; 3] =
            somewhere(&mut random, away, 0.9).map(|p| place.turned(place.point(p)));
        let outside = outside.map(|p| p.as_dvec3());
        let mut towards = 0;
        for face in &world.triangles {
            let corners = face.map(|p| p.as_dvec3());
            visible(&world, &inside, &corners, place);
            let [a, b, c] = if mirrored {
                [face[0], face[2], face[1]]
            } else {
                *face
            };
            let seen = outside
                .iter()
                .any(|p| orient3d_sign(a, b, c, p.as_vec3()) == Ordering::Greater);
            towards += usize::from(seen);
            assert_eq!(
                world.mutual(&outside, &corners),
                seen,
                "{place:?} {face:?} {outside:?}"
            );
        }
        assert!(
            (1..world.triangles.len()).contains(&towards),
            "{towards} are turned towards the polygon"
        );
    }
}

#[test]
fn nested_boxes_keep_their_insides_apart() {
    for place in exact().iter().chain(&ordered()).chain(&rounded()) {
        let mut draft = Draft::new(place);
        draft.solid([-1.0; 3], [1.0; 3]);
        draft.solid([-2.0; 3], [2.0; 3]);
        draft.solid([-4.0; 3], [4.0; 3]);
        let world = draft.done();
        let at = |x: f64| place.polygon(&[[x, -0.5, -0.4], [x, 0.5, 0.1], [x + 0.2, 0.0, 0.5]]);
        // The rooms are inside each box and outside all boxes.
        let rooms = [0.0, 1.5, 3.0, 5.0];
        for (i, x) in rooms.iter().enumerate() {
            for y in &rooms[i + 1..] {
                hidden(&world, &at(*x), &at(*y), place);
            }
        }
        let again = |x: f64| place.polygon(&[[x, -0.3, -0.4], [x, 0.5, 0.2], [x + 0.1, 0.0, 0.3]]);
        for x in rooms {
            visible(&world, &at(x), &again(x + 0.1), place);
        }
        // The first polygon is around the corner of a box; the second is on the other side of the box.
        let beside = place.polygon(&[[0.5, 1.5, -0.5], [0.9, 1.9, -0.5], [0.7, 1.7, 0.5]]);
        visible(&world, &at(1.5), &beside, place);
        let opposite = place.polygon(&[[-1.5, -0.1, -0.1], [-1.5, 0.1, -0.1], [-1.6, 0.0, 0.1]]);
        let small = place.polygon(&[[1.5, -0.1, -0.1], [1.5, 0.1, -0.1], [1.6, 0.0, 0.1]]);
        hidden(&world, &small, &opposite, place);
    }
}
