//! Tests of fences, touching polygons and degenerate triangles whose visibility is known by construction.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

mod common;

use common::truth::{empty, hidden, slit, visible};
use common::{Draft, Place, exact, ordered, permutations, rounded};
use glam::{DVec3, Vec3};
use sightline_exact::Polygon;

/// Adds pickets in a plane z, `width` wide around k + `middle` for whole k from −20 to 20.
fn fence(draft: &mut Draft<'_>, z: f64, middle: f64, width: f64) {
    for k in -20..=20 {
        let x = f64::from(k) + middle;
        draft.rectangle(z, [x - width / 2.0, x + width / 2.0], [-16.0, 16.0]);
    }
}

#[test]
fn fences_hide_only_if_they_close_each_others_gaps() {
    for place in exact().iter().filter(|p| p.scale >= 1.0) {
        let (a, b) = (
            place.square([0.0, 0.0, 0.0], 4.0),
            place.square([0.0, 0.0, 8.0], 4.0),
        );
        // Lines from A to B move sideways by at most one for each unit forward. The second fence's pickets
        // are in front of the first fence's gaps. Each gap is half a step wide.
        let world = |fences: &[(f64, f64, f64)]| {
            let mut draft = Draft::new(place);
            fences
                .iter()
                .for_each(|(z, middle, width)| fence(&mut draft, *z, *middle, *width));
            draft.done()
        };
        visible(&world(&[(4.0, 0.0, 0.5)]), &a, &b, place);
        visible(&world(&[(4.0, 0.0, 1.0 - 2f64.powi(-12))]), &a, &b, place);
        hidden(&world(&[(4.0, 0.0, 1.0)]), &a, &b, place);
        // In one plane the fences abut. One behind the other, they leave slanted lines free unless they
        // overlap.
        hidden(&world(&[(4.0, 0.0, 0.5), (4.0, 0.5, 0.5)]), &a, &b, place);
        visible(
            &world(&[(4.0, 0.0, 0.5), (4.0 + 2f64.powi(-10), 0.5, 0.5)]),
            &a,
            &b,
            place,
        );
        hidden(
            &world(&[(4.0, 0.0, 0.5), (4.0 + 2f64.powi(-10), 0.5, 0.75)]),
            &a,
            &b,
            place,
        );
        hidden(
            &world(&[(4.0, 0.0, 0.5), (4.125, 0.5, 0.75)]),
            &a,
            &b,
            place,
        );
        visible(&world(&[(4.0, 0.0, 0.5), (4.25, 0.5, 0.75)]), &a, &b, place);
        // The pickets are widened by exactly the gain of the steepest line from A to B.
        hidden(
            &world(&[(4.0, 0.0, 0.5), (4.125, 0.5, 0.75), (5.0, 0.0, 0.5)]),
            &a,
            &b,
            place,
        );
    }
}

#[test]
fn moving_one_of_three_edges_hides_polygon() {
    // The wall at 1 closes x ≥ y/4, the wall at 3 closes x ≥ −y/4, and the wall at 2 closes x ≤ limit. Free
    // lines have x₂ = (x₁ + x₃)/2 < (y₁ − y₃)/8, and y₁ − y₃ = (y₀ − y₄)/2 is at most 1. So free lines exist
    // exactly if the limit is below 1/8.
    let world = |place: &Place, limit: f64, without: usize| {
        let mut draft = Draft::new(place);
        if without != 1 {
            draft.quad([
                [-2.0, -8.0, 1.0],
                [64.0, -8.0, 1.0],
                [64.0, 8.0, 1.0],
                [2.0, 8.0, 1.0],
            ]);
        }
        if without != 2 {
            draft.rectangle(2.0, [-64.0, limit], [-8.0, 8.0]);
        }
        if without != 3 {
            draft.quad([
                [2.0, -8.0, 3.0],
                [64.0, -8.0, 3.0],
                [64.0, 8.0, 3.0],
                [-2.0, 8.0, 3.0],
            ]);
        }
        draft.done()
    };
    for place in &exact() {
        let (a, b) = (
            place.rectangle(0.0, [-4.0, 4.0], [-1.0, 1.0]),
            place.rectangle(4.0, [-4.0, 4.0], [-1.0, 1.0]),
        );
        for (limit, seen) in [
            (0.0, true),
            (0.125 - 2f64.powi(-10), true),
            (0.125 - 2f64.powi(-20), true),
            (0.125 - 2f64.powi(-26), true),
            (0.125, false),
            (0.125 + 2f64.powi(-20), false),
            (0.5, false),
        ] {
            assert_eq!(
                world(place, limit, 0).mutual(&a, &b),
                seen,
                "{limit} {place:?}"
            );
        }
        for without in 1..=3 {
            visible(&world(place, 0.125, without), &a, &b, place);
        }
    }
    for place in &rounded() {
        let (a, b) = (
            place.rectangle(0.0, [-4.0, 4.0], [-1.0, 1.0]),
            place.rectangle(4.0, [-4.0, 4.0], [-1.0, 1.0]),
        );
        visible(&world(place, 0.124, 0), &a, &b, place);
        hidden(&world(place, 0.126, 0), &a, &b, place);
    }
}

#[test]
fn touching_polygons_see_each_other_unless_in_one_plane() {
    for place in &exact() {
        let world = empty(place);
        let a = place.square([0.0; 3], 1.0);
        // These share a corner, an edge, or part of an edge, or have a corner on an edge, a corner inside, or
        // an edge inside.
        for b in [
            [[1.0, 1.0, 0.0], [2.0, 1.0, 1.0], [1.0, 2.0, 1.0]],
            [[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 2.0]],
            [[1.0, -0.5, 0.0], [1.0, 3.0, 0.0], [1.5, 0.0, 2.0]],
            [[1.0, 0.5, 0.0], [2.0, 1.0, 1.0], [1.0, 1.0, 1.0]],
            [[0.25, 0.5, 0.0], [2.0, 1.0, 1.0], [1.0, 1.0, 1.0]],
            [[-0.25, 0.5, 0.0], [0.25, 0.5, 0.0], [0.0, 0.5, -1.0]],
            // These cross A, pass entirely through it, pass through its corner, or pass through its edge.
            [[0.0, -2.0, -1.0], [0.0, 2.0, -1.0], [0.0, 0.0, 1.0]],
            [[0.5, -0.5, -1.0], [0.25, 0.5, -1.0], [0.0, 0.0, 1.0]],
            [[1.0, 1.0, -1.0], [2.0, 2.0, 0.5], [1.0, 1.0, 1.0]],
            [[1.0, -0.5, -1.0], [1.0, 0.5, -1.0], [1.0, 0.0, 1.0]],
            // The plane of A cuts the polygon next to A, or touches the polygon next to A.
            [[2.0, -1.0, -1.0], [2.0, 1.0, -1.0], [3.0, 0.0, 1.0]],
            [[2.0, -1.0, 0.0], [2.0, 1.0, 0.0], [3.0, 0.0, 1.0]],
            // The polygon's plane cuts A, or touches A, with the line of both planes along edges of both.
            [[0.0, -1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 2.0]],
            [[1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 0.0, 2.0]],
            [[1.0, 2.0, 0.0], [1.0, 3.0, 0.0], [1.0, 2.0, 1.0]],
        ] {
            visible(&world, &a, &place.polygon(&b), place);
        }
        // These are in A's plane: apart, touching, overlapping, and inside A.
        for b in [
            [[2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.0]],
            [[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [3.0, 0.0, 0.0]],
            [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]],
            [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]],
        ] {
            hidden(&world, &a, &place.polygon(&b), place);
        }
        hidden(&world, &a, &a, place);
    }
}

#[test]
fn dividing_blocker_hides_touching_polygons() {
    for place in &exact() {
        // Both share the edge from (0, 0, 0) to (0, 0, 1). The blocker begins at a distance `from` from it.
        let (a, b) = (
            place.polygon(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]),
            place.polygon(&[[0.0; 3], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
        );
        let divided = |from: f64| {
            let mut draft = Draft::new(place);
            draft.quad([
                [from, from, 0.0],
                [1.0, 1.0, 0.0],
                [1.0, 1.0, 1.0],
                [from, from, 1.0],
            ]);
            draft.done()
        };
        hidden(&divided(0.0), &a, &b, place);
        hidden(&divided(-1.0), &a, &b, place);
        visible(&divided(2f64.powi(-20)), &a, &b, place);
        visible(&divided(0.25), &a, &b, place);
        // The squares cross, and four corners between them must be closed.
        let upright = place.polygon(&[
            [0.0, -1.0, -1.0],
            [0.0, 1.0, -1.0],
            [0.0, 1.0, 1.0],
            [0.0, -1.0, 1.0],
        ]);
        let flat = place.square([0.0; 3], 1.0);
        let closed = |without: usize| {
            let mut draft = Draft::new(place);
            for (k, [x, z]) in [[2.0, 2.0], [-2.0, 2.0], [-2.0, -2.0], [2.0, -2.0]]
                .iter()
                .enumerate()
            {
                if k != without {
                    draft.quad([
                        [0.0, -2.0, 0.0],
                        [*x, -2.0, *z],
                        [*x, 2.0, *z],
                        [0.0, 2.0, 0.0],
                    ]);
                }
            }
            draft.done()
        };
        hidden(&closed(4), &flat, &upright, place);
        for without in 0..4 {
            visible(&closed(without), &flat, &upright, place);
        }
    }
}

#[test]
fn triangles_in_plane_of_polygon_do_not_block() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (
            place.square([0.0; 3], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        let mut draft = Draft::new(place);
        draft.rectangle(0.0, [-4.0, 4.0], [-4.0, 4.0]);
        draft.rectangle(0.0, [-1.0, 1.0], [-1.0, 1.0]);
        draft.rectangle(2.0, [-0.5, 4.0], [-4.0, 4.0]);
        draft.rectangle(2.0, [-4.0, 4.0], [-4.0, 4.0]);
        visible(&draft.done(), &a, &b, place);
        // Both sides of a wall are visible from a face in the wall's plane. From a face one unit in the last
        // place in front of it, only one side is visible.
        let mut draft = Draft::new(place);
        draft.rectangle(1.0, [-4.0, 4.0], [-4.0, 4.0]);
        let world = draft.done();
        let (near, far) = (
            place.square([0.0; 3], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        let face = place.square([0.25, 0.25, 1.0], 0.5);
        visible(&world, &face, &near, place);
        visible(&world, &face, &far, place);
        let z = place.local(1.0);
        let at = |z: f32| -> Vec<DVec3> {
            let [lo, hi] = [-0.25, 0.75].map(|c| place.local(c));
            [[lo, lo, z], [hi, lo, z], [hi, hi, z], [lo, hi, z]]
                .map(|p| place.turned(Vec3::from(p)).as_dvec3())
                .to_vec()
        };
        let (before, after) = (at(z.next_down()), at(z.next_up()));
        visible(&world, &before, &near, place);
        hidden(&world, &before, &far, place);
        hidden(&world, &after, &near, place);
        visible(&world, &after, &far, place);
        hidden(&world, &before, &after, place);
    }
}

#[test]
fn face_across_edge_of_wall_sees_past_wall() {
    for place in &exact() {
        let mut draft = Draft::new(place);
        // Two walls form a corner. The face of a cell lies in the plane of one wall and ends at the other.
        draft.rectangle(0.0, [-4.0, 4.0], [-4.0, 4.0]);
        draft.quad([
            [1.0, -4.0, -4.0],
            [1.0, 4.0, -4.0],
            [1.0, 4.0, 4.0],
            [1.0, -4.0, 4.0],
        ]);
        let world = draft.done();
        let face = place.rectangle(0.0, [-1.0, 1.0], [-1.0, 1.0]);
        let behind = |z: f64| place.polygon(&[[2.0, -1.0, z], [2.0, 1.0, z], [3.0, 0.0, 2.0 * z]]);
        hidden(&world, &face, &behind(1.0), place);
        hidden(&world, &face, &behind(-1.0), place);
        let across = place.rectangle(0.0, [-1.0, 1.5], [-1.0, 1.0]);
        visible(&world, &across, &behind(1.0), place);
        visible(&world, &across, &behind(-1.0), place);
        // The wall itself is visible from the face that ends at it.
        visible(
            &world,
            &face,
            &world.triangles[2].map(|p| p.as_dvec3()),
            place,
        );
    }
}

#[test]
fn duplicates_and_degenerate_triangles_do_not_affect_verdict() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (
            place.square([0.0; 3], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        let lo = place.local(0.25);
        let hi = lo.next_up();
        for (open, side) in [(false, lo), (true, hi)] {
            let mut draft = Draft::new(place);
            draft.triangles = slit(
                &Place {
                    turn: permutations()[0],
                    ..place.clone()
                },
                lo,
                side,
            )
            .triangles;
            let once = draft.triangles.clone();
            // The duplicates are equal, reversed, or start at another corner, before and after the originals.
            draft.triangles.extend(
                once.iter()
                    .flat_map(|[a, b, c]| [[*a, *b, *c], [*c, *b, *a], [*b, *c, *a]]),
            );
            draft
                .triangles
                .splice(0..0, once.iter().map(|[a, b, c]| [*b, *a, *c]));
            // Points and segments are in the slit and around it, some on the walls' edges.
            let p = |x: f32, y: f64| Vec3::new(x, place.local(y), place.local(1.0));
            draft.triangles.extend([
                [p(lo, 0.0); 3],
                [p(lo, -1.0), p(lo, 1.0), p(lo, 0.0)],
                [p(lo, -4.0), p(lo, 4.0), p(lo, -4.0)],
                [p(hi, -4.0), p(hi, 4.0), p(hi, 4.0)],
                [p(lo, -1.0), p(hi, -1.0), p(lo, -1.0)],
            ]);
            assert_eq!(draft.done().mutual(&a, &b), open, "{place:?}");
        }
        // This wall consists only of segments.
        let mut draft = Draft::new(place);
        for k in -8..=8 {
            let x = f64::from(k) / 4.0;
            draft.triangle([[x, -4.0, 1.0], [x, 4.0, 1.0], [x, 0.0, 1.0]]);
            draft.triangle([[-4.0, x, 1.0], [4.0, x, 1.0], [4.0, x, 1.0]]);
        }
        visible(&draft.done(), &a, &b, place);
    }
}

#[test]
fn triangles_that_touch_lines_from_outside_do_not_hide() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (
            place.square([0.0; 3], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        let mut draft = Draft::new(place);
        // The walls are around the volume. Some are in the planes of its faces, and some touch the middle of
        // a face or an edge.
        draft.rectangle(1.0, [1.0, 4.0], [-4.0, 4.0]);
        draft.rectangle(1.0, [-4.0, -1.0], [-4.0, 4.0]);
        draft.quad([
            [-1.0, 1.0, 0.0],
            [1.0, 1.0, 0.0],
            [1.0, 1.0, 2.0],
            [-1.0, 1.0, 2.0],
        ]);
        draft.triangle([[0.0, -1.0, 1.0], [-1.0, -4.0, 1.0], [1.0, -4.0, 1.0]]);
        draft.triangle([[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [4.0, 4.0, 1.0]]);
        visible(&draft.done(), &a, &b, place);
    }
    for place in &exact() {
        // The two halves of a wall abut along the edge of the volume. Each half without the other hides only
        // its half.
        let (a, b) = (
            place.rectangle(0.0, [-1.0, 0.0], [-1.0, 1.0]),
            place.rectangle(2.0, [-1.0, 0.0], [-1.0, 1.0]),
        );
        let mut right = Draft::new(place);
        right.rectangle(1.0, [0.0, 4.0], [-4.0, 4.0]);
        visible(&right.done(), &a, &b, place);
        let mut left = Draft::new(place);
        left.rectangle(1.0, [-4.0, 0.0], [-4.0, 4.0]);
        hidden(&left.done(), &a, &b, place);
        // These triangles meet all lines only in one corner of the volume or along an edge of A.
        let mut corner = Draft::new(place);
        corner.triangle([[-1.0, -1.0, 1.0], [-4.0, -1.0, 1.0], [-1.0, -4.0, 1.0]]);
        corner.triangle([[-1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, 0.0, 3.0]]);
        corner.triangle([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, -1.0]]);
        visible(&corner.done(), &a, &b, place);
    }
}

#[test]
fn list_of_parts_is_visible_if_one_part_is() {
    for place in &exact() {
        let mut draft = Draft::new(place);
        draft.window(1.0, 8.0, [0.25, 0.5], [0.25, 0.5]);
        let world = draft.done();
        let part = |x: f64, z: f64| {
            Polygon::checked(&place.square([x, 0.375, z], 0.0625))
                .unwrap()
                .remove(0)
        };
        let seen = [part(0.375, 0.0), part(0.375, 2.0)];
        let unseen = [part(-0.375, 0.0), part(-0.375, 2.0), part(-3.0, 2.0)];
        let ask = |a: &[&Polygon], b: &[&Polygon]| {
            let own = |p: &[&Polygon]| p.iter().map(|p| (*p).clone()).collect::<Vec<_>>();
            world.try_parts(&own(a), &own(b)).unwrap()
        };
        assert!(ask(&[&seen[0]], &[&seen[1]]));
        assert!(!ask(&[&unseen[0]], &[&unseen[1]]));
        assert!(ask(
            &[&unseen[0], &seen[0]],
            &[&unseen[1], &unseen[2], &seen[1]]
        ));
        assert!(!ask(&[&unseen[0]], &[&unseen[1], &unseen[2]]));
    }
}
