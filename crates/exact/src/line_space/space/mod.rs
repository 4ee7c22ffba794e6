//! Lines and rays of Plücker space: rounded with a bound, exact on demand, and the signs of their Klein
//! forms.
//!
//! A line through p and q has the coordinates (q − p, p × q). The sign of the Klein form `d·m' + m·d'` of two
//! lines is the side on which one passes the other; the form is 0 if the two meet (Nirenstein 2003, section
//! 3.1.5). Extreme rays of a region are six-vectors too, though most of them are not real lines. Every vector
//! is constructed from other vectors or points. The space computes and stores a vector's exact components
//! when a filter first fails.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::UnsignedAbs as _;
use glam::DVec3;
use rustc_hash::FxHashMap;
use sightline_geometry::rounding::UNIT as U;

mod cross;
mod rounded;
mod small;
mod solved_rays;
#[cfg(test)]
mod tests;
mod zeros;

use crate::arithmetic::double_double::{DoubleDouble, STEP};
use crate::arithmetic::number::{integers, primitive, rounded_double_double};
use crate::geometry::frame::{Frame, Point, PointForm, PointOrigin};

/// A vector of a [`Space`], identified by its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VectorId(u32);

impl VectorId {
    const fn index(self) -> usize {
        self.0 as usize
    }
}

/// A set of half-spaces of a region. Bit i stands for the half-space at index i of the region's list of
/// half-spaces.
pub type Tight = u128;

/// The construction of a vector.
#[derive(Clone, Debug)]
enum Origin {
    /// The line from one point of the space to another.
    Join(u32, u32),
    /// The line in which two planes meet, with the direction n × n' for the normals n and n'.
    Meet(Box<[Through; 2]>),
    /// The negative of another vector.
    Opposite(VectorId),
    /// The vector with exactly these components, in the frame.
    Given(Box<[f64; 6]>),
    /// A vector given by integer components, which the field `exact` of the vector contains from the start.
    Fixed,
    /// The intersection of the edge between two rays and a half-space's border.
    ///
    /// The vector is s(a)·b − s(b)·a. s is the Klein form with the half-space's line, with the sign for which
    /// s(a) > 0 > s(b).
    Cut {
        a: VectorId,
        b: VectorId,
        half: VectorId,
    },
}

/// The plane through three points of a space.
///
/// The plane's normal points to the side from which the points appear counter-clockwise.
#[derive(Clone, Copy, Debug)]
pub struct Through {
    /// The indices of the three points in the space.
    pub points: [u32; 3],
    /// True if the normal is reversed.
    pub turned: bool,
}

/// A rounded six-vector up to a positive factor, with all data of a filter in one cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct FilterVector {
    /// The components, the largest of which is at most 1 in magnitude.
    x: [f64; 6],
    /// A bound on the difference of a component from the true vector, suitably scaled.
    error: f64,
    /// The sum of the magnitudes of `x`.
    sum: f64,
}

/// The data of a six-vector that a filter does not need.
#[derive(Clone, Debug)]
struct Vector {
    /// The low-order part of each component: the rounded components plus `rest` differ from the true vector,
    /// suitably scaled, by at most `fine`.
    rest: [f64; 6],
    /// A bound on the error of a component after `rest` is added.
    fine: f64,
    /// True if `rest` and `fine` were computed. For cuts, this happens only after a filter failed.
    refined: bool,
    origin: Origin,
    exact: Option<Box<[IBig; 6]>>,
    /// The index of the vector's row in [`Space::meeting`]; `None` if the construction does not show that the
    /// vector is a real line.
    line: Option<u32>,
}

/// An entry of the table of tested pairs of lines: untested, apart, or meeting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meeting {
    NotAsked,
    Apart,
    Meets,
}

/// The number of signs that each stage decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Decisions {
    /// The number of signs decided by doubles with an error bound.
    pub filtered: u64,
    /// The number of signs decided by double-doubles with an error bound.
    pub refined: u64,
    /// The number of spanned signs, which are known to be 0.
    ///
    /// The sign of two vectors is spanned if one vector is a linear combination of lines that meet the other.
    pub spanned: u64,
    /// The number of signs decided by exact integers.
    pub exact: u64,
    /// The number of signs decided by exact integers that were 0.
    pub zero: u64,
}

impl std::ops::AddAssign for Decisions {
    fn add_assign(&mut self, o: Self) {
        self.filtered += o.filtered;
        self.refined += o.refined;
        self.spanned += o.spanned;
        self.exact += o.exact;
        self.zero += o.zero;
    }
}

/// All points and vectors of one query, and the frame of the query.
pub struct Space {
    frame: Frame,
    points: Vec<Point>,
    point_integers: Vec<Option<Box<[IBig; 4]>>>,
    vectors: Vec<Vector>,
    /// The rounded components of each vector, at the index of its [`VectorId`].
    near: Vec<FilterVector>,
    /// The tested pairs of lines: a row for each line. Entry j of row i is for the lines of row i and row j <
    /// i.
    meeting: Vec<Vec<Meeting>>,
    /// The total number of entries of all rows of `meeting`, for [`Space::size`].
    asked: usize,
    /// The tested triples of meeting lines: true if they belong to one pencil.
    pencils: FxHashMap<[VectorId; 3], bool>,
    /// The signs that integers decided, cached because regions share rays.
    decided: FxHashMap<[VectorId; 2], Ordering>,
    /// The number of signs that each stage decided.
    pub decisions: Decisions,
}

/// Computes the rounded Klein form of two six-vectors.
pub fn klein(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    (a[0] * b[3] + a[1] * b[4] + a[2] * b[5]) + (a[3] * b[0] + a[4] * b[1] + a[5] * b[2])
}

/// Computes Σ weight · point / Σ weight in homogeneous coordinates.
pub fn mix(corners: [&[IBig; 4]; 3], weights: &[IBig; 3]) -> [IBig; 4] {
    let [a, b, c] = corners;
    let factors = [
        &b[3] * &c[3] * &weights[0],
        &a[3] * &c[3] * &weights[1],
        &a[3] * &b[3] * &weights[2],
    ];
    std::array::from_fn(|k| &a[k] * &factors[0] + &b[k] * &factors[1] + &c[k] * &factors[2])
}

/// Computes the Klein form of two six-vectors exactly.
pub fn klein_exact(a: &[IBig; 6], b: &[IBig; 6]) -> IBig {
    (0..6).map(|i| &a[i] * &b[(i + 3) % 6]).sum()
}

/// The initial capacity for vectors; most pairs of polygons need no more.
const FEW: usize = 256;

impl Space {
    /// Creates a space without points and vectors, whose coordinates are in `frame`.
    pub fn new(frame: Frame) -> Self {
        Self {
            frame,
            points: Vec::with_capacity(64),
            point_integers: Vec::with_capacity(64),
            vectors: Vec::with_capacity(FEW),
            near: Vec::with_capacity(FEW),
            meeting: Vec::new(),
            asked: 0,
            pencils: FxHashMap::default(),
            decided: FxHashMap::default(),
            decisions: Decisions::default(),
        }
    }

    /// Returns the frame.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Estimates the memory that the space uses, in units of the memory of one vector.
    ///
    /// The estimate is the number of points and vectors, plus the scaled sizes of the tables.
    pub fn size(&self) -> usize {
        self.points.len()
            + self.vectors.len()
            + self.asked / 256
            + (self.pencils.len() + self.decided.len()) / 8
    }

    /// Adds a point and returns its index.
    pub fn point(&mut self, p: Point) -> u32 {
        self.points.push(p);
        self.point_integers.push(None);
        (self.points.len() - 1) as u32
    }

    /// Adds the point Σ weight · point / Σ weight and returns its index.
    ///
    /// The weights are positive. `shares` contains each weight divided by the sum of the weights, rounded.
    pub fn mixed(&mut self, points: [u32; 3], weights: [IBig; 3], shares: [f64; 3]) -> u32 {
        let [a, b, c] = points.map(|i| &self.points[i as usize]);
        let size = [a, b, c]
            .iter()
            .flat_map(|p| p.at)
            .fold(0.0f64, |m, x| m.max(x.abs()));
        let at = std::array::from_fn(|k| {
            shares[0] * a.at[k] + shares[1] * b.at[k] + shares[2] * c.at[k]
        });
        let error = a.error.max(b.error).max(c.error) + 16.0 * U * size;
        let fine = (at.map(|c| DoubleDouble(c, 0.0)), error);
        self.point(Point {
            at,
            error,
            fine,
            place: PointForm::Mix(points, Box::new(weights)),
        })
    }

    /// Returns a rounded point.
    pub fn point_at(&self, p: u32) -> &Point {
        &self.points[p as usize]
    }

    /// Returns a point's exact homogeneous coordinates in the frame.
    pub fn point_exact(&mut self, p: u32) -> &[IBig; 4] {
        let p = p as usize;
        if self.point_integers[p].is_none() {
            let mut x = match self.points[p].place.clone() {
                PointForm::World(source) => self.frame.integers(&source),
                PointForm::Mix(of, weights) => {
                    let corners = of.map(|i| self.point_exact(i).clone());
                    mix([&corners[0], &corners[1], &corners[2]], &weights)
                }
            };
            primitive(&mut x);
            self.point_integers[p] = Some(Box::new(x));
        }
        match &self.point_integers[p] {
            Some(x) => x,
            None => unreachable!("the exact coordinates were just computed"),
        }
    }

    /// Adds the directed line from one point to another, which must differ.
    ///
    /// Let e and e' bound the errors of the points, and n and n' the magnitudes of their coordinates. A
    /// component of the direction is off by at most e + e' plus [`STEP`] times n + n'. A component of the
    /// moment is off by at most 2(ne' + n'e + ee') plus three times [`STEP`] times 2nn'.
    pub fn join(&mut self, p: u32, q: u32) -> VectorId {
        let (a, b) = (&self.points[p as usize], &self.points[q as usize]);
        let ((x, e), (y, f)) = (a.fine, b.fine);
        let m = |i: usize, j: usize| x[i].times(y[j]).minus(x[j].times(y[i]));
        let d = |i: usize| y[i].minus(x[i]);
        let line = [d(0), d(1), d(2), m(1, 2), m(2, 0), m(0, 1)];
        let size = |v: [DoubleDouble; 3]| v.iter().fold(0.0f64, |m, c| m.max(c.0.abs()));
        let (n, k) = (size(x), size(y));
        let direction = e + f + 2.0 * STEP * (n + k);
        let moment = 2.0 * (n * f + k * e + e * f) + 8.0 * STEP * n * k;
        let error = direction.max(moment) * (1.0 + 8.0 * U);
        self.push(line, error, Origin::Join(p, q))
    }

    /// Adds the line in which two planes meet, with the direction n × n' for the normals n and n'.
    pub fn meet(&mut self, a: Through, b: Through) -> VectorId {
        let ((n, k, e, f), (m, l, g, h)) = (self.plane(a), self.plane(b));
        let size = |v: [DoubleDouble; 3]| v.iter().fold(0.0f64, |m, c| m.max(c.0.abs()));
        let (sn, sm) = (size(n), size(m));
        let d = |i: usize, j: usize| n[i].times(m[j]).minus(n[j].times(m[i]));
        let c = |i: usize| l.times(n[i]).minus(k.times(m[i]));
        let direction = 2.0 * (sn * g + sm * e + e * g) + 8.0 * STEP * sn * sm;
        let (ak, al) = (k.0.abs(), l.0.abs());
        let moment =
            al * e + sn * h + e * h + ak * g + sm * f + f * g + 4.0 * STEP * (al * sn + ak * sm);
        let line = [d(1, 2), d(2, 0), d(0, 1), c(0), c(1), c(2)];
        self.push(
            line,
            1.01 * direction.max(moment),
            Origin::Meet(Box::new([a, b])),
        )
    }

    /// Computes the plane n·x = k, and returns n, k and two error bounds.
    ///
    /// The first bound is for each component of n, and the second for k.
    fn plane(&self, through: Through) -> ([DoubleDouble; 3], DoubleDouble, f64, f64) {
        let [a, b, c] = through.points.map(|p| &self.points[p as usize]);
        let size = |v: [DoubleDouble; 3]| v.iter().fold(0.0f64, |m, c| m.max(c.0.abs()));
        let apart = |p: &Point| -> ([DoubleDouble; 3], f64, f64) {
            let d = std::array::from_fn(|i| p.fine.0[i].minus(a.fine.0[i]));
            (
                d,
                size(d),
                p.fine.1 + a.fine.1 + 2.0 * STEP * (size(p.fine.0) + size(a.fine.0)),
            )
        };
        let ((x, sx, ex), (y, sy, ey)) = (apart(b), apart(c));
        let n = |i: usize, j: usize| x[i].times(y[j]).minus(x[j].times(y[i]));
        let mut n = [n(1, 2), n(2, 0), n(0, 1)];
        if through.turned {
            n = n.map(|c| DoubleDouble(-c.0, -c.1));
        }
        let en = 2.0 * (sx * ey + sy * ex + ex * ey) + 8.0 * STEP * sx * sy;
        let p = a.fine.0;
        let k = n[0]
            .times(p[0])
            .plus(n[1].times(p[1]))
            .plus(n[2].times(p[2]));
        let (sn, sp) = (size(n), size(p));
        let ek = 3.0 * (sp * en + sn * a.fine.1 + en * a.fine.1) + 16.0 * STEP * sn * sp;
        (n, k, 1.01 * en, 1.01 * ek)
    }

    /// Adds the negative of a vector.
    pub fn opposite(&mut self, v: VectorId) -> VectorId {
        let x = self.fine(v).map(|c| DoubleDouble(-c.0, -c.1));
        self.push(x, self.vectors[v.index()].fine, Origin::Opposite(v))
    }

    /// Adds the vector with these integer components, which must not all be 0.
    pub fn fixed(&mut self, mut x: [IBig; 6]) -> VectorId {
        primitive(&mut x);
        let id = self.push(rounded_double_double(&x), STEP, Origin::Fixed);
        self.vectors[id.index()].exact = Some(Box::new(x));
        id
    }

    /// Adds the vector whose components are exactly these doubles.
    pub fn given(&mut self, x: [f64; 6]) -> VectorId {
        self.push(
            x.map(|c| DoubleDouble(c, 0.0)),
            0.0,
            Origin::Given(Box::new(x)),
        )
    }

    /// Computes the sign of the Klein form of two vectors.
    pub fn side(&mut self, a: VectorId, b: VectorId) -> Ordering {
        if let Some(sign) = self.filtered_side(a, b) {
            self.decisions.filtered += 1;
            return sign;
        }
        self.unfiltered_side(a, b)
    }

    /// Computes the sign of the Klein form of two vectors by integers. The integers also improve the stored
    /// doubles, which later filters use.
    pub fn exact_side(&mut self, a: VectorId, b: VectorId) -> Ordering {
        let key = [a.min(b), a.max(b)];
        if let Some(sign) = self.decided.get(&key) {
            return *sign;
        }
        self.sharpen(a);
        self.sharpen(b);
        let (x, y) = (
            &self.vectors[a.index()].exact,
            &self.vectors[b.index()].exact,
        );
        let (Some(x), Some(y)) = (x, y) else {
            unreachable!("the exact components of both vectors were just computed")
        };
        let value = klein_exact(x, y);
        self.decisions.exact += 1;
        let sign = crate::geometry::predicates::sign(&value);
        self.decisions.zero += u64::from(sign == Ordering::Equal);
        self.decided.insert(key, sign);
        sign
    }

    /// Returns the exact components of a vector, up to a positive factor, as integers. The components of a
    /// line have no common factor.
    pub fn exact(&mut self, v: VectorId) -> &[IBig; 6] {
        self.sharpen(v);
        match &self.vectors[v.index()].exact {
            Some(x) => x,
            None => unreachable!("the exact components were just computed"),
        }
    }

    /// Computes the exact components of a vector and of all vectors from which it is constructed.
    fn sharpen(&mut self, v: VectorId) {
        // Chains of constructions can be long, so there is no recursion.
        let mut open = vec![v];
        while let Some(id) = open.last().copied() {
            if self.vectors[id.index()].exact.is_some() {
                open.pop();
                continue;
            }
            let parts = match self.vectors[id.index()].origin {
                Origin::Cut { a, b, half } => [Some(a), Some(b), Some(half)],
                Origin::Opposite(v) => [Some(v), None, None],
                _ => [None; 3],
            };
            {
                let missing = parts
                    .into_iter()
                    .flatten()
                    .filter(|i| self.vectors[i.index()].exact.is_none());
                let before = open.len();
                open.extend(missing);
                if open.len() > before {
                    continue;
                }
            }
            let origin = self.vectors[id.index()].origin.clone();
            let exact = self.compute(&origin);
            self.improve(id, &exact);
            self.vectors[id.index()].exact = Some(Box::new(exact));
            open.pop();
        }
    }

    /// Computes the exact components of the vector that `origin` describes. The exact components of all
    /// vectors that `origin` names must be known.
    fn compute(&mut self, origin: &Origin) -> [IBig; 6] {
        let part = |space: &Self, v: VectorId| match &space.vectors[v.index()].exact {
            Some(x) => x.clone(),
            None => unreachable!("exact components of the parents are computed first"),
        };
        let mut out = match origin {
            Origin::Join(p, q) => {
                let p = self.point_exact(*p).clone();
                let q = self.point_exact(*q);
                let d = |i: usize| &p[3] * &q[i] - &q[3] * &p[i];
                let m = |i: usize, j: usize| &p[i] * &q[j] - &p[j] * &q[i];
                [d(0), d(1), d(2), m(1, 2), m(2, 0), m(0, 1)]
            }
            Origin::Meet(planes) => {
                let [a, b] = planes.map(|plane| {
                    let p = plane.points.map(|p| self.point_exact(p).clone());
                    let exact = crate::geometry::predicates::plane([&p[0], &p[1], &p[2]]);
                    if plane.turned {
                        exact.map(|c| -c)
                    } else {
                        exact
                    }
                });
                let d = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
                let m = |i: usize| &b[3] * &a[i] - &a[3] * &b[i];
                [d(1, 2), d(2, 0), d(0, 1), m(0), m(1), m(2)]
            }
            Origin::Opposite(v) => part(self, *v).map(|c| -c),
            Origin::Given(x) => integers(**x).0,
            Origin::Fixed => unreachable!("a fixed vector is stored with exact components"),
            Origin::Cut { a, b, half } => {
                let (x, y, h) = (part(self, *a), part(self, *b), part(self, *half));
                let (s, t) = (klein_exact(&x, &h), klein_exact(&y, &h));
                // s and t have different signs for either orientation of the half-space, so magnitudes
                // suffice.
                let (s, t) = (s.unsigned_abs(), t.unsigned_abs());
                {
                    let (s, t) = (IBig::from(s), IBig::from(t));
                    std::array::from_fn(|i| &y[i] * &s + &x[i] * &t)
                }
            }
        };
        primitive(&mut out);
        out
    }

    /// Computes a hash of a line. The hashes of two vectors of the same line, in either direction, differ by
    /// at most 1.
    ///
    /// The hash is the magnitude of the unit vector's component along a fixed direction, in units of 2⁻²⁴.
    /// The error of a line's vector is far below that unit, except for extremely short edges. If the caller
    /// does not recognise equal lines, the only cost is exact arithmetic later.
    pub fn fingerprint(&self, line: VectorId) -> i64 {
        const ALONG: [f64; 6] = [0.419, 0.337, 0.521, 0.263, 0.472, 0.381];
        const STEPS: f64 = (1u64 << 24) as f64;
        let x = &self.near[line.index()].x;
        let length = x.iter().map(|c| c * c).sum::<f64>().sqrt();
        let at = x.iter().zip(ALONG).map(|(c, a)| c * a).sum::<f64>() / length;
        (at.abs() * STEPS) as i64
    }

    /// Compares two lines: `Some(true)` means the same line, `Some(false)` the same line in the opposite
    /// direction.
    ///
    /// The result is `None` if the lines differ.
    pub fn same_line(&mut self, a: VectorId, b: VectorId) -> Option<bool> {
        let (v, w) = (&self.near[a.index()], &self.near[b.index()]);
        // The comparison scales both vectors by the component that is largest in the first vector.
        let k = (0..6)
            .max_by(|i, j| v.x[*i].abs().total_cmp(&v.x[*j].abs()))
            .unwrap_or(0);
        let (p, q) = (v.x[k], w.x[k]);
        let slack = 16.0 * (v.error + w.error + U);
        let apart = |i: usize| (v.x[i] * q - w.x[i] * p).abs() > slack;
        if (0..6).any(apart) {
            return None;
        }
        let x = self.exact(a).clone();
        let y = self.exact(b);
        // The vectors have no common factor, so equal lines have equal or opposite vectors.
        if x == *y {
            Some(true)
        } else if x.iter().zip(y).all(|(c, d)| *c == -d) {
            Some(false)
        } else {
            None
        }
    }

    /// Computes the orientation of four points, or returns `None` if doubles cannot decide it.
    pub fn filtered_orient(&mut self, a: u32, b: u32, c: u32, d: u32) -> Option<Ordering> {
        let p = [a, b, c, d].map(|i| &self.points[i as usize]);
        let sign = crate::geometry::predicates::orient_points(p);
        self.decisions.filtered += u64::from(sign.is_some());
        sign
    }

    /// Computes the orientation of four points in fixed-width integers from their world positions; the map to
    /// the frame does not change orientations. Returns `None` if a point was not given in doubles or the
    /// integers are too long.
    fn orient_world(&self, p: [u32; 4]) -> Option<Ordering> {
        self.world(p)
            .and_then(crate::geometry::predicates::orient_small)
    }

    /// Returns the world positions of points, or `None` if a point was not given in doubles.
    fn world<const N: usize>(&self, points: [u32; N]) -> Option<[DVec3; N]> {
        let mut at = [DVec3::ZERO; N];
        for (at, p) in at.iter_mut().zip(points) {
            let PointForm::World(PointOrigin::Given(x)) = &self.points[p as usize].place else {
                return None;
            };
            *at = *x;
        }
        Some(at)
    }

    /// Computes the orientation of four points: the sign of (b − a) × (c − a) · (d − a).
    pub fn orient(&mut self, a: u32, b: u32, c: u32, d: u32) -> Ordering {
        if let Some(sign) = crate::geometry::predicates::orient_points([
            &self.points[a as usize],
            &self.points[b as usize],
            &self.points[c as usize],
            &self.points[d as usize],
        ]) {
            self.decisions.filtered += 1;
            return sign;
        }
        self.decisions.exact += 1;
        let sign = self.orient_world([a, b, c, d]).unwrap_or_else(|| {
            let p = [a, b, c, d].map(|i| self.point_exact(i).clone());
            crate::geometry::predicates::orient_exact([&p[0], &p[1], &p[2], &p[3]])
        });
        self.decisions.zero += u64::from(sign == Ordering::Equal);
        sign
    }
}
