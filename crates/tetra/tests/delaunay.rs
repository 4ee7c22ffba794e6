//! Tests of Delaunay tetrahedra against brute force and against their invariants, all in integers.
#![allow(clippy::unwrap_used, reason = "tests fail by panics")]

use std::cmp::Ordering;
use std::collections::BTreeSet;

use dashu_int::IBig;
use proptest::prelude::*;
use sightline_tetra::Quiet;
use sightline_tetra::delaunay::{Delaunay, DelaunayError, NONE};

/// Converts finite numbers to integers times one power of two, and returns a bound of their bits.
fn integers(x: &[[f64; 3]]) -> (Vec<[IBig; 3]>, usize) {
    // The parts are an odd mantissa and its exponent, relative to the exponent of the smallest double.
    let parts = |c: f64| {
        let field = (c.abs().to_bits() >> 52) as usize;
        let mantissa = c.to_bits() & ((1 << 52) - 1) | if field == 0 { 0 } else { 1 << 52 };
        let zeros = mantissa.trailing_zeros();
        (
            IBig::from(mantissa >> zeros) * if c < 0.0 { -1 } else { 1 },
            field.max(1) + zeros as usize,
        )
    };
    let exponents = || {
        x.as_flattened()
            .iter()
            .filter(|c| **c != 0.0)
            .map(|c| parts(*c).1)
    };
    let (least, most) = (
        exponents().min().unwrap_or(1),
        exponents().max().unwrap_or(1),
    );
    let whole = |c: f64| {
        if c == 0.0 {
            IBig::ZERO
        } else {
            parts(c).0 << (parts(c).1 - least)
        }
    };
    (x.iter().map(|p| p.map(whole)).collect(), most - least + 53)
}

fn wide(points: &[[f32; 3]]) -> Vec<[f64; 3]> {
    points.iter().map(|p| p.map(f64::from)).collect()
}

/// Returns six times the volume of a tetrahedron.
fn volume([a, b, c, d]: [&[IBig; 3]; 4]) -> IBig {
    let [b, c, d] = [b, c, d].map(|p| [0, 1, 2].map(|k| &p[k] - &a[k]));
    let minor = |i: usize, j: usize| &b[i] * &c[j] - &b[j] * &c[i];
    minor(1, 2) * &d[0] + minor(2, 0) * &d[1] + minor(0, 1) * &d[2]
}

/// Returns the scaled depth of point e below the hyperplane through four lifted points.
///
/// The scale is six times the volume of the tetrahedron of the four points. A positive result is a conflict.
fn below(corners: [u32; 4], e: u32, points: &[[IBig; 3]], heights: &[IBig]) -> IBig {
    let at = |k: u32| &points[k as usize];
    let sum = (0..4).fold(IBig::ZERO, |sum, k| {
        let mut replaced = corners;
        replaced[k] = e;
        sum + volume(replaced.map(at)) * &heights[corners[k] as usize]
    });
    sum - volume(corners.map(at)) * &heights[e as usize]
}

fn squares(points: &[[IBig; 3]]) -> Vec<IBig> {
    points
        .iter()
        .map(|[x, y, z]| x * x + y * y + z * z)
        .collect()
}

fn sorted(mut corners: [u32; 4]) -> [u32; 4] {
    corners.sort_unstable();
    corners
}

/// Returns all quadruples that no point conflicts with, for perturbed heights |p|².
///
/// The heights are raised by real numbers that are as small and as different as the infinitely small ones.
/// For coordinates of b bits, a volume is an integer of at most 3b + 9 bits. So each share outweighs all
/// smaller shares, and one unit of the heights outweighs all shares.
fn brute_force(points: &[[f32; 3]]) -> BTreeSet<[u32; 4]> {
    let (points, bits) = integers(&wide(points));
    let step = 3 * bits + 12;
    let raised = |(k, square): (usize, IBig)| {
        (square << (step * (points.len() + 1))) + (IBig::ONE << (step * (points.len() - 1 - k)))
    };
    let heights: Vec<IBig> = squares(&points)
        .into_iter()
        .enumerate()
        .map(raised)
        .collect();
    let n = points.len() as u32;
    let quadruples = (0..n).flat_map(move |a| {
        (a + 1..n)
            .flat_map(move |b| (b + 1..n).flat_map(move |c| (c + 1..n).map(move |d| [a, b, c, d])))
    });
    let keeps = |&[a, b, c, d]: &[u32; 4]| {
        let corners = match volume([a, b, c, d].map(|k| &points[k as usize])).cmp(&IBig::ZERO) {
            Ordering::Greater => [a, b, c, d],
            Ordering::Less => [a, b, d, c],
            Ordering::Equal => return false,
        };
        let mut others = (0..n).filter(|e| !corners.contains(e));
        others.all(|e| below(corners, e, &points, &heights) < IBig::ZERO)
    };
    quadruples.filter(keeps).collect()
}

/// Checks the invariants of all Delaunay tetrahedra.
///
/// Volumes are positive and add up to the volume of the box. Neighbours name each other and share a face; a
/// face without a neighbour is on the border of the box. No corner is inside a neighbour's sphere. Every
/// point is a corner.
fn check(d: &Delaunay, given: &[[f32; 3]]) {
    assert_eq!(&d.points[..given.len()], given);
    assert_eq!(d.points.len(), given.len() + 8);
    assert_eq!(d.tetrahedra.len(), d.neighbours.len());
    let (points, _) = integers(&wide(&d.points));
    let heights = squares(&points);
    let mut total = IBig::ZERO;
    let mut used = vec![false; points.len()];
    for (t, (corners, neighbours)) in (0..).zip(d.tetrahedra.iter().zip(&d.neighbours)) {
        let six = volume(corners.map(|k| &points[k as usize]));
        assert!(six > IBig::ZERO, "{corners:?}");
        assert!(corners[0] < corners[1] && corners[1] < corners[2].min(corners[3]));
        total += six;
        for k in 0..4 {
            used[corners[k] as usize] = true;
            let face: BTreeSet<u32> = (0..4).filter(|m| *m != k).map(|m| corners[m]).collect();
            if neighbours[k] == NONE {
                let first = given.len() as u32;
                assert!(face.iter().all(|c| *c >= first), "{face:?}");
                let on =
                    |axis: u32, side: u32| face.iter().all(|c| (c - first) >> axis & 1 == side);
                assert!((0..3).any(|axis| on(axis, 0) || on(axis, 1)), "{face:?}");
                continue;
            }
            let (other, back) = (
                d.tetrahedra[neighbours[k] as usize],
                d.neighbours[neighbours[k] as usize],
            );
            let opposite = back.iter().position(|b| *b == t).unwrap();
            assert!(
                (0..4)
                    .filter(|m| *m != opposite)
                    .all(|m| face.contains(&other[m]))
            );
            assert!(below(*corners, other[opposite], &points, &heights) <= IBig::ZERO);
        }
    }
    assert!(used.iter().all(|u| *u));
    let [lower, upper] = [points.len() - 8, points.len() - 1].map(|k| &points[k]);
    let size = (0..3).fold(IBig::ONE, |product, k| product * (&upper[k] - &lower[k]));
    assert_eq!(total, size * 6);
}

fn is_brute_force(points: &[[f32; 3]]) {
    let d = Delaunay::new(points).unwrap();
    check(&d, points);
    let found: BTreeSet<[u32; 4]> = d.tetrahedra.iter().map(|c| sorted(*c)).collect();
    assert_eq!(found.len(), d.tetrahedra.len());
    assert_eq!(found, brute_force(&d.points), "{points:?}");
    for seed in 1..4 {
        assert_eq!(
            Delaunay::with_seed(points, seed, &Quiet).unwrap(),
            d,
            "{points:?}"
        );
    }
}

fn distinct(points: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    let mut seen = BTreeSet::new();
    points
        .into_iter()
        .filter(|p| seen.insert(p.map(|c| (c + 0.0).to_bits())))
        .collect()
}

fn cube(n: i32) -> Vec<[f32; 3]> {
    (0..n * n * n)
        .map(|i| [i % n, i / n % n, i / n / n].map(|c| c as f32))
        .collect()
}

/// Returns the integer points at distance 9 from the origin.
fn sphere() -> Vec<[f32; 3]> {
    let all =
        (-9i32..10).flat_map(|x| (-9..10).flat_map(move |y| (-9..10).map(move |z| [x, y, z])));
    all.filter(|p| p.iter().map(|c| c * c).sum::<i32>() == 81)
        .map(|p| p.map(|c| c as f32))
        .collect()
}

/// Returns true if the tetrahedra have a front-to-back order from `x`.
fn has_order(d: &Delaunay, x: [f64; 3]) -> bool {
    let behind = |t: u32| {
        (0..4).filter_map(move |k| {
            let next = d.neighbours[t as usize][k];
            (next != NONE && d.side(t, k, x) == Ordering::Greater).then_some(next)
        })
    };
    let mut waits = vec![0; d.tetrahedra.len()];
    let all = 0..d.tetrahedra.len() as u32;
    all.clone()
        .flat_map(behind)
        .for_each(|t| waits[t as usize] += 1);
    let mut ready: Vec<u32> = all.filter(|t| waits[*t as usize] == 0).collect();
    let mut visited = 0;
    while let Some(t) = ready.pop() {
        visited += 1;
        for next in behind(t) {
            waits[next as usize] -= 1;
            if waits[next as usize] == 0 {
                ready.push(next);
            }
        }
    }
    visited == d.tetrahedra.len()
}

/// Returns true if the closed tetrahedron contains `x`, in integers.
fn holds(d: &Delaunay, t: u32, x: [f64; 3]) -> bool {
    let [a, b, c, e] = d.tetrahedra[t as usize].map(|c| d.points[c as usize].map(f64::from));
    let (whole, _) = integers(&[a, b, c, e, x]);
    (0..4).all(|k| {
        let replaced = [0, 1, 2, 3].map(|m| &whole[if m == k { 4 } else { m }]);
        let exact = volume(replaced).cmp(&IBig::ZERO);
        assert_eq!(exact, d.side(t, k, x), "side {k} of {t} from {x:?}");
        exact != Ordering::Less
    })
}

fn in_box(d: &Delaunay, x: [f64; 3]) -> bool {
    let [lower, upper] = d.bounds();
    (0..3).all(|k| f64::from(lower[k]) <= x[k] && x[k] <= f64::from(upper[k]))
}

#[test]
fn small_and_flat_sets_match_brute_force() {
    is_brute_force(&[]);
    assert!((5..=6).contains(&Delaunay::new(&[]).unwrap().tetrahedra.len()));
    is_brute_force(&[[0.0; 3]]);
    is_brute_force(&[[5.5, -7.25, 1e-20]]);
    is_brute_force(&(0..9).map(|i| [i as f32, 0.0, 0.0]).collect::<Vec<_>>());
    is_brute_force(
        &(0..9)
            .map(|i| [i as f32, 2.0 * i as f32, -i as f32])
            .collect::<Vec<_>>(),
    );
    is_brute_force(
        &(0..9)
            .map(|i| [(i % 3) as f32, (i / 3) as f32, 4.0])
            .collect::<Vec<_>>(),
    );
}

#[test]
fn points_on_sphere_match_brute_force() {
    let all = sphere();
    is_brute_force(&all[..12]);
    is_brute_force(&all.iter().rev().step_by(9).copied().collect::<Vec<_>>());
    is_brute_force(&cube(2));
    let d = Delaunay::new(&all).unwrap();
    check(&d, &all);
    assert_eq!(Delaunay::with_seed(&all, 9, &Quiet).unwrap(), d);
    for x in [
        [0.0; 3],
        [9.0, 0.0, 0.0],
        [0.1, 0.2, 0.3],
        [100.0, 1.0, -50.0],
    ] {
        assert!(has_order(&d, x), "{x:?}");
    }
}

#[test]
fn lattice_has_valid_tetrahedra_and_order() {
    let points = cube(10);
    let d = Delaunay::new(&points).unwrap();
    check(&d, &points);
    assert_eq!(Delaunay::with_seed(&points, 1, &Quiet).unwrap(), d);
    for x in [
        [4.5; 3],
        [3.0, 4.0, 5.0],
        [0.5, 0.0, 7.25],
        [-30.0, 4.0, 4.0],
        [4.25, 4.5, 4.125],
    ] {
        assert!(has_order(&d, x), "{x:?}");
    }
    // The numbers of the points decide ties, so another numbering has other, equally valid tetrahedra.
    let turned: Vec<_> = points.iter().rev().copied().collect();
    let other = Delaunay::new(&turned).unwrap();
    check(&other, &turned);
    assert!(has_order(&other, [4.5; 3]));
}

#[test]
fn lattices_beyond_double_precision_are_exact() {
    // Coarse points are mixed with very fine points: the common unit is too small for exact doubles. So
    // integers decide ties: integers of fixed width for the lattice, and of any width with the fine points.
    let mut points: Vec<_> = cube(4).iter().map(|p| p.map(|c| c * 1024.0)).collect();
    points.push([f32::from_bits(1), 1e-30, 5000.1]);
    let d = Delaunay::new(&points).unwrap();
    check(&d, &points);
    assert_eq!(Delaunay::with_seed(&points, 1, &Quiet).unwrap(), d);
    assert!(has_order(&d, [1536.0; 3]));
    let (tiny, huge) = (f32::from_bits(1), 1e38);
    is_brute_force(&[
        [0.0; 3],
        [tiny, 0.0, 0.0],
        [0.0, tiny, 0.0],
        [0.0, 0.0, tiny],
        [tiny, tiny, 0.0],
    ]);
    is_brute_force(&[
        [huge, 0.0, 0.0],
        [1e-38, 0.0, 0.0],
        [0.0, huge, -huge],
        [f32::MIN_POSITIVE, tiny, huge],
    ]);
}

#[test]
fn new_rejects_bad_points() {
    let nan = Delaunay::new(&[[0.0; 3], [1.0, f32::NAN, 0.0]]).unwrap_err();
    assert!(
        matches!(nan, DelaunayError::NotFinite { index: 1, .. }),
        "{nan}"
    );
    let far = Delaunay::new(&[[f32::INFINITY, 0.0, 0.0]]).unwrap_err();
    assert!(
        matches!(far, DelaunayError::NotFinite { index: 0, .. }),
        "{far}"
    );
    let points = [[1.0, 0.0, 2.0], [3.0, 4.0, 5.0], [1.0, -0.0, 2.0]];
    let double = Delaunay::new(&points).unwrap_err();
    assert!(
        matches!(
            double,
            DelaunayError::Duplicate {
                first: 0,
                second: 2,
                ..
            }
        ),
        "{double}"
    );
    let edge = Delaunay::new(&[[f32::MAX; 3], [f32::MIN; 3]]).unwrap_err();
    assert_eq!(edge, DelaunayError::TooFar { reach: f32::MAX });
}

#[test]
fn locate_finds_lattice_places() {
    let d = Delaunay::new(&cube(4)).unwrap();
    let mut hint = u32::MAX;
    for i in 0..4096u32 {
        // Every third of these points is on a plane of the lattice in some axis; some are outside of the box.
        let x: [f64; 3] = [i & 15, i >> 4 & 15, i >> 8].map(|c| f64::from(c) / 3.0 - 1.0);
        let found = d.locate(x, hint);
        assert_eq!(found.is_some(), in_box(&d, x), "{x:?}");
        if let Some(t) = found {
            assert!(holds(&d, t, x), "{x:?}");
            hint = t;
        }
    }
    for x in [
        [f64::NAN, 1.0, 1.0],
        [1.0, f64::INFINITY, 1.0],
        [1e300, 1.0, 1.0],
        [1.0, 1.0, -1e9],
    ] {
        assert_eq!(d.locate(x, 0), None);
    }
    let corner = d.bounds()[0].map(f64::from);
    for x in [
        [1e-320, 1.0, 2.0],
        [1.0 + f64::EPSILON, 1.0, 1.0],
        [-1e-310, 1e-200, 3.0],
        corner,
    ] {
        assert!(holds(&d, d.locate(x, 7).unwrap(), x), "{x:?}");
    }
}

#[test]
fn power_matches_circumspheres() {
    let points = cube(3);
    let d = Delaunay::new(&points).unwrap();
    let x = [0.75, -3.0, 10.5];
    for (t, corners) in (0..).zip(&d.tetrahedra) {
        for corner in corners {
            assert!(d.power(t, d.points[*corner as usize].map(f64::from)).abs() < 1e-12);
        }
        if corners.iter().all(|c| *c < 27) {
            // The sphere of a cube of the lattice is centred in the cube's middle, and its squared radius is
            // 3/4.
            let middle: [f64; 3] = std::array::from_fn(|k| {
                corners
                    .iter()
                    .map(|c| f64::from(points[*c as usize][k]))
                    .fold(f64::MAX, f64::min)
                    + 0.5
            });
            let power: f64 = (0..3)
                .map(|k| (x[k] - middle[k]) * (x[k] - middle[k]))
                .sum::<f64>()
                - 0.75;
            assert!(
                (d.power(t, x) - power).abs() < 1e-9,
                "{} {power}",
                d.power(t, x)
            );
        }
    }
}

fn some_points() -> impl Strategy<Value = Vec<[f32; 3]>> {
    let few =
        |point: BoxedStrategy<[f32; 3]>| prop::collection::vec(point, 0..12).prop_map(distinct);
    let lattice = |n: i32| {
        prop::array::uniform3(0..n)
            .prop_map(|p| p.map(|c| c as f32))
            .boxed()
    };
    let plane = (0i32..4, 0i32..4)
        .prop_map(|(u, v)| [u, v, u - v].map(|c| c as f32))
        .boxed();
    let on_sphere = prop::sample::select(sphere()).boxed();
    let shifted = prop::sample::select(sphere())
        .prop_map(|p| p.map(|c| c * 0.125 + 1000.0))
        .boxed();
    let reals = prop::array::uniform3(-1.0f32..1.0).boxed();
    let near = prop::array::uniform3(0u32..3)
        .prop_map(|p| p.map(|c| f32::from_bits(1.5f32.to_bits() + c)));
    prop_oneof![
        few(lattice(3)),
        few(lattice(5)),
        few(plane),
        few(on_sphere),
        few(shifted),
        few(reals),
        few(near.boxed())
    ]
}

/// Generates coordinates of all magnitudes that leave room for a box.
fn any_magnitude() -> impl Strategy<Value = Vec<[f32; 3]>> {
    let c = any::<f32>().prop_filter("room for the box", |c| c.is_finite() && c.abs() < 2e38);
    let c = prop_oneof![
        c,
        Just(0.0),
        Just(1.0),
        Just(f32::MIN_POSITIVE),
        Just(f32::from_bits(1))
    ];
    prop::collection::vec(prop::array::uniform3(c), 0..5).prop_map(distinct)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn tetrahedra_match_brute_force(points in some_points()) {
        is_brute_force(&points);
    }

    #[test]
    fn any_viewpoint_has_order_and_location(
        points in some_points(), x in prop::array::uniform3(-1.0f64..5.0),
    ) {
        let d = Delaunay::new(&points).unwrap();
        for x in [x, x.map(f64::round)] {
            prop_assert!(has_order(&d, x));
            let found = d.locate(x, 3);
            prop_assert_eq!(found.is_some(), in_box(&d, x));
            prop_assert!(found.is_none_or(|t| holds(&d, t, x)));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]

    #[test]
    fn all_magnitudes_match_brute_force(points in any_magnitude()) {
        is_brute_force(&points);
    }
}

/// Prints the times for a lattice of 100³ points, and for the scenes in `DELAUNAY_SCENES`.
///
/// The variable contains paths separated by spaces. Run
/// `cargo test --release -p sightline-tetra --test delaunay -- --ignored --nocapture`.
#[test]
#[ignore = "prints times; takes many seconds"]
fn print_times() {
    let mut sets = vec![("lattice".to_owned(), cube(100))];
    for path in std::env::var("DELAUNAY_SCENES")
        .unwrap_or_default()
        .split_whitespace()
    {
        let scene = sightline_scene::load(std::path::Path::new(path)).unwrap();
        sets.push((
            path.to_owned(),
            sightline_tetra::surfaces::Surfaces::new(&scene)
                .unwrap()
                .points,
        ));
    }
    for (name, points) in sets {
        let start = std::time::Instant::now();
        let d = Delaunay::new(&points).unwrap();
        println!(
            "{name}: {} points, {} tetrahedra, {:?}",
            points.len(),
            d.tetrahedra.len(),
            start.elapsed()
        );
    }
}
