//! The frame of a query: an affine map after which both polygons are about as wide as their distance.
//!
//! If two small polygons are far from each other and from the origin, their Plücker coordinates agree in most
//! bits. The map removes this agreement and does not change any sign. The map is exact by construction: an
//! origin in doubles, rows of small integers, and powers of two. Coordinates in the frame are doubles with an
//! error bound, or exact integers.

use dashu_int::IBig;
use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::arithmetic::double_double::{DoubleDouble, STEP};
use crate::arithmetic::number::{double_double, homogeneous, integers, primitive};

/// The denominator of the row entries. With multiples of 1/64, the rows deviate from the chosen axes by less
/// than a degree.
const STEPS: f64 = 64.0;

/// The map x ↦ 2^shift · rows · (x − origin) / 64, with a positive determinant.
#[derive(Clone, Debug)]
pub struct Frame {
    origin: DVec3,
    rows: [[i32; 3]; 3],
    shift: [i32; 3],
    /// The factors 2^(shift − 6) of the integer rows.
    scale: [f64; 3],
}

/// A point in a frame: exact, and rounded with a bound on the error of each coordinate.
#[derive(Clone, Debug)]
pub struct Point {
    /// The rounded coordinates in the frame.
    pub at: [f64; 3],
    /// A bound on the error of each coordinate of `at`.
    pub error: f64,
    /// The coordinates in double-doubles, and a bound on the error of each.
    pub fine: ([DoubleDouble; 3], f64),
    /// The exact position.
    pub place: PointForm,
}

/// The exact position of a point in world space.
#[derive(Clone, Debug)]
pub enum PointOrigin {
    /// Doubles in world space.
    Given(DVec3),
    /// Homogeneous integers in world space, w > 0.
    Exact(Box<[IBig; 4]>),
}

/// The representation of a point of a [`crate::line_space::space::Space`].
#[derive(Clone, Debug)]
pub enum PointForm {
    /// The point's coordinates in world space.
    World(PointOrigin),
    /// The mean Σ weight · point / Σ weight of three other points of the space, as their indices and positive
    /// weights.
    Mix([u32; 3], Box<[IBig; 3]>),
}

impl Frame {
    /// Creates the identity map.
    pub fn world() -> Self {
        let one = STEPS as i32;
        let rows = [[one, 0, 0], [0, one, 0], [0, 0, one]];
        Self {
            origin: DVec3::ZERO,
            rows,
            shift: [0; 3],
            scale: [1.0 / STEPS; 3],
        }
    }

    /// Creates the frame for two polygons with the vertices `a` and `b`, neither of which is empty.
    pub fn around(a: &[DVec3], b: &[DVec3]) -> Self {
        let middle = |p: &[DVec3]| p.iter().sum::<DVec3>() / p.len() as f64;
        let (ca, cb) = (middle(a), middle(b));
        let origin = ((ca + cb) * 0.5).as_vec3().as_dvec3();
        let origin = if origin.is_finite() {
            origin
        } else {
            DVec3::ZERO
        };
        let all = || a.iter().chain(b).map(|p| *p - origin);
        let widest = all().fold(DVec3::ZERO, |m, d| {
            if d.length_squared() > m.length_squared() {
                d
            } else {
                m
            }
        });
        let z = [cb - ca, widest, DVec3::Z]
            .into_iter()
            .find_map(DVec3::try_normalize)
            .unwrap_or(DVec3::Z);
        // The x axis is the direction across z in which the points spread most.
        let (u, v) = z.any_orthonormal_pair();
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for d in all() {
            let (s, t) = (d.dot(u), d.dot(v));
            (xx, xy, yy) = (xx + s * s, xy + s * t, yy + t * t);
        }
        // The axis has half the angle of (xx − yy, 2xy). Square roots compute it, because they round the same
        // on every machine.
        let (c, t) = (xx - yy, 2.0 * xy);
        let h = (c * c + t * t).sqrt();
        let (cos, sin) = if h > 0.0 {
            (
                ((1.0 + c / h) * 0.5).max(0.0).sqrt(),
                ((1.0 - c / h) * 0.5).max(0.0).sqrt(),
            )
        } else {
            (1.0, 0.0)
        };
        let x = u * cos + v * if t < 0.0 { -sin } else { sin };
        let y = z.cross(x);
        let row = |axis: DVec3| (axis * STEPS).round().to_array().map(|c| c as i32);
        let mut rows = [row(x), row(y), row(z)];
        if determinant(&rows) <= 0 {
            // This is impossible for unit vectors; it can happen only after an overflow above. Use the
            // identity then.
            rows = [[64, 0, 0], [0, 64, 0], [0, 0, 64]];
        }
        let shift = std::array::from_fn(|i| {
            let r = DVec3::from(rows[i].map(f64::from)) / STEPS;
            let extent = all().fold(0.0f64, |m, d| m.max(d.dot(r).abs()));
            if extent > 0.0 && extent.is_finite() {
                -above(extent).clamp(-500, 500)
            } else {
                0
            }
        });
        // The limit bounds the scale along an axis in which both polygons extend only a little.
        let least = shift.iter().copied().min().unwrap_or(0);
        let shift = shift.map(|s: i32| s.min(least + 24));
        Self {
            origin,
            rows,
            shift,
            scale: shift.map(|s| f64::powi(2.0, s - 6)),
        }
    }

    /// Maps a point, given in doubles in world space, to the frame.
    ///
    /// A difference is exact as a double-double. Each of three products and two sums is off by at most
    /// [`STEP`] times Σ |row · (p − origin)|.
    pub fn given(&self, p: DVec3) -> Point {
        let d: [DoubleDouble; 3] =
            std::array::from_fn(|j| DoubleDouble::difference(p[j], self.origin[j]));
        let mut fine_error = 0.0f64;
        let fine: [DoubleDouble; 3] = std::array::from_fn(|i| {
            let scale = self.scale[i];
            let t: [DoubleDouble; 3] =
                std::array::from_fn(|j| d[j].times(DoubleDouble(f64::from(self.rows[i][j]), 0.0)));
            fine_error =
                fine_error.max(8.0 * STEP * scale * t.iter().map(|t| t.0.abs()).sum::<f64>());
            t[0].plus(t[1]).plus(t[2]).scaled(scale)
        });
        // The second double of each coordinate counts as error, too.
        let error =
            (fine.iter().fold(0.0f64, |m, c| m.max(c.1.abs())) + fine_error) * (1.0 + 4.0 * U);
        Point {
            at: fine.map(|c| c.0),
            error,
            fine: (fine, fine_error),
            place: PointForm::World(PointOrigin::Given(p)),
        }
    }

    /// Computes the rounded coordinates, in the frame, of a point given in doubles in world space.
    pub fn near(&self, p: DVec3) -> DVec3 {
        let d = p - self.origin;
        DVec3::from(std::array::from_fn(|i| {
            let [x, y, z] = self.rows[i].map(f64::from);
            (x * d.x + y * d.y + z * d.z) * self.scale[i]
        }))
    }

    /// Maps a point, given by homogeneous integers in world space, to the frame.
    pub fn exact(&self, p: [IBig; 4]) -> Point {
        let mut local = self.map(&p);
        primitive(&mut local);
        let fine: [DoubleDouble; 3] =
            std::array::from_fn(|i| ratio_double_double(&local[i], &local[3]));
        let at = fine.map(|c| c.0);
        let greatest = at.iter().fold(0.0f64, |m, c| m.max(c.abs()));
        Point {
            at,
            error: 4.0 * U * greatest,
            fine: (fine, 8.0 * STEP * greatest),
            place: PointForm::World(PointOrigin::Exact(Box::new(p))),
        }
    }

    /// Computes the exact homogeneous coordinates, in the frame, of a point in world space.
    pub fn integers(&self, p: &PointOrigin) -> [IBig; 4] {
        match p {
            PointOrigin::Given(p) => self.map(&homogeneous(p.to_array())),
            PointOrigin::Exact(p) => self.map(p),
        }
    }

    /// Maps a Plücker vector from the world to the frame, up to a positive factor.
    ///
    /// The formulas are d' = M·d and m' = cof(M)·(m − c × d).
    pub fn line_from_world(&self, line: &[IBig; 6]) -> [IBig; 6] {
        let (c, (low, up)) = self.centre();
        let (d, m) = halves(line);
        let moment = cross(&c, &d);
        let moment = std::array::from_fn(|i| (&m[i] << low) - (&moment[i] << up));
        // M = 2^least · N with an integer matrix N. Then d' has one factor 2^least and m' two.
        let (n, (down, rise)) = self.matrix();
        let d = times(&n, &d).map(|x| x << (low + down));
        let m = times(&cofactors(&n), &moment).map(|x| x << rise);
        joined(d, m)
    }

    /// Maps a Plücker vector from the frame to the world, up to a positive factor.
    ///
    /// The formulas are det(M)·d = cof(M)ᵀ·d' and det(M)·m = Mᵀ·m' + c × det(M)·d.
    pub fn line_to_world(&self, line: &[IBig; 6]) -> [IBig; 6] {
        let (c, (low, up)) = self.centre();
        let (n, (down, rise)) = self.matrix();
        let (d, m) = halves(line);
        // With N in place of M, d' counts for two factors 2^least and m' for one.
        let d = times(&transposed(cofactors(&n)), &d).map(|x| x << rise);
        let m = times(&transposed(n), &m).map(|x| x << down);
        let moment = cross(&c, &d);
        let m = std::array::from_fn(|i| (&m[i] << low) + (&moment[i] << up));
        joined(d.map(|x| x << low), m)
    }

    /// Returns the origin as an integer vector c: the origin is c · 2^up / 2^low.
    fn centre(&self) -> ([IBig; 3], (usize, usize)) {
        let (c, e) = integers(self.origin.to_array());
        (c, ((-e).max(0) as usize, e.max(0) as usize))
    }

    /// Returns the matrix as an integer matrix N: M = N · 2^rise / 2^down.
    fn matrix(&self) -> ([[IBig; 3]; 3], (usize, usize)) {
        let least = self.shift.iter().copied().min().unwrap_or(0) - 6;
        let n = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                IBig::from(self.rows[i][j]) << (self.shift[i] - 6 - least) as usize
            })
        });
        (n, ((-least).max(0) as usize, least.max(0) as usize))
    }

    fn map(&self, p: &[IBig; 4]) -> [IBig; 4] {
        let (origin, e) = integers(self.origin.to_array());
        // All values are multiplied by 2^low, so that the origin becomes an integer.
        let low = (-e).max(0) as usize;
        let up = e.max(0) as usize;
        let d: [IBig; 3] = std::array::from_fn(|j| (&p[j] << low) - ((&p[3] * &origin[j]) << up));
        let least = self.shift.iter().copied().min().unwrap_or(0) - 6;
        let [x, y, z] = std::array::from_fn(|i| {
            let sum: IBig = (0..3).map(|j| &d[j] * self.rows[i][j]).sum();
            sum << (self.shift[i] - 6 - least) as usize
        });
        let w = &p[3] << low;
        if least < 0 {
            [x, y, z, w << (-least) as usize]
        } else {
            [
                x << least as usize,
                y << least as usize,
                z << least as usize,
                w,
            ]
        }
    }
}

/// Splits a Plücker vector into its direction and its moment.
fn halves([a, b, c, d, e, f]: &[IBig; 6]) -> ([IBig; 3], [IBig; 3]) {
    let three = |x: [&IBig; 3]| x.map(Clone::clone);
    (three([a, b, c]), three([d, e, f]))
}

fn joined([a, b, c]: [IBig; 3], [d, e, f]: [IBig; 3]) -> [IBig; 6] {
    [a, b, c, d, e, f]
}

fn cross(a: &[IBig; 3], b: &[IBig; 3]) -> [IBig; 3] {
    std::array::from_fn(|i| &a[(i + 1) % 3] * &b[(i + 2) % 3] - &a[(i + 2) % 3] * &b[(i + 1) % 3])
}

fn times(m: &[[IBig; 3]; 3], x: &[IBig; 3]) -> [IBig; 3] {
    std::array::from_fn(|i| (0..3).map(|j| &m[i][j] * &x[j]).sum())
}

fn transposed(m: [[IBig; 3]; 3]) -> [[IBig; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i].clone()))
}

/// Returns the matrix whose rows are the cross products of the rows of `m`.
fn cofactors(m: &[[IBig; 3]; 3]) -> [[IBig; 3]; 3] {
    std::array::from_fn(|i| cross(&m[(i + 1) % 3], &m[(i + 2) % 3]))
}

/// Returns the smallest k with x ≤ 2^k, for normal x > 0.
///
/// The function reads the bits of `x`, because logarithms round differently on different machines.
fn above(x: f64) -> i32 {
    let (exponent, fraction) = ((x.to_bits() >> 52) as i32 - 1023, x.to_bits() << 12);
    exponent + i32::from(fraction != 0)
}

fn determinant(m: &[[i32; 3]; 3]) -> i64 {
    let m = m.map(|r| r.map(i64::from));
    (0..3)
        .map(|i| {
            m[0][i]
                * (m[1][(i + 1) % 3] * m[2][(i + 2) % 3] - m[1][(i + 2) % 3] * m[2][(i + 1) % 3])
        })
        .sum()
}

/// Converts a homogeneous point to doubles. The relative error of each coordinate is at most 3u unless the
/// coordinate underflows to 0.
pub fn point_doubles(p: &[IBig; 4]) -> [f64; 3] {
    std::array::from_fn(|i| sightline_numbers::integer::ratio(&p[i], &p[3]))
}

/// Computes n / d for d > 0, with a relative error of at most 4 times [`STEP`].
fn ratio_double_double(n: &IBig, d: &IBig) -> DoubleDouble {
    use dashu_int::ops::BitTest;
    if n.is_zero() {
        return DoubleDouble::default();
    }
    // The quotient has at least 160 bits, far more than the result keeps, and stays below 2^1000.
    let up = (160 + d.bit_len()).saturating_sub(n.bit_len());
    let down = n.bit_len().saturating_sub(d.bit_len() + 160);
    let q: IBig = ((n << up) / d) >> down;
    double_double(&q)
        .scaled(f64::powi(2.0, -(up as i32) / 2))
        .scaled(f64::powi(2.0, -(up as i32) + up as i32 / 2 + down as i32))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn near() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0f32..1.0).prop_map(|a| DVec3::from(a.map(f64::from)))
    }

    #[test]
    fn above_of_power_of_two_is_its_exponent() {
        for k in -300..300 {
            let x = f64::powi(2.0, k);
            assert_eq!(
                [above(x), above(x * 1.5), above(x * (1.0 + f64::EPSILON))],
                [k, k + 1, k + 1]
            );
        }
    }

    proptest! {
        #[test]
        fn rounded_points_stay_within_error_bound(
            a in prop::collection::vec(near(), 3), b in prop::collection::vec(near(), 4),
            far in near(), scale in -40i32..40, away in -20i32..20,
        ) {
            let s = f64::powi(2.0, scale);
            let t = far * f64::powi(2.0, away);
            let place = |p: &DVec3| ((*p + t) * s).as_vec3().as_dvec3();
            let (a, b): (Vec<_>, Vec<_>) = (a.iter().map(place).collect(), b.iter().map(place).collect());
            let frame = Frame::around(&a, &b);
            for p in a.iter().chain(&b) {
                let point = frame.given(*p);
                let exact = point_doubles(&frame.integers(&PointOrigin::Given(*p)));
                for (x, e) in point.at.iter().zip(exact) {
                    prop_assert!((x - e).abs() <= point.error + 4.0 * U * e.abs(), "{x} {e} {}", point.error);
                    prop_assert!(e.abs() <= 1.5, "{e}");
                }
                let again = frame.exact(homogeneous(p.to_array()));
                for (x, e) in again.at.iter().zip(exact) {
                    prop_assert!((x - e).abs() <= again.error);
                }
                for ((x, y), e) in again.fine.0.iter().zip(point.fine.0).zip(exact) {
                    prop_assert!(x.minus(y).0.abs() <= again.fine.1 + point.fine.1, "{x:?} {y:?} {e}");
                }
            }
        }

        #[test]
        fn lines_survive_round_trip_through_world(
            a in prop::collection::vec(near(), 3), b in prop::collection::vec(near(), 4),
            line in prop::array::uniform6(-1000i64..1000),
            scale in -40i32..40,
            far in near(),
            away in -20i32..20,
        ) {
            let t = far * f64::powi(2.0, away);
            let place = |p: &DVec3| ((*p + t) * f64::powi(2.0, scale)).as_vec3().as_dvec3();
            let (a, b): (Vec<_>, Vec<_>) = (a.iter().map(place).collect(), b.iter().map(place).collect());
            let frame = Frame::around(&a, &b);
            let mut line = line.map(IBig::from);
            let mut again = frame.line_from_world(&frame.line_to_world(&line));
            primitive(&mut line);
            primitive(&mut again);
            prop_assert_eq!(line, again);
        }

        #[test]
        fn lines_map_like_their_points(
            a in prop::collection::vec(near(), 3), b in prop::collection::vec(near(), 4),
            scale in -40i32..40, far in near(), away in -20i32..20,
        ) {
            let t = far * f64::powi(2.0, away);
            let place = |p: &DVec3| ((*p + t) * f64::powi(2.0, scale)).as_vec3().as_dvec3();
            let (a, b): (Vec<_>, Vec<_>) = (a.iter().map(place).collect(), b.iter().map(place).collect());
            prop_assume!(a[0] != b[0]);
            let frame = Frame::around(&a, &b);
            let join = |[p, q]: [[IBig; 4]; 2]| -> [IBig; 6] {
                let d = |i: usize| &q[i] * &p[3] - &p[i] * &q[3];
                let m = |i: usize, j: usize| &p[i] * &q[j] - &p[j] * &q[i];
                let mut line = [d(0), d(1), d(2), m(1, 2), m(2, 0), m(0, 1)];
                primitive(&mut line);
                line
            };
            let ends = [a[0], b[0]];
            let world = join(ends.map(|p| homogeneous(p.to_array())));
            let local = join(ends.map(|p| frame.integers(&PointOrigin::Given(p))));
            let mut there = frame.line_from_world(&world);
            primitive(&mut there);
            prop_assert_eq!(there, local);
        }
    }
}
