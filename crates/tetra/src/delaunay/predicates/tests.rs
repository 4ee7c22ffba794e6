//! Tests of the predicates against integers of any width, on lattices, at every scale and where doubles fail.

use proptest::prelude::*;

use super::*;

/// Three points and a viewpoint whose orientation is negative. `f64` computes it as +15.58u of the product of
/// the largest differences. An annealing search over the low bits of nearly flat matrices of ±1 found them.
const WORST: ([[f32; 3]; 3], [f64; 3]) = (
    [
        [0.998237, 1.0030068, 1.0008562],
        [-1.0060744, 1.0028253, -1.0098703],
        [-1.0084602, -0.96784025, -1.013673],
    ],
    [
        0.0007849556111360168,
        -0.001122060475977367,
        -0.0005063673487796393,
    ],
);

/// Converts finite numbers to integers times one power of two.
fn integers<const N: usize>(points: [[f64; 3]; N]) -> [[IBig; 3]; N] {
    // A double is an integer times 2⁻¹⁰⁷⁴.
    points.map(|p| {
        p.map(|c| {
            let field = (c.abs().to_bits() >> 52) as usize;
            let mantissa = c.to_bits() & ((1 << 52) - 1) | if field == 0 { 0 } else { 1 << 52 };
            let size = IBig::from(mantissa) << (field.max(1) - 1);
            if c < 0.0 { -size } else { size }
        })
    })
}

fn apart(p: &[IBig; 3], q: &[IBig; 3]) -> [IBig; 3] {
    [0, 1, 2].map(|k| &p[k] - &q[k])
}

fn volume([a, b, c]: [&[IBig; 3]; 3]) -> IBig {
    let minor = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
    minor(1, 2) * &c[0] + minor(2, 0) * &c[1] + minor(0, 1) * &c[2]
}

fn true_side(points: [[f32; 3]; 3], x: [f64; 3]) -> Ordering {
    let [a, b, c] = points.map(|p| p.map(f64::from));
    let [x, a, b, c] = integers([x, a, b, c]);
    let [a, b, c] = [a, b, c].map(|p| apart(&p, &x));
    volume([&a, &b, &c]).cmp(&IBig::ZERO)
}

fn true_orient([a, b, c, d]: [[f32; 3]; 4]) -> Ordering {
    true_side([b, c, d], a.map(f64::from))
}

/// Computes the signs of the sphere's determinant and of the orientations after `e` replaced a corner.
fn true_conflict(corners: [[f32; 3]; 4], e: [f32; 3]) -> (Ordering, [Ordering; 4]) {
    let [a, b, c, d] = corners.map(|p| p.map(f64::from));
    let [e, a, b, c, d] = integers([e.map(f64::from), a, b, c, d]);
    let rows = [a, b, c, d].map(|p| apart(&p, &e));
    let lift = |r: &[IBig; 3]| &r[0] * &r[0] + &r[1] * &r[1] + &r[2] * &r[2];
    let signed = |k: usize| {
        let [i, j, l] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]][k];
        let volume = volume([&rows[i], &rows[j], &rows[l]]);
        if k.is_multiple_of(2) { volume } else { -volume }
    };
    let volumes = [0, 1, 2, 3].map(signed);
    let sum = volumes
        .iter()
        .zip(&rows)
        .fold(IBig::ZERO, |sum, (v, r)| sum + v * lift(r));
    (sum.cmp(&IBig::ZERO), volumes.map(|v| v.cmp(&IBig::ZERO)))
}

/// Generates points of few values, of any mantissas, and of any scales.
fn points<const N: usize>() -> impl Strategy<Value = [[f32; 3]; N]> {
    let near = (-2i32..3).prop_map(|c| c as f32);
    let fine = (-2i32..3, -2i32..3).prop_map(|(c, off)| (c as f32) + off as f32 * f32::EPSILON);
    let any = -1.5f32..1.5;
    let scaled = (-2i32..3, -40i32..40).prop_map(|(c, e)| c as f32 * 2f32.powi(e));
    let coordinate = prop_oneof![4 => near, 2 => fine, 2 => any, 1 => scaled];
    (
        proptest::collection::vec(coordinate, 3 * N),
        prop_oneof![Just(0), -60i32..60],
    )
        .prop_map(|(c, e)| {
            std::array::from_fn(|i| std::array::from_fn(|k| c[3 * i + k] * 2f32.powi(e)))
        })
}

/// Checks a conflict of every order of the corners that has a positive volume.
fn check_conflict(all: &[[f32; 3]; 5]) -> Result<(), TestCaseError> {
    let predicates = Predicates::new(all);
    let at = |k: u32| all[k as usize];
    let mut corners = [0, 1, 2, 3];
    let orient = predicates.orient(corners);
    prop_assert_eq!(orient, true_orient(corners.map(at)));
    if orient == Ordering::Equal {
        return Ok(());
    }
    if orient == Ordering::Less {
        corners.swap(0, 1);
    }
    let (side, signs) = true_conflict(corners.map(at), at(4));
    let truth = side.then_with(|| match ties::conflicts(corners, 4, signs) {
        true => Ordering::Greater,
        false => Ordering::Less,
    });
    prop_assert_eq!(predicates.conflicts(corners, 4), truth == Ordering::Greater);
    // All three stages must agree with the exact result if they decide.
    let rows = corners.map(|k| minus(at(k), at(4)));
    if let Some((found, cofactors)) = predicates.conflicts_filtered(&rows) {
        prop_assert_eq!(found, side);
        prop_assert!(found != Ordering::Equal || cofactors.map(sign) == signs);
    }
    let exact = differences(
        Vec3::from(at(4)).as_dvec3(),
        corners.map(|k| Vec3::from(at(k)).as_dvec3()),
    );
    if let Some(found) = exact.and_then(small_signs) {
        prop_assert_eq!(found, (side, signs));
    }
    prop_assert_eq!(big_signs(at(4), corners.map(at)), (side, signs));
    Ok(())
}

proptest! {
    #[test]
    fn orientations_and_conflicts_agree_with_integers(all in points::<5>()) {
        check_conflict(&all)?;
    }

    /// Five points of a sphere that rounding moves off it, or corners of a cube.
    #[test]
    fn nearly_cospherical_points_agree_with_integers(
        ways in prop::array::uniform5(prop::array::uniform2(-3.0f32..3.0)), e in -50i32..50,
        exact in any::<bool>(),
    ) {
        let on = |[u, v]: [f32; 2]| {
            // The inverse of the stereographic projection.
            let (u, v) = if exact { (u.signum(), v.signum()) } else { (u, v) };
            let w = 1.0 + u * u + v * v;
            [2.0 * u / w, 2.0 * v / w, (w - 2.0) / w].map(|c| c * 2f32.powi(e))
        };
        check_conflict(&ways.map(on))?;
    }

    #[test]
    fn sides_agree_with_integers(
        p in points::<3>(), at in points::<1>(), off in prop::array::uniform3(-4i32..5),
        mix in prop::array::uniform2(-2.0f64..2.0), flat in any::<bool>(),
    ) {
        // In the plane of the three points up to rounding, or anywhere.
        let mut x = at[0].map(f64::from);
        if flat {
            let [a, b, c] = p.map(|p| p.map(f64::from));
            let at = |k: usize| a[k] + mix[0] * (b[k] - a[k]) + mix[1] * (c[k] - a[k]);
            x = std::array::from_fn(|k| f64::from_bits((at(k).to_bits() as i64 + i64::from(off[k])) as u64));
            prop_assume!(x.iter().all(|c| c.is_finite()));
        }
        let truth = true_side(p, x);
        prop_assert_eq!(side(p, x), truth);
        prop_assert!(side_filtered(p, x).is_none_or(|s| s == truth));
    }

    /// Sides of viewpoints far away, where products would overflow, and among the smallest numbers.
    #[test]
    fn sides_of_extreme_viewpoints_agree_with_integers(
        p in points::<3>(), at in prop::array::uniform3(-1.0f64..1.0),
        e in prop_oneof![-1060i32..-900, 100i32..1020],
        flat in any::<bool>(),
    ) {
        // Three points of the plane z = 0: the last product is far below the range of doubles.
        let p = if flat { p.map(|[x, y, _]| [x * 1e-19, y * 1e-19, 0.0]) } else { p };
        let x = at.map(|c| c * f64::powi(2.0, e / 2) * f64::powi(2.0, e - e / 2));
        prop_assert_eq!(side(p, x), true_side(p, x));
    }

    /// On a lattice `f64` does not round, so the first stage decides everything, also zeros.
    #[test]
    fn first_stage_decides_lattices(
        p in prop::array::uniform5(prop::array::uniform3(prop_oneof![-1i32..2, -500i32..501])),
        e in -140i32..100,
    ) {
        let all = p.map(|q| q.map(|c| c as f32 * 2f32.powi(e)));
        let predicates = Predicates::new(&all);
        let at = |k: u32| all[k as usize];
        let rows = [1, 2, 3].map(|k| minus(at(k), at(0)));
        prop_assert_eq!(predicates.orient_filtered(&rows), Some(true_orient([0, 1, 2, 3].map(at))));
        let rows = [0, 1, 2, 3].map(|k| minus(at(k), at(4)));
        let found = predicates
            .conflicts_filtered(&rows)
            .map(|(side, cofactors)| (side, cofactors.map(sign)));
        let truth = true_conflict([0, 1, 2, 3].map(at), at(4));
        prop_assert_eq!(found, Some(truth));
        // The second stage decides them too.
        prop_assert_eq!(small_signs(rows), Some(truth));
    }

    /// Off a lattice the first stage decides signs of large determinants: corners of a cube, displaced by up
    /// to a tenth.
    #[test]
    fn first_stage_decides_clear_signs(
        off in prop::array::uniform5(prop::array::uniform3(-0.1f32..0.1)), e in -40i32..30,
    ) {
        let corners =
            [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [0.0; 3]];
        let mut all: [[f32; 3]; 5] = std::array::from_fn(|i| {
            std::array::from_fn(|k| (corners[i][k] + off[i][k]) * 2f32.powi(e))
        });
        // A unit far below all coordinates, so that no value counts as one of a lattice.
        all[4][0] = 2f32.powi(-60);
        let predicates = Predicates::new(&all);
        let rows = [1, 2, 3].map(|k| minus(all[k], all[0]));
        prop_assert_eq!(predicates.orient_filtered(&rows), Some(Ordering::Greater));
        let rows = [0, 1, 2, 3].map(|k| minus(all[k], all[4]));
        prop_assert_eq!(predicates.conflicts_filtered(&rows).map(|f| f.0), Some(Ordering::Greater));
        let x = all[4].map(f64::from);
        prop_assert_eq!(side_filtered([all[1], all[2], all[3]], x), Some(Ordering::Greater));
    }

    #[test]
    fn sums_of_products_agree_with_integers(
        c in prop::array::uniform4(-(1i128 << 126) + 1..1i128 << 126),
        l in prop::array::uniform4(0i128..1 << 84),
        few in 0u32..126, cancel in 0u32..3, off in -2i128..3,
    ) {
        let (mut c, mut l) = (c.map(|c| c >> few), l.map(|l| l >> (few / 2)));
        // Sums that cancel, exactly or up to a few units.
        if cancel > 0 {
            (c[1], l[1]) = (-c[0], l[0]);
            (c[2], l[2]) = (off, i128::from(cancel > 1));
            c[3] = 0;
        }
        let sum = c.iter().zip(&l).fold(IBig::ZERO, |sum, (c, l)| sum + IBig::from(*c) * IBig::from(*l));
        prop_assert_eq!(sum_of_products(c, l), sum.cmp(&IBig::ZERO));
    }
}

#[test]
fn half_orient_bound_gives_wrong_sign() {
    let (points, x) = WORST;
    let rows = points.map(|p| [0, 1, 2].map(|k| f64::from(p[k]) - x[k]));
    let rounded = det(&rows[0], &rows[1], &rows[2]) / largest(&rows).iter().product::<f64>();
    assert!(
        rounded > 0.5 * ORIENT_BOUND && rounded < ORIENT_BOUND,
        "{} u",
        rounded / U
    );
    assert_eq!(true_side(points, x), Ordering::Less);
    assert_eq!(side_filtered(points, x), None);
    assert_eq!(side(points, x), Ordering::Less);
}

#[test]
fn equal_points_are_the_same() {
    let predicates = Predicates::new(&[[0.0, 1.0, 2.0], [-0.0, 1.0, 2.0], [0.0, 1.0, 3.0]]);
    assert!(predicates.same(0, 1) && predicates.same(2, 2) && !predicates.same(0, 2));
}
