//! Scenes whose truth is known by construction, at many scales and rotations.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

mod common;

use common::{Draft, Place, Random, World, exact, ordered, permutations, rounded};
use glam::{DVec3, Vec3};
use sightline_exact::Polygon;
use sightline_scene::exact::orient3d_sign;
use std::cmp::Ordering;

#[track_caller]
fn visible(world: &World, a: &[DVec3], b: &[DVec3], place: &Place) {
    assert!(world.mutual(a, b), "not seen at {place:?}");
}

#[track_caller]
fn hidden(world: &World, a: &[DVec3], b: &[DVec3], place: &Place) {
    assert!(!world.mutual(a, b), "seen at {place:?}");
}

/// A scene of one triangle far from where anything is asked.
fn empty(place: &Place) -> World {
    let mut draft = Draft::new(place);
    draft.triangle([[96.0, 96.0, 96.0], [97.0, 96.0, 96.0], [96.0, 97.0, 96.0]]);
    draft.done()
}

/// Walls that reach from −4 to 4 with one slit at 0.3, whose width is given by its sides.
fn slit(place: &Place, lo: f32, hi: f32) -> World {
    let mut draft = Draft::new(place);
    let [least, most] = [-4.0, 4.0].map(|c| place.local(c));
    draft.placed(1.0, [least, lo], [least, most]);
    draft.placed(1.0, [hi, most], [least, most]);
    draft.done()
}

#[test]
fn a_slit_however_narrow_is_seen_through_and_a_closed_one_is_not() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (place.square([0.0, 0.0, 0.0], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        let lo = place.local(0.3);
        for width in [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 0.0] {
            // Never less than a unit in the last place.
            let hi = place.local(0.3 + 8.0 * width).max(lo.next_up());
            visible(&slit(place, lo, hi), &a, &b, place);
        }
        hidden(&slit(place, lo, lo), &a, &b, place);
        hidden(&slit(place, lo, lo.next_down()), &a, &b, place);
        hidden(&slit(place, lo, place.local(0.2)), &a, &b, place);
    }
}

#[test]
fn a_slit_turned_any_way_is_seen_through_unless_it_is_closed() {
    for place in &rounded() {
        let (a, b) = (place.square([0.0, 0.0, 0.0], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        let lo = place.local(0.3);
        for width in [1e-2, 1e-3, 1e-4] {
            visible(&slit(place, lo, place.local(0.3 + 8.0 * width)), &a, &b, place);
        }
        hidden(&slit(place, lo, lo), &a, &b, place);
        hidden(&slit(place, lo, place.local(0.2)), &a, &b, place);
    }
}

#[test]
fn a_slit_is_seen_through_at_a_slant() {
    // From −0.9…−0.5 through 0.3 at half way to 1.1…1.5.
    for place in exact().iter().chain(&rounded()) {
        let (a, b) =
            (place.rectangle(0.0, [-0.9, -0.5], [-1.0, 1.0]), place.rectangle(2.0, [1.1, 1.5], [-1.0, 1.0]));
        let beside = place.rectangle(2.0, [1.6, 2.0], [-1.0, 1.0]);
        let lo = place.local(0.3);
        for width in [1e-2, 1e-3] {
            let world = slit(place, lo, place.local(0.3 + width));
            visible(&world, &a, &b, place);
            hidden(&world, &a, &beside, place);
        }
    }
}

#[test]
fn two_slits_in_line_are_seen_through_and_two_that_are_offset_are_not() {
    for place in exact().iter().chain(&ordered()).chain(&rounded()) {
        for (offset, seen) in [(0.0, true), (0.02, true), (-0.02, true), (0.2, false), (-0.2, false)] {
            for width in [1e-2, 1e-3] {
                // From (0, 1) and (offset, 2) the line comes to −offset at 0 and twice the offset at 3.
                let mut draft = Draft::new(place);
                draft.window(1.0, 4.0, [0.0, width], [-3.0, 3.0]);
                draft.window(2.0, 4.0, [offset, offset + width], [-3.0, 3.0]);
                let world = draft.done();
                let (a, b) = (
                    place.rectangle(0.0, [-0.1, 0.1], [-1.0, 1.0]),
                    place.rectangle(3.0, [-0.1, 0.1], [-1.0, 1.0]),
                );
                // Far out the grid is too coarse for the difference.
                if place.shift.abs() > 100.0 * place.scale && offset.abs() < 0.1 {
                    continue;
                }
                assert_eq!(world.mutual(&a, &b), seen, "{offset} {width} {place:?}");
            }
        }
    }
}

#[test]
fn where_one_line_alone_would_pass_nothing_is_seen() {
    // x ≤ 0 on A, x ≥ 0 left open halfway and x ≤ `limit` on B: with limit 0 the lines with x = 0 are all
    // there is.
    for place in exact().iter().filter(|p| p.scale == 1.0) {
        let a = place.rectangle(0.0, [-1.0, 0.0], [-1.0, 1.0]);
        let b = place.rectangle(4.0, [-1.0, 1.0], [-1.0, 1.0]);
        for (limit, seen) in [(0.0, false), (-1e-30, false), (1e-30, true), (1e-7, true), (0.5, true)] {
            let mut draft = Draft::new(place);
            draft.rectangle(1.0, [-8.0, 0.0], [-8.0, 8.0]);
            draft.rectangle(2.0, [limit, 8.0], [-8.0, 8.0]);
            assert_eq!(draft.done().mutual(&a, &b), seen, "{limit} {place:?}");
        }
    }
}

/// A wall in a plane z around a slit: through `centre`, `half_length` steps of `along` each way, `half_width`
/// steps across.
fn wall_around(
    draft: &mut Draft<'_>,
    z: f64,
    centre: [f64; 2],
    along: [f64; 2],
    half_length: f64,
    half_width: f64,
) {
    let reach = 16.0;
    let mut piece = |s: [f64; 2], t: [f64; 2]| {
        draft.quad([(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| {
            let (s, t) = (s[i], t[j]);
            [centre[0] + s * along[0] + t * along[1], centre[1] + s * along[1] - t * along[0], z]
        }));
    };
    piece([-reach, reach], [half_width, reach]);
    piece([-reach, reach], [-reach, -half_width]);
    piece([half_length, reach], [-reach, reach]);
    piece([-reach, -half_length], [-reach, reach]);
}

/// Slits along x at 0, along y at 1 and, moved by `aside`, along the diagonal at 2.
///
/// The line from (t, 0, 0) to (0, s, 1) comes to (−t, 2s) at 2, so those through three slits without width
/// have t = −2s: one family, which comes from (−4s, −s) at −1 and goes to (4s, 3s) at 3.
fn three_slits(place: &Place, half_width: f64, aside: f64) -> World {
    let mut draft = Draft::new(place);
    wall_around(&mut draft, 0.0, [0.0, 0.0], [1.0, 0.0], 1.5, half_width);
    wall_around(&mut draft, 1.0, [0.0, 0.0], [0.0, 1.0], 1.5, half_width);
    wall_around(&mut draft, 2.0, [aside, -aside], [1.0, 1.0], 2.0, half_width);
    draft.done()
}

#[test]
fn three_skew_slits_let_a_ruled_family_through() {
    let wide = [2f64.powi(-6), 2f64.powi(-10)];
    let narrow = [2f64.powi(-15), 2f64.powi(-20)];
    for (places, widths) in [(exact(), [wide, narrow].concat()), (rounded(), wide.to_vec())] {
        for place in &places {
            let on = place.square([-2.0, -0.5, -1.0], 0.125);
            let off = place.square([-2.0, 0.5, -1.0], 0.125);
            let (b, all) = (place.square([2.0, 1.5, 3.0], 0.125), place.square([0.0, 0.0, 3.0], 4.0));
            for width in &widths {
                let world = three_slits(place, *width, 0.0);
                visible(&world, &on, &b, place);
                visible(&world, &on, &all, place);
                hidden(&world, &off, &all, place);
                let moved = three_slits(place, *width, 0.375);
                hidden(&moved, &on, &b, place);
                hidden(&moved, &on, &all, place);
            }
            hidden(&three_slits(place, 0.0, 0.0), &on, &all, place);
        }
    }
}

#[test]
fn an_area_is_seen_through_four_and_five_portals_in_line() {
    for place in exact().iter().chain(&rounded()) {
        for count in [4, 5] {
            let centre = |k: usize| [0.3 * k as f64, -0.2 * k as f64];
            let square = |k: usize| {
                let [x, y] = centre(k);
                place.square([x, y, k as f64], 0.1)
            };
            let (a, b) = (square(0), square(count + 1));
            let chain = |moved: usize| {
                let mut draft = Draft::new(place);
                for k in 1..=count {
                    let [x, y] = centre(k);
                    // What passes the portals before and after comes within 0.1 of this one's centre.
                    let x = if k == moved { x + 0.4 } else { x };
                    draft.window(k as f64, 8.0, [x - 0.05, x + 0.05], [y - 0.05, y + 0.05]);
                }
                draft.done()
            };
            visible(&chain(0), &a, &b, place);
            for moved in 1..=count {
                hidden(&chain(moved), &a, &b, place);
            }
        }
    }
}

#[test]
fn a_window_one_float_wide_is_seen_through() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (place.square([0.0, 0.0, 0.0], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        let (x, y) = (place.local(0.3), place.local(-0.7));
        let world = |x: [f32; 2], y: [f32; 2]| {
            let mut draft = Draft::new(place);
            draft.placed_window(1.0, 4.0, x, y);
            draft.done()
        };
        visible(&world([x, x.next_up()], [y, y.next_up()]), &a, &b, place);
        hidden(&world([x, x], [y, y.next_up()]), &a, &b, place);
        hidden(&world([x, x.next_up()], [y, y]), &a, &b, place);
    }
}

#[test]
fn the_edge_two_triangles_share_is_no_crack() {
    for place in exact().iter().chain(&ordered()).chain(&rounded()) {
        let mut draft = Draft::new(place);
        // The edge from (−4, −4) to (4, 4).
        draft.rectangle(1.0, [-4.0, 4.0], [-4.0, 4.0]);
        let world = draft.done();
        // Through it, with the edge seen as a point (from the side), as a line, and from a slit of its own
        // shape.
        let (a, b) = (place.square([0.0, 0.0, 0.0], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        hidden(&world, &a, &b, place);
        let thin =
            |z: f64| place.polygon(&[[-1.0, -1.0, z], [1.0, 1.0, z], [0.9, 0.91, z], [-0.9, -0.89, z]]);
        hidden(&world, &thin(0.0), &thin(2.0), place);
        let tall = |z: [f64; 2]| place.polygon(&[[-1.0, -1.0, z[0]], [1.0, 1.0, z[0]], [0.0, 0.0, z[1]]]);
        hidden(&world, &tall([0.5, 0.25]), &tall([1.5, 1.75]), place);
        hidden(&world, &tall([0.25, 0.5]), &thin(2.0), place);
    }
    for place in &exact() {
        let mut draft = Draft::new(place);
        draft.rectangle(1.0, [-4.0, 4.0], [-4.0, 4.0]);
        let world = draft.done();
        // Along it: both ends touch the wall's plane, across the edge's line, on different sides of the wall.
        let end = |c: f64, z: f64| {
            place.polygon(&[
                [c + 1.0, c - 1.0, 1.0],
                [c - 1.0, c + 1.0, 1.0],
                [c - 1.0, c + 1.0, z],
                [c + 1.0, c - 1.0, z],
            ])
        };
        hidden(&world, &end(-2.0, 2.0), &end(2.0, 0.0), place);
        // On the same side the wall is not in between.
        visible(&world, &end(-2.0, 2.0), &end(2.0, 2.0), place);
        visible(&world, &end(-2.0, 2.0), &end(2.0, 1.5), place);
    }
}

#[test]
fn a_roof_is_closed_along_its_ridge() {
    for place in exact().iter().chain(&rounded()) {
        for bend in [-1.0, -0.001, 0.001, 1.0] {
            let mut draft = Draft::new(place);
            draft.quad([[0.0, -4.0, 4.0], [0.0, 4.0, 4.0], [4.0, 4.0, 4.0 + bend], [4.0, -4.0, 4.0 + bend]]);
            draft.quad([
                [0.0, -4.0, 4.0],
                [-4.0, -4.0, 4.0 + bend],
                [-4.0, 4.0, 4.0 + bend],
                [0.0, 4.0, 4.0],
            ]);
            let world = draft.done();
            let (a, b) = (place.square([0.0, 0.0, 2.0], 1.0), place.square([0.0, 0.0, 6.0], 1.0));
            hidden(&world, &a, &b, place);
            // In the plane of symmetry, through the ridge.
            let upright =
                |z: [f64; 2]| place.polygon(&[[0.0, -1.0, z[0]], [0.0, 1.0, z[0]], [0.0, 0.0, z[1]]]);
            hidden(&world, &a, &upright([6.0, 7.0]), place);
            hidden(&world, &upright([2.0, 1.0]), &b, place);
        }
    }
}

#[test]
fn corners_on_edges_leave_no_cracks() {
    for place in exact().iter().chain(&ordered()) {
        let mut draft = Draft::new(place);
        for (x, rows) in
            [([-4.0, 0.25], vec![-4.0, 0.0, 4.0]), ([0.25, 4.0], vec![-4.0, -0.3, 0.125, 0.3, 4.0])]
        {
            for row in rows.windows(2) {
                draft.rectangle(1.0, x, [row[0], row[1]]);
            }
        }
        let world = draft.done();
        let (a, b) = (place.square([0.0, 0.0, 0.0], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        hidden(&world, &a, &b, place);
    }
    for place in &exact() {
        // One triangle above the diagonal and many below, which meet it at `middle` among other corners.
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
        let (a, b) = (place.square([0.0, 0.0, 0.0], 2.0), place.square([0.0, 0.0, 2.0], 2.0));
        hidden(&wall([0.5, 0.5]), &a, &b, place);
        hidden(&wall([0.25, 0.25]), &a, &b, place);
        // A unit in the last place beyond the edge, overlapping, and short of it, leaving a crack.
        hidden(&wall([0.5, f64::from(0.5f32.next_up())]), &a, &b, place);
        visible(&wall([0.5, f64::from(0.5f32.next_down())]), &a, &b, place);
    }
}

/// A triangle, each corner somewhere in a ball.
fn somewhere(random: &mut Random, centre: DVec3, radius: f64) -> [[f64; 3]; 3] {
    [0; 3].map(|_| (centre + random.direction() * random.between(0.3, 1.0) * radius).to_array())
}

#[test]
fn nothing_outside_a_closed_mesh_is_seen_from_inside() {
    let mut random = Random(1);
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
fn of_a_ball_the_faces_turned_towards_one_are_seen() {
    let mut random = Random(2);
    for place in exact().iter().chain(&rounded()).filter(|p| p.scale == 1.0) {
        let mut draft = Draft::new(place);
        draft.sphere([0.0; 3], 1.0, 1);
        let world = draft.done();
        let mirrored = place.turn.determinant() < 0.0;
        let inside = place.polygon(&somewhere(&mut random, DVec3::ZERO, 0.7));
        let away = random.direction() * 2.2;
        let outside: [Vec3; 3] = somewhere(&mut random, away, 0.9).map(|p| place.turned(place.point(p)));
        let outside = outside.map(|p| p.as_dvec3());
        let mut towards = 0;
        for face in &world.triangles {
            let corners = face.map(|p| p.as_dvec3());
            visible(&world, &inside, &corners, place);
            let [a, b, c] = if mirrored { [face[0], face[2], face[1]] } else { *face };
            let seen = outside.iter().any(|p| orient3d_sign(a, b, c, p.as_vec3()) == Ordering::Greater);
            towards += usize::from(seen);
            assert_eq!(world.mutual(&outside, &corners), seen, "{place:?} {face:?} {outside:?}");
        }
        assert!((1..world.triangles.len()).contains(&towards), "{towards} are turned towards the polygon");
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
        // Inside each, and outside all.
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
        // Round the corner of a box, but not to its other side.
        let beside = place.polygon(&[[0.5, 1.5, -0.5], [0.9, 1.9, -0.5], [0.7, 1.7, 0.5]]);
        visible(&world, &at(1.5), &beside, place);
        let opposite = place.polygon(&[[-1.5, -0.1, -0.1], [-1.5, 0.1, -0.1], [-1.6, 0.0, 0.1]]);
        let small = place.polygon(&[[1.5, -0.1, -0.1], [1.5, 0.1, -0.1], [1.6, 0.0, 0.1]]);
        hidden(&world, &small, &opposite, place);
    }
}

/// Pickets in a plane z, `width` wide about k + `middle` for whole k from −20 to 20.
fn fence(draft: &mut Draft<'_>, z: f64, middle: f64, width: f64) {
    for k in -20..=20 {
        let x = f64::from(k) + middle;
        draft.rectangle(z, [x - width / 2.0, x + width / 2.0], [-16.0, 16.0]);
    }
}

#[test]
fn fences_are_seen_through_unless_they_close_each_others_gaps() {
    for place in exact().iter().filter(|p| p.scale >= 1.0) {
        let (a, b) = (place.square([0.0, 0.0, 0.0], 4.0), place.square([0.0, 0.0, 8.0], 4.0));
        // Lines from A to B move one sideways for each forward at most. The second fence's pickets are in
        // front of the first's gaps, half a step wide, at such a distance.
        let world = |fences: &[(f64, f64, f64)]| {
            let mut draft = Draft::new(place);
            fences.iter().for_each(|(z, middle, width)| fence(&mut draft, *z, *middle, *width));
            draft.done()
        };
        visible(&world(&[(4.0, 0.0, 0.5)]), &a, &b, place);
        visible(&world(&[(4.0, 0.0, 1.0 - 2f64.powi(-12))]), &a, &b, place);
        hidden(&world(&[(4.0, 0.0, 1.0)]), &a, &b, place);
        // In one plane they abut; one behind the other they leave slanted lines free, unless they overlap.
        hidden(&world(&[(4.0, 0.0, 0.5), (4.0, 0.5, 0.5)]), &a, &b, place);
        visible(&world(&[(4.0, 0.0, 0.5), (4.0 + 2f64.powi(-10), 0.5, 0.5)]), &a, &b, place);
        hidden(&world(&[(4.0, 0.0, 0.5), (4.0 + 2f64.powi(-10), 0.5, 0.75)]), &a, &b, place);
        hidden(&world(&[(4.0, 0.0, 0.5), (4.125, 0.5, 0.75)]), &a, &b, place);
        visible(&world(&[(4.0, 0.0, 0.5), (4.25, 0.5, 0.75)]), &a, &b, place);
        // Widened by just what the steepest line from A to B gains.
        hidden(&world(&[(4.0, 0.0, 0.5), (4.125, 0.5, 0.75), (5.0, 0.0, 0.5)]), &a, &b, place);
    }
}

#[test]
fn what_is_seen_past_three_edges_is_hidden_when_one_moves() {
    // At 1 what has x ≥ y/4 is closed, at 3 x ≥ −y/4, at 2 x ≤ limit. Free lines have x₂ = (x₁ + x₃)/2 < (y₁
    // − y₃)/8, and y₁ − y₃ = (y₀ − y₄)/2 is 1 at most: some are free exactly when the limit is below 1/8.
    let world = |place: &Place, limit: f64, without: usize| {
        let mut draft = Draft::new(place);
        if without != 1 {
            draft.quad([[-2.0, -8.0, 1.0], [64.0, -8.0, 1.0], [64.0, 8.0, 1.0], [2.0, 8.0, 1.0]]);
        }
        if without != 2 {
            draft.rectangle(2.0, [-64.0, limit], [-8.0, 8.0]);
        }
        if without != 3 {
            draft.quad([[2.0, -8.0, 3.0], [64.0, -8.0, 3.0], [64.0, 8.0, 3.0], [-2.0, 8.0, 3.0]]);
        }
        draft.done()
    };
    for place in &exact() {
        let (a, b) =
            (place.rectangle(0.0, [-4.0, 4.0], [-1.0, 1.0]), place.rectangle(4.0, [-4.0, 4.0], [-1.0, 1.0]));
        for (limit, seen) in [
            (0.0, true),
            (0.125 - 2f64.powi(-10), true),
            (0.125 - 2f64.powi(-20), true),
            (0.125 - 2f64.powi(-26), true),
            (0.125, false),
            (0.125 + 2f64.powi(-20), false),
            (0.5, false),
        ] {
            assert_eq!(world(place, limit, 0).mutual(&a, &b), seen, "{limit} {place:?}");
        }
        for without in 1..=3 {
            visible(&world(place, 0.125, without), &a, &b, place);
        }
    }
    for place in &rounded() {
        let (a, b) =
            (place.rectangle(0.0, [-4.0, 4.0], [-1.0, 1.0]), place.rectangle(4.0, [-4.0, 4.0], [-1.0, 1.0]));
        visible(&world(place, 0.124, 0), &a, &b, place);
        hidden(&world(place, 0.126, 0), &a, &b, place);
    }
}

#[test]
fn polygons_that_touch_see_each_other_unless_they_are_in_one_plane() {
    for place in &exact() {
        let world = empty(place);
        let a = place.square([0.0; 3], 1.0);
        // A corner in common, an edge, part of an edge, a corner on an edge, a corner inside, an edge inside.
        for b in [
            [[1.0, 1.0, 0.0], [2.0, 1.0, 1.0], [1.0, 2.0, 1.0]],
            [[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 2.0]],
            [[1.0, -0.5, 0.0], [1.0, 3.0, 0.0], [1.5, 0.0, 2.0]],
            [[1.0, 0.5, 0.0], [2.0, 1.0, 1.0], [1.0, 1.0, 1.0]],
            [[0.25, 0.5, 0.0], [2.0, 1.0, 1.0], [1.0, 1.0, 1.0]],
            [[-0.25, 0.5, 0.0], [0.25, 0.5, 0.0], [0.0, 0.5, -1.0]],
            // Crossing it, sticking through it whole, through its corner, through its edge.
            [[0.0, -2.0, -1.0], [0.0, 2.0, -1.0], [0.0, 0.0, 1.0]],
            [[0.5, -0.5, -1.0], [0.25, 0.5, -1.0], [0.0, 0.0, 1.0]],
            [[1.0, 1.0, -1.0], [2.0, 2.0, 0.5], [1.0, 1.0, 1.0]],
            [[1.0, -0.5, -1.0], [1.0, 0.5, -1.0], [1.0, 0.0, 1.0]],
            // The plane of A cuts it beside A; the plane of A touches it beside A.
            [[2.0, -1.0, -1.0], [2.0, 1.0, -1.0], [3.0, 0.0, 1.0]],
            [[2.0, -1.0, 0.0], [2.0, 1.0, 0.0], [3.0, 0.0, 1.0]],
            // Its plane cuts A, its plane touches A, with the line of both planes along edges of both.
            [[0.0, -1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 2.0]],
            [[1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 0.0, 2.0]],
            [[1.0, 2.0, 0.0], [1.0, 3.0, 0.0], [1.0, 2.0, 1.0]],
        ] {
            visible(&world, &a, &place.polygon(&b), place);
        }
        // In its plane: apart, touching, overlapping, the same.
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
fn polygons_that_touch_are_hidden_by_what_divides_the_space_between() {
    for place in &exact() {
        // Both share the edge from (0, 0, 0) to (0, 0, 1); the blocker begins `from` away from it.
        let (a, b) = (
            place.polygon(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]),
            place.polygon(&[[0.0; 3], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
        );
        let divided = |from: f64| {
            let mut draft = Draft::new(place);
            draft.quad([[from, from, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [from, from, 1.0]]);
            draft.done()
        };
        hidden(&divided(0.0), &a, &b, place);
        hidden(&divided(-1.0), &a, &b, place);
        visible(&divided(2f64.powi(-20)), &a, &b, place);
        visible(&divided(0.25), &a, &b, place);
        // Crossing squares: four corners between them to close.
        let upright =
            place.polygon(&[[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]]);
        let flat = place.square([0.0; 3], 1.0);
        let closed = |without: usize| {
            let mut draft = Draft::new(place);
            for (k, [x, z]) in [[2.0, 2.0], [-2.0, 2.0], [-2.0, -2.0], [2.0, -2.0]].iter().enumerate() {
                if k != without {
                    draft.quad([[0.0, -2.0, 0.0], [*x, -2.0, *z], [*x, 2.0, *z], [0.0, 2.0, 0.0]]);
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
fn what_lies_in_the_plane_of_a_polygon_does_not_block() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (place.square([0.0; 3], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        let mut draft = Draft::new(place);
        draft.rectangle(0.0, [-4.0, 4.0], [-4.0, 4.0]);
        draft.rectangle(0.0, [-1.0, 1.0], [-1.0, 1.0]);
        draft.rectangle(2.0, [-0.5, 4.0], [-4.0, 4.0]);
        draft.rectangle(2.0, [-4.0, 4.0], [-4.0, 4.0]);
        visible(&draft.done(), &a, &b, place);
        // Both sides of a wall are seen from a face in its plane; from one a unit before it, one alone.
        let mut draft = Draft::new(place);
        draft.rectangle(1.0, [-4.0, 4.0], [-4.0, 4.0]);
        let world = draft.done();
        let (near, far) = (place.square([0.0; 3], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
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
fn a_face_that_reaches_over_a_walls_edge_sees_past_it() {
    for place in &exact() {
        let mut draft = Draft::new(place);
        // A corner of two walls; the face of a cell lies in the plane of one and ends at the other.
        draft.rectangle(0.0, [-4.0, 4.0], [-4.0, 4.0]);
        draft.quad([[1.0, -4.0, -4.0], [1.0, 4.0, -4.0], [1.0, 4.0, 4.0], [1.0, -4.0, 4.0]]);
        let world = draft.done();
        let face = place.rectangle(0.0, [-1.0, 1.0], [-1.0, 1.0]);
        let behind = |z: f64| place.polygon(&[[2.0, -1.0, z], [2.0, 1.0, z], [3.0, 0.0, 2.0 * z]]);
        hidden(&world, &face, &behind(1.0), place);
        hidden(&world, &face, &behind(-1.0), place);
        let across = place.rectangle(0.0, [-1.0, 1.5], [-1.0, 1.0]);
        visible(&world, &across, &behind(1.0), place);
        visible(&world, &across, &behind(-1.0), place);
        // The wall itself is seen from the face that ends at it.
        visible(&world, &face, &world.triangles[2].map(|p| p.as_dvec3()), place);
    }
}

#[test]
fn duplicates_and_triangles_without_area_change_nothing() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (place.square([0.0; 3], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        let lo = place.local(0.25);
        let hi = lo.next_up();
        for (open, side) in [(false, lo), (true, hi)] {
            let mut draft = Draft::new(place);
            draft.triangles = slit(&Place { turn: permutations()[0], ..place.clone() }, lo, side).triangles;
            let once = draft.triangles.clone();
            // Again, reversed, and begun at another corner, before and after.
            draft
                .triangles
                .extend(once.iter().flat_map(|[a, b, c]| [[*a, *b, *c], [*c, *b, *a], [*b, *c, *a]]));
            draft.triangles.splice(0..0, once.iter().map(|[a, b, c]| [*b, *a, *c]));
            // Points and segments in the slit and around it, some on the walls' edges.
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
        // A wall of nothing but segments.
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
fn what_touches_the_lines_from_outside_hides_nothing() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (place.square([0.0; 3], 1.0), place.square([0.0, 0.0, 2.0], 1.0));
        let mut draft = Draft::new(place);
        // Walls around the volume, some in its faces' planes, some that touch a face's middle or an edge.
        draft.rectangle(1.0, [1.0, 4.0], [-4.0, 4.0]);
        draft.rectangle(1.0, [-4.0, -1.0], [-4.0, 4.0]);
        draft.quad([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 2.0], [-1.0, 1.0, 2.0]]);
        draft.triangle([[0.0, -1.0, 1.0], [-1.0, -4.0, 1.0], [1.0, -4.0, 1.0]]);
        draft.triangle([[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [4.0, 4.0, 1.0]]);
        visible(&draft.done(), &a, &b, place);
    }
    for place in &exact() {
        // The two halves of a wall that abut along the edge of the volume: either alone hides a half.
        let (a, b) =
            (place.rectangle(0.0, [-1.0, 0.0], [-1.0, 1.0]), place.rectangle(2.0, [-1.0, 0.0], [-1.0, 1.0]));
        let mut right = Draft::new(place);
        right.rectangle(1.0, [0.0, 4.0], [-4.0, 4.0]);
        visible(&right.done(), &a, &b, place);
        let mut left = Draft::new(place);
        left.rectangle(1.0, [-4.0, 0.0], [-4.0, 4.0]);
        hidden(&left.done(), &a, &b, place);
        // A triangle that meets all lines in one corner of the volume or along an edge of A alone.
        let mut corner = Draft::new(place);
        corner.triangle([[-1.0, -1.0, 1.0], [-4.0, -1.0, 1.0], [-1.0, -4.0, 1.0]]);
        corner.triangle([[-1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, 0.0, 3.0]]);
        corner.triangle([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, -1.0]]);
        visible(&corner.done(), &a, &b, place);
    }
}

#[test]
fn a_list_of_parts_is_seen_when_one_of_them_is() {
    for place in &exact() {
        let mut draft = Draft::new(place);
        draft.window(1.0, 8.0, [0.25, 0.5], [0.25, 0.5]);
        let world = draft.done();
        let part = |x: f64, z: f64| Polygon::checked(&place.square([x, 0.375, z], 0.0625)).unwrap().remove(0);
        let seen = [part(0.375, 0.0), part(0.375, 2.0)];
        let unseen = [part(-0.375, 0.0), part(-0.375, 2.0), part(-3.0, 2.0)];
        let ask = |a: &[&Polygon], b: &[&Polygon]| {
            let own = |p: &[&Polygon]| p.iter().map(|p| (*p).clone()).collect::<Vec<_>>();
            world.try_parts(&own(a), &own(b)).unwrap()
        };
        assert!(ask(&[&seen[0]], &[&seen[1]]));
        assert!(!ask(&[&unseen[0]], &[&unseen[1]]));
        assert!(ask(&[&unseen[0], &seen[0]], &[&unseen[1], &unseen[2], &seen[1]]));
        assert!(!ask(&[&unseen[0]], &[&unseen[1], &unseen[2]]));
    }
}
