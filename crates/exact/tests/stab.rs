//! Tests of lines that stab sequences of polygons: known answers, and random sequences against lines.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::cmp::Ordering;

use dashu_int::IBig;
use proptest::prelude::*;
use sightline_exact::{PointOrigin, Polygon, QueryLimits, Stabbed, predicates, stab};

/// The denominator of all coordinates: 2²⁰.
const UNIT: i64 = 1 << 20;

/// Creates a polygon with corners in units of 2⁻²⁰.
fn polygon(corners: &[[i64; 3]]) -> Polygon {
    let point = |c: &[i64; 3]| {
        let [x, y, z] = c.map(IBig::from);
        PointOrigin::Exact(Box::new([x, y, z, IBig::from(UNIT)]))
    };
    Polygon::exact(corners.iter().map(point).collect()).unwrap()
}

/// Creates a polygon with corners in units of 1.
fn whole(corners: &[[f64; 3]]) -> Polygon {
    let scaled: Vec<[i64; 3]> = corners
        .iter()
        .map(|c| c.map(|x| (x * UNIT as f64) as i64))
        .collect();
    polygon(&scaled)
}

/// Creates a rectangle across an axis from its level and its range along the next two axes.
fn rectangle(axis: usize, at: f64, u: [f64; 2], v: [f64; 2]) -> Polygon {
    let corner = |i: usize, j: usize| {
        let mut p = [at; 3];
        p[(axis + 1) % 3] = u[i];
        p[(axis + 2) % 3] = v[j];
        p
    };
    whole(&[corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)])
}

/// Returns true if the line through two points passes strictly through each polygon, in order.
fn stabs(portals: &[Polygon], [p, q]: [&PointOrigin; 2]) -> bool {
    let [a, b] = [p, q].map(predicates::integers);
    let mut before: Option<(IBig, IBig)> = None;
    for portal in portals {
        let points = portal.points();
        let n = points.len();
        let turns: Vec<Ordering> = (0..n)
            .map(|k| predicates::orient([p, q, &points[k], &points[(k + 1) % n]]))
            .collect();
        if turns[0] == Ordering::Equal || turns.iter().any(|t| *t != turns[0]) {
            return false;
        }
        // The line crosses the plane at a + t (b − a), t = n / d.
        let plane = portal.plane();
        let (at_a, at_b) = (
            predicates::height(&plane, &a) * &b[3],
            predicates::height(&plane, &b) * &a[3],
        );
        let (mut n, mut d) = (at_a.clone(), at_a - at_b);
        if predicates::sign(&d) == Ordering::Less {
            (n, d) = (-n, -d);
        }
        if predicates::sign(&d) != Ordering::Greater {
            return false;
        }
        if let Some((m, e)) = &before
            && m * &d >= &n * e
        {
            return false;
        }
        before = Some((n, d));
    }
    true
}

/// Returns true if a line stabs the sequence, and checks the line that was found.
fn state(portals: &[Polygon]) -> bool {
    match stab(portals, &QueryLimits::default(), &|| false).0 {
        Stabbed::Line(line) => {
            assert!(
                stabs(portals, [&line[0], &line[1]]),
                "the line is none: {line:?} in {portals:?}"
            );
            true
        }
        Stabbed::Blocked => false,
        Stabbed::Undecided(reason) => panic!("undecided: {reason} in {portals:?}"),
    }
}

#[test]
fn line_stabs_three_squares_until_last_moves_by_four() {
    let square = |z: f64, x: i64| {
        let (x, z, one) = (x, (z * UNIT as f64) as i64, UNIT);
        polygon(&[
            [x - one, -one, z],
            [x + one, -one, z],
            [x + one, one, z],
            [x - one, one, z],
        ])
    };
    for (moved, expected) in [
        (0, true),
        (3 * UNIT, true),
        (4 * UNIT - 1, true),
        (4 * UNIT, false),
        (4 * UNIT + 1, false),
    ] {
        let portals = [square(0.0, 0), square(1.0, 0), square(2.0, moved)];
        assert_eq!(state(&portals), expected, "{moved}");
        let back: Vec<Polygon> = portals.iter().rev().cloned().collect();
        assert_eq!(state(&back), expected, "backwards");
        // In another order, no line passes them.
        assert!(!state(&[
            portals[1].clone(),
            portals[0].clone(),
            portals[2].clone()
        ]));
    }
}

#[test]
fn line_stabs_one_or_two_polygons() {
    let one = rectangle(2, 0.0, [0.0, 1.0], [0.0, 1.0]);
    assert!(state(std::slice::from_ref(&one)));
    assert!(state(&[
        one.clone(),
        rectangle(0, 2.0, [3.0, 4.0], [-9.0, -8.0])
    ]));
    // These polygons are in one plane.
    assert!(!state(&[
        one.clone(),
        rectangle(2, 0.0, [2.0, 3.0], [0.0, 1.0])
    ]));
    assert!(!state(&[one.clone(), one]));
}

#[test]
fn pairwise_stabbed_polygons_may_block_together() {
    let portals = [
        rectangle(2, 0.5, [-0.75, 1.0], [0.0, 1.0]),
        rectangle(0, 1.25, [1.25, 2.0], [1.5, 2.0]),
        rectangle(1, 2.0, [0.5, 1.0], [1.5, 2.0]),
    ];
    assert!(!state(&portals));
    // A line stabs each pair of them.
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        assert!(state(&[portals[i].clone(), portals[j].clone()]), "{i} {j}");
    }
}

#[test]
fn slits_along_regulus_light_two_places() {
    let e = UNIT >> 7;
    let slit = |z: i64| {
        let y = |x: i64| x * z * UNIT;
        polygon(&[
            [3 * UNIT, y(3) - e, z * UNIT],
            [5 * UNIT, y(5) - e, z * UNIT],
            [5 * UNIT, y(5) + e, z * UNIT],
            [3 * UNIT, y(3) + e, z * UNIT],
        ])
    };
    let y = 31 * UNIT / 2;
    let last = polygon(&[
        [3 * UNIT, y - e, 5 * UNIT],
        [5 * UNIT, y - e, 3 * UNIT],
        [5 * UNIT, y + e, 3 * UNIT],
        [3 * UNIT, y + e, 5 * UNIT],
    ]);
    let target = |x: f64| {
        let (x, y) = ((x * UNIT as f64) as i64, (8.0 * x * UNIT as f64) as i64);
        let (a, b) = (UNIT / 16, UNIT / 2);
        polygon(&[
            [x - a, y - b, 8 * UNIT],
            [x + a, y - b, 8 * UNIT],
            [x + a, y + b, 8 * UNIT],
            [x - a, y + b, 8 * UNIT],
        ])
    };
    let seen = |x: f64| state(&[slit(0), slit(1), slit(2), last.clone(), target(x)]);
    let half = 0.5f64.sqrt();
    assert_eq!(
        [seen(4.0 - half), seen(4.0), seen(4.0 + half)],
        [true, false, true]
    );
}

#[test]
fn alternating_doors_hide_floor_of_fourth_room() {
    // The rooms are at x = 0..5, with doors alternating between z = 0..1 and z = 2..3.
    let door = |k: usize| {
        let z = if k.is_multiple_of(2) {
            [0.0, 1.0]
        } else {
            [2.0, 3.0]
        };
        rectangle(0, k as f64 + 1.0, [0.0, 1.0], z)
    };
    let floor = |from: f64, to: f64| rectangle(2, 0.0, [from, to], [0.0, 1.0]);
    assert!(!state(&[door(0), door(1), door(2), floor(3.0, 4.0)]));
    assert!(!state(&[door(0), door(1), door(2)]));
    assert!(state(&[door(0), door(1)]));
}

proptest! {
    /// Places doors around points of a line, across any axis.
    ///
    /// The line stabs them, no matter how far their planes reach through each other.
    #[test]
    fn line_stabs_doors_around_it(
        direction in prop::array::uniform3(1i64..9),
        doors in prop::collection::vec((1i64..9, 0usize..3, prop::array::uniform4(1i64..30)), 1..14),
        flips in prop::array::uniform3(any::<bool>()),
    ) {
        let mut t = 0;
        let portals: Vec<Polygon> = doors
            .iter()
            .map(|(step, axis, [a, b, c, d])| {
                t += step;
                let at = direction.map(|x| x * t * UNIT);
                let corner = |u: i64, v: i64| {
                    let mut p = at;
                    p[(axis + 1) % 3] += u * UNIT;
                    p[(axis + 2) % 3] += v * UNIT;
                    std::array::from_fn(|k| if flips[k] { -p[k] } else { p[k] })
                };
                polygon(&[corner(-a, -c), corner(*b, -c), corner(*b, *d), corner(-a, *d)])
            })
            .collect();
        prop_assert!(state(&portals));
    }
}

fn polygons() -> impl Strategy<Value = Vec<Polygon>> {
    // The polygons are triangles and parallelograms on a grid, one after another along x.
    let one = (
        prop::array::uniform3(prop::array::uniform3(-3i64..4)),
        any::<bool>(),
    );
    prop::collection::vec(one, 2..6).prop_map(|all| {
        all.into_iter()
            .enumerate()
            .filter_map(|(k, (v, four))| {
                let [a, b, c] =
                    v.map(|p| [p[0] + 4 * k as i64, 2 * p[1], 2 * p[2]].map(|x| x * UNIT));
                let d = [0, 1, 2].map(|i| a[i] + c[i] - b[i]);
                let corners = if four {
                    vec![a, b, c, d]
                } else {
                    vec![a, b, c]
                };
                let exact = |c: &[i64; 3]| {
                    let [x, y, z] = c.map(IBig::from);
                    PointOrigin::Exact(Box::new([x, y, z, IBig::from(UNIT)]))
                };
                Polygon::exact(corners.iter().map(exact).collect()).ok()
            })
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    /// No line through points of the ends stabs a blocked sequence, and turning the axes preserves the
    /// result.
    #[test]
    fn no_line_stabs_blocked_sequence(
        portals in polygons(),
        weights in prop::collection::vec(prop::array::uniform6(1u32..200), 60),
    ) {
        prop_assume!(portals.len() >= 2);
        let found = state(&portals);
        let back: Vec<Polygon> = portals.iter().rev().cloned().collect();
        prop_assert_eq!(state(&back), found);
        let turned: Vec<Polygon> = portals
            .iter()
            .map(|p| {
                let turn = |p: &PointOrigin| {
                    let [x, y, z, w] = predicates::integers(p);
                    PointOrigin::Exact(Box::new([y, z, -x, w]))
                };
                Polygon::exact(p.points().iter().map(turn).collect()).unwrap()
            })
            .collect();
        prop_assert_eq!(state(&turned), found);
        if !found {
            let inside = |p: &Polygon, w: [u32; 3]| {
                let corners = [0, 1, 2].map(|i| predicates::integers(&p.points()[i]));
                let sum: u32 = w.iter().sum();
                let mut x: [IBig; 4] = std::array::from_fn(|k| {
                    (0..3).map(|i| &corners[i][k] * IBig::from(w[i])).sum::<IBig>()
                });
                // All corners have the same last component.
                x[3] = &corners[0][3] * IBig::from(sum);
                PointOrigin::Exact(Box::new(x))
            };
            for w in weights {
                let p = inside(&portals[0], [w[0], w[1], w[2]]);
                let q = inside(&portals[portals.len() - 1], [w[3], w[4], w[5]]);
                prop_assert!(!stabs(&portals, [&p, &q]), "{p:?} {q:?}");
            }
        }
    }
}
