//! Tests of the bounds of the filters in `f64`: points that need the whole bound, decisions of clear cases,
//! and the exact stages behind the filters.

use proptest::prelude::*;

use super::*;

/// Computes the determinant of `orient2d_sign` in `f64`, relative to the unit of its error bound.
fn rounded2d([a, b, p]: [[f32; 2]; 3]) -> f64 {
    let d = |x: f32, y: f32| f64::from(x) - f64::from(y);
    let (l, r) = (d(b[0], a[0]) * d(p[1], a[1]), d(b[1], a[1]) * d(p[0], a[0]));
    (l - r) / (l.abs() + r.abs()) / U
}

/// Computes the determinant of `orient3d_sign` in `f64`, relative to the unit of its error bound.
fn rounded3d([a, b, c, p]: [[f32; 3]; 4]) -> f64 {
    let d = |x: [f32; 3]| [0, 1, 2].map(|k| f64::from(x[k]) - f64::from(a[k]));
    let (det, magnitude) = det3(d(b), d(c), d(p));
    det / magnitude / U
}

/// Points a, b, p whose turn `f64` computes as 2.0u.
const WORST_2D: [[f32; 2]; 3] = [
    [-7.807112e-10, -7.8070805e-10],
    [-1.0000136, -1.0000095],
    [1.0000136, 1.0000095],
];

/// Points a, b, c, p whose orientation `f64` computes as 4.7u. Two of the six products are large and cancel.
const WORST_3D: [[f32; 3]; 4] = [
    [-9.1386665e-10, 1.2427775e-09, -3.3942615e-10],
    [1.0300967, -1.0166426, -3.3942615e-10],
    [-9.1386665e-10, 1.0166426, -1.0124049],
    [-1.0300967, 1.2427775e-09, 1.0124049],
];

/// Uses the worst case in two dimensions.
///
/// All six differences and one product lose almost u, in the directions that add up. An annealing search over
/// the low bits of such points found these points.
#[test]
fn half_bound_of_orient2d_gives_wrong_sign() {
    let points = WORST_2D;
    let rounded = rounded2d(points);
    assert!(
        rounded > 0.5 * ORIENT2D_BOUND / U && rounded < ORIENT2D_BOUND / U,
        "{rounded} u"
    );
    // The determinant is −0.0012u of the products' magnitudes in integers.
    assert_eq!(
        orient2d_sign(points[0], points[1], points[2]),
        Ordering::Less
    );
}

/// Uses the worst case in three dimensions, found in the same way: the determinant is −0.0005u in integers.
#[test]
fn half_bound_of_orient3d_gives_wrong_sign() {
    let [a, b, c, p] = WORST_3D.map(Vec3::from);
    let rounded = rounded3d(WORST_3D);
    assert!(
        rounded > 0.5 * ORIENT3D_BOUND / U && rounded < ORIENT3D_BOUND / U,
        "{rounded} u"
    );
    assert_eq!(orient3d_sign(a, b, c, p), Ordering::Less);
}

/// Generates coordinates as integers, which the tests scale by a power of two, so that determinants are
/// integers.
fn wide() -> impl Strategy<Value = [[i64; 3]; 4]> {
    let near = -3i64..4;
    let any = -(1i64 << 22)..1 << 22;
    let wide = (-3i64..4, 0u32..22).prop_map(|(m, e)| m << e);
    prop::array::uniform4(prop::array::uniform3(prop_oneof![near, any, wide]))
}

proptest! {
    /// A filter that never decided a sign would be slow but would pass every other test.
    #[test]
    fn filters_decide_clear_signs(p in wide(), e in -60i32..60) {
        let v = p.map(|q| q.map(|c| c as f32 * 2f32.powi(e)));
        let d = |k: usize, i: usize| i128::from(p[k][i] - p[0][i]);
        let products = |i: usize, j: usize| (d(1, i) * d(2, j), d(1, j) * d(2, i));
        let minor = |i: usize, j: usize| {
            let (l, r) = products(i, j);
            (l - r, l.abs() + r.abs())
        };
        let clear = |det: i128, magnitude: i128| det.abs() as f64 > 16.0 * U * magnitude as f64;

        let (det, magnitude) = minor(0, 1);
        let flat = |k: usize| [v[k][0], v[k][1]];
        let sign = orient2d_filtered(flat(0), flat(1), flat(2));
        prop_assert!(sign.is_none_or(|s| s == det.cmp(&0)));
        prop_assert!(sign.is_some() || !clear(det, magnitude), "{det} of {magnitude}");

        let terms = [(1, 2, 0), (2, 0, 1), (0, 1, 2)].map(|(i, j, k)| {
            let (det, magnitude) = minor(i, j);
            (det * d(3, k), magnitude * d(3, k).abs())
        });
        let (det, magnitude) = terms.iter().fold((0, 0), |(x, y), (det, size)| (x + det, y + size));
        let [a, b, c, q] = v.map(Vec3::from);
        let sign = orient3d_filtered(a, b, c, q);
        prop_assert!(sign.is_none_or(|s| s == det.cmp(&0)));
        prop_assert!(sign.is_some() || !clear(det, magnitude), "{det} of {magnitude}");
    }

    /// Uses points that are almost on one line.
    ///
    /// `b` and `p` are opposite or in one direction, and `a` is 2³⁰ times nearer to the origin. Then all
    /// differences round, and most signs need the expansion.
    #[test]
    fn nearly_collinear_points_agree_with_integers(
        b in prop::array::uniform2(1i64 << 22..1 << 23), a in -(1i64 << 24) + 8..(1 << 24) - 8,
        off in -3i64..4, times in prop::sample::select(vec![-2i64, -1, 2]), turned in any::<bool>(),
        e in -60i32..40,
    ) {
        let along = (a as f64 * b[1] as f64 / b[0] as f64).round() as i64;
        prop_assume!((along + off).abs() < 1 << 24);
        let (a, b) = ([a, along + off], b.map(|c| c << 29));
        let p = b.map(|c| c * times);
        let points = if turned { [a, p, b] } else { [a, b, p] };
        let d = |k: usize, i: usize| i128::from(points[k][i]) - i128::from(points[0][i]);
        let det = d(1, 0) * d(2, 1) - d(1, 1) * d(2, 0);
        let v = points.map(|q| q.map(|c| c as f32 * 2f32.powi(e)));
        prop_assert_eq!(orient2d_sign(v[0], v[1], v[2]), det.cmp(&0));
    }

    /// The points are nearly in one plane, opposite or mixed, and one is 2³⁰ times nearer to the origin. The
    /// test compares with exact sums, which need no differences.
    #[test]
    fn nearly_coplanar_points_agree_with_exact_sums(
        b in prop::array::uniform3(-(1i64 << 22)..1 << 22),
        c in prop::array::uniform3(-(1i64 << 22)..1 << 22),
        mix in prop::array::uniform2(-3.0f64..3.0), at in prop::array::uniform2(-1i64..2), off in -3i64..4,
        e in -60i32..40,
    ) {
        let p: [i64; 3] = std::array::from_fn(|k| at[0] * b[k] + at[1] * c[k]);
        let mut a: [i64; 3] =
            std::array::from_fn(|k| (mix[0] * b[k] as f64 + mix[1] * c[k] as f64).round() as i64 / 2);
        a[2] += off;
        let scaled = |q: [i64; 3], up: i32| Vec3::from(q.map(|x| x as f32 * 2f32.powi(e + up)));
        let v = [scaled(a, 0), scaled(b, 29), scaled(c, 29), scaled(p, 29)];
        let mut sum = Sum::default();
        for (x, y, z, s) in [(1, 2, 3, 1.0), (0, 2, 3, -1.0), (0, 1, 3, 1.0), (0, 1, 2, -1.0)] {
            det3_terms(v[x], v[y], v[z]).into_iter().for_each(|t| sum.add(s * t));
        }
        prop_assert_eq!(orient3d_sign(v[0], v[1], v[2], v[3]), sum.sign());
        prop_assert_eq!(orient3d_sign(v[0], v[2], v[1], v[3]), sum.sign().reverse());
    }

    /// Uses determinants of a few units whose terms have up to 72 bits.
    ///
    /// The determinants are (b − a) · (c − b) × (p − b). The last two differences are small, and the first is
    /// perpendicular to both, up to `off`.
    #[test]
    fn expansion_keeps_every_bit(
        b in prop::array::uniform3(-(1i64 << 22)..1 << 22),
        s in prop::array::uniform3(-(1i64 << 16)..1 << 16),
        small in prop::array::uniform2(prop::array::uniform3(-4i64..5)), off in -2i64..3, k in 0usize..3,
        e in -60i32..40,
    ) {
        let cross = |x: [i64; 3], y: [i64; 3]| -> [i64; 3] {
            std::array::from_fn(|k| x[(k + 1) % 3] * y[(k + 2) % 3] - x[(k + 2) % 3] * y[(k + 1) % 3])
        };
        let w = cross(small[0], small[1]);
        let mut v = cross(s, w);
        v[k] += off;
        let add = |x: [i64; 3], y: [i64; 3], sign: i64| -> [i64; 3] {
            std::array::from_fn(|k| x[k] + sign * y[k])
        };
        let all = [add(b, v, -1), b, add(b, small[0], 1), add(b, small[1], 1)];
        let [a, b, c, p] = all.map(|q| Vec3::from(q.map(|x| x as f32 * 2f32.powi(e))));
        let truth = (off * w[k]).cmp(&0);
        prop_assert_eq!(orient3d_expanded(a, b, c, p), truth);
        prop_assert_eq!(orient3d_sign(a, b, c, p), truth);
    }

    /// The common point of a line and a plane is rational; its position in the triangle has integer signs.
    #[test]
    fn crossings_agree_with_rational_points(p in prop::array::uniform5(prop::array::uniform3(-3i64..4))) {
        let sub = |x: [i64; 3], y: [i64; 3]| -> [i64; 3] { std::array::from_fn(|k| x[k] - y[k]) };
        let dot = |x: [i64; 3], y: [i64; 3]| x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
        let cross = |x: [i64; 3], y: [i64; 3]| -> [i64; 3] {
            std::array::from_fn(|k| x[(k + 1) % 3] * y[(k + 2) % 3] - x[(k + 2) % 3] * y[(k + 1) % 3])
        };
        let [a, b, c, from, to] = p;
        let normal = cross(sub(b, a), sub(c, a));
        prop_assume!(normal != [0; 3] && from != to);
        let heights = [from, to].map(|q| dot(normal, sub(q, a)));
        let truth = if heights == [0, 0] {
            Crossing::Touches
        } else if heights[0].signum() * heights[1].signum() > 0 {
            Crossing::Not
        } else {
            let [h, g] = heights.map(i64::abs);
            // The common point, multiplied by h + g.
            let x: [i64; 3] = std::array::from_fn(|k| from[k] * g + to[k] * h);
            let scaled = |q: [i64; 3]| q.map(|c| c * (h + g));
            let sides = [(a, b), (b, c), (c, a)]
                .map(|(s, t)| dot(normal, cross(sub(t, s), sub(x, scaled(s)))).signum());
            match (sides.contains(&-1), sides.contains(&0) || h == 0 || g == 0) {
                (true, _) => Crossing::Not,
                (false, true) => Crossing::Touches,
                (false, false) => Crossing::Inside,
            }
        };
        let [a, b, c, from, to] = p.map(|q| Vec3::from(q.map(|c| c as f32)));
        prop_assert_eq!(crossing([a, b, c], from, to), truth);
        prop_assert_eq!(crossing([a, c, b], to, from), truth);
    }

    #[test]
    fn dyadic_is_odd_integer_times_power(bits in any::<u64>(), few in 0u32..60) {
        let x = f64::from_bits(bits >> few << few);
        prop_assume!(x.is_finite());
        let (m, e) = dyadic(x);
        prop_assert_eq!(m % 2 == 0, x == 0.0);
        // 2^e may be below the range of doubles.
        let half = e / 2;
        prop_assert_eq!(m as f64 * 2f64.powi(half) * 2f64.powi(e - half), x);
    }

    #[test]
    fn differences_are_exact_or_none(
        a in prop::array::uniform3(-(1i64 << 53)..1 << 53),
        p in prop::array::uniform3(-(1i64 << 53)..1 << 53),
    ) {
        let double = |q: [i64; 3]| DVec3::from(q.map(|c| c as f64));
        let apart: [i64; 3] = std::array::from_fn(|k| p[k] - a[k]);
        let exact = apart.iter().all(|c| *c as f64 as i64 == *c).then(|| [apart.map(|c| c as f64)]);
        prop_assert_eq!(differences(double(a), [double(p)]), exact);
    }
}

#[test]
fn dyadic_reads_subnormal_and_zero() {
    assert_eq!(dyadic(0.0), (0, 0));
    assert_eq!(dyadic(-0.0), (0, 0));
    assert_eq!(dyadic(f64::from_bits(1)), (1, -1074));
    assert_eq!(dyadic(-f64::from_bits(6)), (-3, -1073));
    assert_eq!(dyadic(-f64::MIN_POSITIVE), (-1, -1022));
    assert_eq!(dyadic(f64::MAX), ((1 << 53) - 1, 971));
}

#[test]
fn small_integers_reject_values_that_are_not_finite() {
    for x in [f64::NAN, f64::INFINITY] {
        assert_eq!(small_integers([[1.0, x, 2.0]]), None);
    }
    assert_eq!(small_integers([[0.5, -3.0, 0.0]]), Some([[1, -6, 0]]));
    // 41 bits fit, 42 do not.
    let most = f64::from(2).powi(MOST_BITS);
    assert_eq!(
        small_integers([[1.0, most - 1.0, 0.0]]),
        Some([[1, (1 << MOST_BITS) - 1, 0]])
    );
    assert_eq!(small_integers([[1.0, most, 0.0]]), None);
    assert_eq!(small_integers([[1.0, most * 2.0 - 2.0, 0.0]]), None);
    assert_eq!(
        small_integers([[1.0, most / 2.0 + 1.0, 0.0]]),
        Some([[1, (1 << (MOST_BITS - 1)) + 1, 0]])
    );
    assert_eq!(small_integers([[most, 0.0, 0.0]]), Some([[1, 0, 0]]));
}

#[test]
fn crossing_rejects_border() {
    let at = |z: f32| {
        [
            Vec3::new(-1.0, -1.0, z),
            Vec3::new(3.0, -1.0, z),
            Vec3::new(-1.0, 3.0, z),
        ]
    };
    let alone = |triangles: &[[Vec3; 3]], x: f32| {
        crossed_alone(
            triangles.iter().copied(),
            Vec3::new(x, 0.0, -1.0),
            Vec3::new(x, 0.0, 1.5),
        )
    };
    assert_eq!(alone(&[at(2.0), at(0.0), at(-3.0)], 0.0), Some(1));
    assert_eq!(alone(&[at(0.0), at(1.0)], 0.0), None);
    // The segment passes through the triangle's border, and ends in the second triangle.
    assert_eq!(alone(&[at(0.0)], -1.0), None);
    assert_eq!(alone(&[at(0.0), at(1.5)], 0.0), None);
    assert_eq!(alone(&[], 0.0), None);
}
