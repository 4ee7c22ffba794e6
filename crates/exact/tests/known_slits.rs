//! Tests of slits, portals and windows whose visibility is known by construction, at many scales and
//! rotations.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

mod common;

use common::truth::{hidden, slit, visible};
use common::{Draft, Place, World, exact, ordered, rounded};

#[test]
fn narrow_slits_show_and_closed_slits_hide() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (
            place.square([0.0, 0.0, 0.0], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        let lo = place.local(0.3);
        for width in [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 0.0] {
            // The width is at least a unit in the last place.
            let hi = place.local(0.3 + 8.0 * width).max(lo.next_up());
            visible(&slit(place, lo, hi), &a, &b, place);
        }
        hidden(&slit(place, lo, lo), &a, &b, place);
        hidden(&slit(place, lo, lo.next_down()), &a, &b, place);
        hidden(&slit(place, lo, place.local(0.2)), &a, &b, place);
    }
}

#[test]
fn turned_slits_show_unless_closed() {
    for place in &rounded() {
        let (a, b) = (
            place.square([0.0, 0.0, 0.0], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
        let lo = place.local(0.3);
        for width in [1e-2, 1e-3, 1e-4] {
            visible(
                &slit(place, lo, place.local(0.3 + 8.0 * width)),
                &a,
                &b,
                place,
            );
        }
        hidden(&slit(place, lo, lo), &a, &b, place);
        hidden(&slit(place, lo, place.local(0.2)), &a, &b, place);
    }
}

#[test]
fn slit_shows_along_slanted_lines() {
    // The lines go from −0.9…−0.5 through 0.3 at half the distance to 1.1…1.5.
    for place in exact().iter().chain(&rounded()) {
        let (a, b) = (
            place.rectangle(0.0, [-0.9, -0.5], [-1.0, 1.0]),
            place.rectangle(2.0, [1.1, 1.5], [-1.0, 1.0]),
        );
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
fn aligned_slits_show_and_offset_slits_hide() {
    for place in exact().iter().chain(&ordered()).chain(&rounded()) {
        for (offset, seen) in [
            (0.0, true),
            (0.02, true),
            (-0.02, true),
            (0.2, false),
            (-0.2, false),
        ] {
            for width in [1e-2, 1e-3] {
                // From (0, 1) and (offset, 2), the line reaches −offset at 0 and twice the offset at 3.
                let mut draft = Draft::new(place);
                draft.window(1.0, 4.0, [0.0, width], [-3.0, 3.0]);
                draft.window(2.0, 4.0, [offset, offset + width], [-3.0, 3.0]);
                let world = draft.done();
                let (a, b) = (
                    place.rectangle(0.0, [-0.1, 0.1], [-1.0, 1.0]),
                    place.rectangle(3.0, [-0.1, 0.1], [-1.0, 1.0]),
                );
                // Far from the origin, the grid is too coarse for the difference.
                if place.shift.abs() > 100.0 * place.scale && offset.abs() < 0.1 {
                    continue;
                }
                assert_eq!(world.mutual(&a, &b), seen, "{offset} {width} {place:?}");
            }
        }
    }
}

#[test]
fn single_line_does_not_make_polygon_visible() {
    // A has x ≤ 0, the first wall leaves x ≥ 0 open, and the second x ≤ `limit`. With limit 0, only the lines
    // with x = 0 remain.
    for place in exact().iter().filter(|p| p.scale == 1.0) {
        let a = place.rectangle(0.0, [-1.0, 0.0], [-1.0, 1.0]);
        let b = place.rectangle(4.0, [-1.0, 1.0], [-1.0, 1.0]);
        for (limit, seen) in [
            (0.0, false),
            (-1e-30, false),
            (1e-30, true),
            (1e-7, true),
            (0.5, true),
        ] {
            let mut draft = Draft::new(place);
            draft.rectangle(1.0, [-8.0, 0.0], [-8.0, 8.0]);
            draft.rectangle(2.0, [limit, 8.0], [-8.0, 8.0]);
            assert_eq!(draft.done().mutual(&a, &b), seen, "{limit} {place:?}");
        }
    }
}

/// Adds a wall in a plane z around a slit.
///
/// The slit is centred at `centre`, extends `half_length` steps of `along` in each direction, and
/// `half_width` steps across.
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
            [
                centre[0] + s * along[0] + t * along[1],
                centre[1] + s * along[1] - t * along[0],
                z,
            ]
        }));
    };
    piece([-reach, reach], [half_width, reach]);
    piece([-reach, reach], [-reach, -half_width]);
    piece([half_length, reach], [-reach, reach]);
    piece([-reach, -half_length], [-reach, reach]);
}

/// Creates slits along x at 0, along y at 1 and, moved by `aside`, along the diagonal at 2.
///
/// The line from (t, 0, 0) to (0, s, 1) reaches (−t, 2s) at 2, so the lines through three slits without width
/// have t = −2s. This is one family, which comes from (−4s, −s) at −1 and goes to (4s, 3s) at 3.
fn three_slits(place: &Place, half_width: f64, aside: f64) -> World {
    let mut draft = Draft::new(place);
    wall_around(&mut draft, 0.0, [0.0, 0.0], [1.0, 0.0], 1.5, half_width);
    wall_around(&mut draft, 1.0, [0.0, 0.0], [0.0, 1.0], 1.5, half_width);
    wall_around(
        &mut draft,
        2.0,
        [aside, -aside],
        [1.0, 1.0],
        2.0,
        half_width,
    );
    draft.done()
}

#[test]
fn three_skew_slits_show_along_ruled_family() {
    let wide = [2f64.powi(-6), 2f64.powi(-10)];
    let narrow = [2f64.powi(-15), 2f64.powi(-20)];
    for (places, widths) in [
        (exact(), [wide, narrow].concat()),
        (rounded(), wide.to_vec()),
    ] {
        for place in &places {
            let on = place.square([-2.0, -0.5, -1.0], 0.125);
            let off = place.square([-2.0, 0.5, -1.0], 0.125);
            let (b, all) = (
                place.square([2.0, 1.5, 3.0], 0.125),
                place.square([0.0, 0.0, 3.0], 4.0),
            );
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
fn four_and_five_aligned_portals_show_area() {
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
                    // Lines that pass the portals before and after come within 0.1 of this portal's centre.
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
fn window_one_float_wide_shows_polygon() {
    for place in exact().iter().chain(&ordered()) {
        let (a, b) = (
            place.square([0.0, 0.0, 0.0], 1.0),
            place.square([0.0, 0.0, 2.0], 1.0),
        );
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
