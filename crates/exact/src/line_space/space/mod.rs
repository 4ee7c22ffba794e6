//! Lines and rays of Plücker space: rounded with a bound, exact on demand, and the signs of their Klein
//! forms.
//!
//! A line through p and q has the coordinates (q − p, p × q). The Klein form `d·m' + m·d'` of two lines says
//! on which side one passes the other; it is 0 when the two meet (Nirenstein 2003, section 3.1.5). Extreme
//! rays of a region are six-vectors too, though most of them are not real lines. Every vector is constructed
//! from others, and its exact components are computed once, when a filter fails.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::UnsignedAbs as _;
use glam::DVec3;
use rustc_hash::FxHashMap;
use sightline_geometry::rounding::UNIT as U;

mod cross;
mod rounded;
mod small;
mod solved;
#[cfg(test)]
mod tests;
mod zeros;

use crate::arithmetic::double_double::{DoubleDouble, STEP};
use crate::arithmetic::number::{integers, primitive, rounded_double_double};
use crate::geometry::frame::{Frame, Place, Point, Source};

/// A vector of a [`Space`], by its index there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VectorId(u32);

impl VectorId {
    const fn index(self) -> usize {
        self.0 as usize
    }
}

/// A set of half-spaces of a region, one bit each.
pub type Tight = u128;

/// The construction of a vector.
#[derive(Clone, Debug)]
enum Origin {
    /// The line from one point of the space to another.
    Join(u32, u32),
    /// The line in which two planes meet, along n × n'.
    Meet(Box<[Through; 2]>),
    /// The negative of another vector.
    Opposite(VectorId),
    /// Exactly these doubles, in the frame.
    Given(Box<[f64; 6]>),
    /// Integers, kept with the vector.
    Fixed,
    /// Where the edge between two rays meets a half-space's border: s(a)·b − s(b)·a with s(a) > 0 > s(b).
    Cut {
        a: VectorId,
        b: VectorId,
        half: VectorId,
    },
}

/// The plane through three points of a space. Its normal points to the side from which the points appear
/// counter-clockwise.
#[derive(Clone, Copy, Debug)]
pub struct Through {
    /// The points.
    pub points: [u32; 3],
    /// Whether the normal is reversed.
    pub turned: bool,
}

/// A six-vector up to a positive factor, rounded, with all data of a filter in one cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Near {
    /// The components, the greatest at most 1.
    x: [f64; 6],
    /// How far every component may be off the true vector, suitably scaled.
    error: f64,
    /// Sum of the magnitudes of `x`.
    sum: f64,
}

/// The other data of a six-vector.
#[derive(Clone, Debug)]
struct Vector {
    /// The remainder of the rounded components: with it, they are off by at most `fine`.
    rest: [f64; 6],
    /// The greatest error of a component with its remainder.
    fine: f64,
    /// Whether `rest` and `fine` were computed; for cuts, only after a filter failed.
    refined: bool,
    origin: Origin,
    exact: Option<Box<[IBig; 6]>>,
    /// Row in the table of meeting lines; none if it is not known to be a real line.
    line: Option<u32>,
}

/// Whether two lines meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meeting {
    NotAsked,
    Apart,
    Meets,
}

/// How often each stage decided a sign.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Decisions {
    /// By doubles with an error bound.
    pub filtered: u64,
    /// By double-doubles with an error bound.
    pub refined: u64,
    /// Because the line is a combination of lines the ray is known to be on.
    pub spanned: u64,
    /// By exact integers.
    pub exact: u64,
    /// Of the exact ones, those that were 0.
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

/// All points and vectors of one query, and its frame.
pub struct Space {
    frame: Frame,
    points: Vec<Point>,
    point_integers: Vec<Option<Box<[IBig; 4]>>>,
    vectors: Vec<Vector>,
    /// The vectors, rounded.
    near: Vec<Near>,
    /// Which lines meet, as far as tested: a row for each line, with an entry for each line before it.
    meeting: Vec<Vec<Meeting>>,
    /// The number of entries of these rows.
    asked: usize,
    /// Which triples of meeting lines belong to one pencil, as far as tested.
    pencils: FxHashMap<[VectorId; 3], bool>,
    /// Signs that integers decided; kept since regions share rays.
    decided: FxHashMap<[VectorId; 2], Ordering>,
    /// How signs were decided.
    pub decisions: Decisions,
}

/// The Klein form of two six-vectors, rounded.
pub fn klein(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    (a[0] * b[3] + a[1] * b[4] + a[2] * b[5]) + (a[3] * b[0] + a[4] * b[1] + a[5] * b[2])
}

/// Σ weight · point / Σ weight, homogeneous.
pub fn mix(corners: [&[IBig; 4]; 3], weights: &[IBig; 3]) -> [IBig; 4] {
    let [a, b, c] = corners;
    let factors = [
        &b[3] * &c[3] * &weights[0],
        &a[3] * &c[3] * &weights[1],
        &a[3] * &b[3] * &weights[2],
    ];
    std::array::from_fn(|k| &a[k] * &factors[0] + &b[k] * &factors[1] + &c[k] * &factors[2])
}

/// The Klein form of two six-vectors, exactly.
pub fn klein_exact(a: &[IBig; 6], b: &[IBig; 6]) -> IBig {
    (0..6).map(|i| &a[i] * &b[(i + 3) % 6]).sum()
}

/// Initial capacity for vectors; most pairs need no more.
const FEW: usize = 256;

impl Space {
    /// An empty space.
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

    /// The frame.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// A measure of the memory used: the number of points and vectors, plus the tables about them in units of
    /// a vector's memory.
    pub fn size(&self) -> usize {
        self.points.len()
            + self.vectors.len()
            + self.asked / 256
            + (self.pencils.len() + self.decided.len()) / 8
    }

    /// Adds a point.
    pub fn point(&mut self, p: Point) -> u32 {
        self.points.push(p);
        self.point_integers.push(None);
        (self.points.len() - 1) as u32
    }

    /// Adds Σ weight · point / Σ weight, the weights positive and `shares` their shares in the sum, rounded.
    pub fn mixed(&mut self, of: [u32; 3], weights: [IBig; 3], shares: [f64; 3]) -> u32 {
        let [a, b, c] = of.map(|i| &self.points[i as usize]);
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
            place: Place::Mix(of, Box::new(weights)),
        })
    }

    /// A point, rounded.
    pub fn point_at(&self, p: u32) -> &Point {
        &self.points[p as usize]
    }

    /// A point's exact homogeneous coordinates in the frame.
    pub fn point_exact(&mut self, p: u32) -> &[IBig; 4] {
        let p = p as usize;
        if self.point_integers[p].is_none() {
            let mut x = match self.points[p].place.clone() {
                Place::World(source) => self.frame.integers(&source),
                Place::Mix(of, weights) => {
                    let corners = of.map(|i| self.point_exact(i).clone());
                    mix([&corners[0], &corners[1], &corners[2]], &weights)
                }
            };
            primitive(&mut x);
            self.point_integers[p] = Some(Box::new(x));
        }
        match &self.point_integers[p] {
            Some(x) => x,
            None => unreachable!("it was just computed"),
        }
    }

    /// The directed line from one point to another, which must differ.
    ///
    /// With e the points' errors and n the greatest magnitude of a coordinate, the direction is off by at
    /// most e + e' and a step of n + n', a component of the moment by 2(ne' + n'e + ee') and three steps of
    /// 2nn'.
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

    /// The line along n × n' in which two planes meet.
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

    /// A plane (n, k), n·x = k, and how far the components of n, and k, may be off.
    fn plane(&self, of: Through) -> ([DoubleDouble; 3], DoubleDouble, f64, f64) {
        let [a, b, c] = of.points.map(|p| &self.points[p as usize]);
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
        if of.turned {
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

    /// The negative of a vector.
    pub fn opposite(&mut self, v: VectorId) -> VectorId {
        let x = self.fine(v).map(|c| DoubleDouble(-c.0, -c.1));
        self.push(x, self.vectors[v.index()].fine, Origin::Opposite(v))
    }

    /// The vector with these components, which are not all 0.
    pub fn fixed(&mut self, mut x: [IBig; 6]) -> VectorId {
        primitive(&mut x);
        let id = self.push(rounded_double_double(&x), STEP, Origin::Fixed);
        self.vectors[id.index()].exact = Some(Box::new(x));
        id
    }

    /// The vector with exactly these components.
    pub fn given(&mut self, x: [f64; 6]) -> VectorId {
        self.push(
            x.map(|c| DoubleDouble(c, 0.0)),
            0.0,
            Origin::Given(Box::new(x)),
        )
    }

    /// The sign of the Klein form of two vectors.
    pub fn side(&mut self, a: VectorId, b: VectorId) -> Ordering {
        if let Some(sign) = self.filtered_side(a, b) {
            self.decisions.filtered += 1;
            return sign;
        }
        self.unfiltered_side(a, b)
    }

    /// The sign by integers. The integers also improve the doubles of later filters.
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
            unreachable!("both were just computed")
        };
        let value = klein_exact(x, y);
        self.decisions.exact += 1;
        let sign = crate::geometry::predicates::sign(&value);
        self.decisions.zero += u64::from(sign == Ordering::Equal);
        self.decided.insert(key, sign);
        sign
    }

    /// The exact components as integers; those of a line have no common factor.
    pub fn exact(&mut self, v: VectorId) -> &[IBig; 6] {
        self.sharpen(v);
        match &self.vectors[v.index()].exact {
            Some(x) => x,
            None => unreachable!("it was just computed"),
        }
    }

    /// Computes the exact components of a vector and of all vectors it is constructed from.
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

    /// The exact vector of `origin`, whose parts are exact already.
    fn compute(&mut self, origin: &Origin) -> [IBig; 6] {
        let part = |space: &Self, v: VectorId| match &space.vectors[v.index()].exact {
            Some(x) => x.clone(),
            None => unreachable!("parts are computed first"),
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
                let [a, b] = planes.map(|of| {
                    let p = of.points.map(|p| self.point_exact(p).clone());
                    let plane = crate::geometry::predicates::plane([&p[0], &p[1], &p[2]]);
                    if of.turned { plane.map(|c| -c) } else { plane }
                });
                let d = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
                let m = |i: usize| &b[3] * &a[i] - &a[3] * &b[i];
                [d(1, 2), d(2, 0), d(0, 1), m(0), m(1), m(2)]
            }
            Origin::Opposite(v) => part(self, *v).map(|c| -c),
            Origin::Given(x) => integers(**x).0,
            Origin::Fixed => unreachable!("it came with its integers"),
            Origin::Cut { a, b, half } => {
                let (x, y, h) = (part(self, *a), part(self, *b), part(self, *half));
                let (s, t) = (klein_exact(&x, &h), klein_exact(&y, &h));
                // The two have different signs for either orientation of the half-space.
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

    /// A number that is equal or differs by 1 for vectors of the same line, in either direction: the
    /// magnitude of the unit vector's component along a fixed direction. A line's vector is off by far less
    /// than a step, except for extremely short edges. Equal lines that are not recognised only cost exact
    /// arithmetic later.
    pub fn fingerprint(&self, line: VectorId) -> i64 {
        const ALONG: [f64; 6] = [0.419, 0.337, 0.521, 0.263, 0.472, 0.381];
        const STEPS: f64 = (1u64 << 24) as f64;
        let x = &self.near[line.index()].x;
        let length = x.iter().map(|c| c * c).sum::<f64>().sqrt();
        let at = x.iter().zip(ALONG).map(|(c, a)| c * a).sum::<f64>() / length;
        (at.abs() * STEPS) as i64
    }

    /// Whether two lines are the same line, in either direction; `Some(true)` when they have the same
    /// direction.
    pub fn same_line(&mut self, a: VectorId, b: VectorId) -> Option<bool> {
        let (v, w) = (&self.near[a.index()], &self.near[b.index()]);
        // Compared after scaling by the component that is greatest in the first.
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
        // Vectors without a common factor: equal or opposite.
        if x == *y {
            Some(true)
        } else if x.iter().zip(y).all(|(c, d)| *c == -d) {
            Some(false)
        } else {
            None
        }
    }

    /// The orientation of four points, where doubles can tell.
    pub fn filtered_orient(&mut self, a: u32, b: u32, c: u32, d: u32) -> Option<Ordering> {
        let p = [a, b, c, d].map(|i| &self.points[i as usize]);
        let sign = crate::geometry::predicates::orient_points(p);
        self.decisions.filtered += u64::from(sign.is_some());
        sign
    }

    /// The orientation of four points, computed in world space: the frame keeps orientations.
    fn orient_world(&self, p: [u32; 4]) -> Option<Ordering> {
        self.world(p)
            .and_then(crate::geometry::predicates::orient_small)
    }

    /// World positions of points, if all were given in doubles.
    fn world<const N: usize>(&self, of: [u32; N]) -> Option<[DVec3; N]> {
        let mut at = [DVec3::ZERO; N];
        for (at, p) in at.iter_mut().zip(of) {
            let Place::World(Source::Given(x)) = &self.points[p as usize].place else {
                return None;
            };
            *at = *x;
        }
        Some(at)
    }

    /// The orientation of four points, the sign of (b − a) × (c − a) · (d − a).
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
