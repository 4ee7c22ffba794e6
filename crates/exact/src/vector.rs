//! Lines and rays of Plücker space, rounded with a bound and exact on demand, and the decisions made with them.
//!
//! A line through p and q has the coordinates (q − p, p × q); for another line the Klein form
//! `d·m' + m·d'` says on which side it passes, and 0 that the two meet (thesis §3.5). Rays of a region are such
//! six-vectors too, though most are no real lines. Every vector is made from others in a known way and is computed
//! exactly only when a filter fails: then once.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::UnsignedAbs as _;

use crate::frame::{Frame, Place, Point};
use crate::number::{U, integers, normalised, primitive, rounded};

/// Index of a vector in its [`Space`].
pub type Id = u32;

/// How a vector is made.
#[derive(Clone, Debug)]
enum Origin {
    /// The line from one point of the space to another.
    Join(u32, u32),
    /// The line in which two planes meet, along n × n'. Planes are (n, k) with n·x = k, in integers in the frame.
    Meet(Box<([IBig; 4], [IBig; 4])>),
    /// These very doubles, in the frame.
    Given([f64; 6]),
    /// Integers, kept with the vector.
    Fixed,
    /// Where the edge between two rays meets a half-space's border: s(a)·b − s(b)·a with s(a) > 0 > s(b).
    Cut { a: Id, b: Id, half: Id },
}

/// A six-vector up to a positive factor.
#[derive(Clone, Debug)]
struct Vector {
    /// Rounded, its greatest component at most 1.
    x: [f64; 6],
    /// How far every component may be off the true vector, suitably scaled.
    error: f64,
    /// Sum of the magnitudes of `x`.
    sum: f64,
    origin: Origin,
    exact: Option<Box<[IBig; 6]>>,
}

/// How often each stage decided a sign.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Decisions {
    /// By doubles with an error bound.
    pub filtered: u64,
    /// By exact integers.
    pub exact: u64,
    /// Of the exact ones, those that were 0.
    pub zero: u64,
}

impl std::ops::AddAssign for Decisions {
    fn add_assign(&mut self, o: Self) {
        self.filtered += o.filtered;
        self.exact += o.exact;
        self.zero += o.zero;
    }
}

/// Rays with a greater error are computed exactly at once.
const COARSE: f64 = 1e-9;

/// All points and vectors of one query, and its frame.
pub struct Space {
    frame: Frame,
    points: Vec<Point>,
    point_integers: Vec<Option<Box<[IBig; 4]>>>,
    vectors: Vec<Vector>,
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
    let factors = [&b[3] * &c[3] * &weights[0], &a[3] * &c[3] * &weights[1], &a[3] * &b[3] * &weights[2]];
    std::array::from_fn(|k| &a[k] * &factors[0] + &b[k] * &factors[1] + &c[k] * &factors[2])
}

/// The Klein form of two six-vectors, exactly.
pub fn klein_exact(a: &[IBig; 6], b: &[IBig; 6]) -> IBig {
    (0..6).map(|i| &a[i] * &b[(i + 3) % 6]).sum()
}

impl Space {
    /// An empty space.
    pub fn new(frame: Frame) -> Self {
        Self {
            frame,
            points: Vec::new(),
            point_integers: Vec::new(),
            vectors: Vec::new(),
            decisions: Decisions::default(),
        }
    }

    /// The frame.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Numbers of points and of vectors so far: a measure of the memory used.
    pub fn size(&self) -> [usize; 2] {
        [self.points.len(), self.vectors.len()]
    }

    /// Forgets everything made since [`Space::size`] was this.
    pub fn truncate(&mut self, [points, vectors]: [usize; 2]) {
        self.points.truncate(points);
        self.point_integers.truncate(points);
        self.vectors.truncate(vectors);
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
        let size = [a, b, c].iter().flat_map(|p| p.at).fold(0.0f64, |m, x| m.max(x.abs()));
        let at = std::array::from_fn(|k| shares[0] * a.at[k] + shares[1] * b.at[k] + shares[2] * c.at[k]);
        let error = a.error.max(b.error).max(c.error) + 16.0 * U * size;
        self.point(Point { at, error, place: Place::Mix(of, Box::new(weights)) })
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
    /// With e the points' errors and n the greatest magnitude of a coordinate, the direction is off by at most
    /// e + e' + u|q − p|, a component of the moment by 2(ne' + n'e + ee') + 3u·2nn'; 8u covers computing that.
    pub fn join(&mut self, p: u32, q: u32) -> Id {
        let (a, b) = (&self.points[p as usize], &self.points[q as usize]);
        let (x, y) = (a.at, b.at);
        let m = |i: usize, j: usize| x[i] * y[j] - x[j] * y[i];
        let line = [y[0] - x[0], y[1] - x[1], y[2] - x[2], m(1, 2), m(2, 0), m(0, 1)];
        let size = |v: [f64; 3]| v.iter().fold(0.0f64, |m, c| m.max(c.abs()));
        let (n, k) = (size(x), size(y));
        let direction = a.error + b.error + 2.0 * U * (n + k);
        let moment = 2.0 * (n * b.error + k * a.error + a.error * b.error) + 8.0 * U * n * k;
        let error = direction.max(moment) * (1.0 + 8.0 * U);
        self.push(line, error, Origin::Join(p, q))
    }

    /// The line along n × n' in which two planes (n, k) meet, given in integers in the frame.
    pub fn meet(&mut self, a: [IBig; 4], b: [IBig; 4]) -> Id {
        let origin = Origin::Meet(Box::new((a, b)));
        let exact = self.compute(&origin);
        let x = rounded(&exact);
        let id = self.push(x, 2.0 * U, origin);
        self.vectors[id as usize].exact = Some(Box::new(exact));
        id
    }

    /// The vector with these components, which are not all 0.
    pub fn fixed(&mut self, mut x: [IBig; 6]) -> Id {
        primitive(&mut x);
        let id = self.push(rounded(&x), 2.0 * U, Origin::Fixed);
        self.vectors[id as usize].exact = Some(Box::new(x));
        id
    }

    /// The vector with exactly these components.
    pub fn given(&mut self, x: [f64; 6]) -> Id {
        self.push(x, 0.0, Origin::Given(x))
    }

    fn push(&mut self, x: [f64; 6], error: f64, origin: Origin) -> Id {
        let (x, scale) = normalised(x);
        let sum = x.iter().map(|c| c.abs()).sum();
        self.vectors.push(Vector { x, error: error * scale, sum, origin, exact: None });
        (self.vectors.len() - 1) as Id
    }

    /// A vector's rounded components, the greatest at most 1.
    pub fn rounded(&self, v: Id) -> &[f64; 6] {
        &self.vectors[v as usize].x
    }

    /// How far the rounded components may be off.
    pub fn error(&self, v: Id) -> f64 {
        self.vectors[v as usize].error
    }

    /// The Klein form, rounded, and how far it may be off.
    ///
    /// Six products and five sums of magnitudes |aᵢbⱼ| whose total is at most the lesser of the two sums S (no
    /// component exceeds 1): 6u·S. The errors of the vectors add e·S' + e'·S + 6ee'.
    fn form(&self, a: Id, b: Id) -> (f64, f64) {
        let (v, w) = (&self.vectors[a as usize], &self.vectors[b as usize]);
        let bound =
            8.0 * U * v.sum.min(w.sum) + 1.01 * (v.error * w.sum + w.error * v.sum + 6.0 * v.error * w.error);
        (klein(&v.x, &w.x), bound)
    }

    /// The sign of the Klein form of two vectors.
    pub fn side(&mut self, a: Id, b: Id) -> Ordering {
        match self.filtered_side(a, b) {
            Some(sign) => {
                self.decisions.filtered += 1;
                sign
            }
            None => self.exact_side(a, b),
        }
    }

    /// The sign, where doubles can tell.
    pub fn filtered_side(&self, a: Id, b: Id) -> Option<Ordering> {
        let (value, bound) = self.form(a, b);
        (value.abs() > bound).then(|| if value > 0.0 { Ordering::Greater } else { Ordering::Less })
    }

    /// The sign by integers; what is computed for it makes later filters sharper.
    pub fn exact_side(&mut self, a: Id, b: Id) -> Ordering {
        self.sharpen(a);
        self.sharpen(b);
        let (x, y) = (&self.vectors[a as usize].exact, &self.vectors[b as usize].exact);
        let (Some(x), Some(y)) = (x, y) else { unreachable!("both were just computed") };
        let value = klein_exact(x, y);
        self.decisions.exact += 1;
        let sign = crate::predicates::sign(&value);
        self.decisions.zero += u64::from(sign == Ordering::Equal);
        sign
    }

    /// The exact components, an integer vector without a common factor.
    pub fn exact(&mut self, v: Id) -> &[IBig; 6] {
        self.sharpen(v);
        match &self.vectors[v as usize].exact {
            Some(x) => x,
            None => unreachable!("it was just computed"),
        }
    }

    /// Computes a vector exactly, and everything it is made from.
    fn sharpen(&mut self, v: Id) {
        // What a vector is made from was made before it, but chains can be long: no recursion.
        let mut open = vec![v];
        while let Some(id) = open.last().copied() {
            if self.vectors[id as usize].exact.is_some() {
                open.pop();
                continue;
            }
            if let Origin::Cut { a, b, half } = self.vectors[id as usize].origin {
                let missing = [a, b, half].into_iter().filter(|i| self.vectors[*i as usize].exact.is_none());
                let before = open.len();
                open.extend(missing);
                if open.len() > before {
                    continue;
                }
            }
            let origin = self.vectors[id as usize].origin.clone();
            let exact = self.compute(&origin);
            let vector = &mut self.vectors[id as usize];
            let x = rounded(&exact);
            if vector.error > 4.0 * U {
                (vector.x, vector.error) = (x, 2.0 * U);
                vector.sum = x.iter().map(|c| c.abs()).sum();
            }
            vector.exact = Some(Box::new(exact));
            open.pop();
        }
    }

    /// What `origin` says, its parts being there exactly.
    fn compute(&mut self, origin: &Origin) -> [IBig; 6] {
        let part = |space: &Self, v: Id| match &space.vectors[v as usize].exact {
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
                let (a, b) = &**planes;
                let d = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
                let m = |i: usize| &b[3] * &a[i] - &a[3] * &b[i];
                [d(1, 2), d(2, 0), d(0, 1), m(0), m(1), m(2)]
            }
            Origin::Given(x) => integers(*x).0,
            Origin::Fixed => unreachable!("it came with its integers"),
            Origin::Cut { a, b, half } => {
                let (x, y, h) = (part(self, *a), part(self, *b), part(self, *half));
                let (s, t) = (klein_exact(&x, &h), klein_exact(&y, &h));
                // Whichever way the half-space is turned, the two have different signs.
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

    /// The ray where the edge between `a` and `b`, on different sides of `half`, meets its border.
    ///
    /// x = αb + (1 − α)a with α = s/(s + |t|). With B the bounds of the forms s and t, α is off by at most
    /// max(B)/(s + |t| − 2 max(B)), the ray by that times |b − a| ≤ 2, besides the errors of its parents.
    pub fn cut(&mut self, a: Id, b: Id, half: Id) -> Id {
        let ((s, es), (t, et)) = (self.form(a, half), self.form(b, half));
        let (v, w) = (&self.vectors[a as usize], &self.vectors[b as usize]);
        let (s, t) = (s.abs(), t.abs());
        let total = s + t;
        let alpha = s / total;
        let x: [f64; 6] = std::array::from_fn(|i| alpha * w.x[i] + (1.0 - alpha) * v.x[i]);
        let bound = es.max(et);
        let room = total - 2.0 * bound;
        let apart = (0..6).fold(0.0f64, |m, i| m.max((v.x[i] - w.x[i]).abs())) + v.error + w.error;
        let error = if room > 0.0 {
            v.error.max(w.error) + 1.01 * bound / room * apart + 8.0 * U
        } else {
            f64::INFINITY
        };
        // A ray that is mostly error is of no use to filters, nor to who looks for lines.
        let hopeless = !(error < COARSE);
        let id = self.push(x, if hopeless { f64::INFINITY } else { error }, Origin::Cut { a, b, half });
        if hopeless {
            self.sharpen(id);
        }
        id
    }

    /// Whether two lines are the same line, whichever way they run; `Some(true)` when they run the same way.
    pub fn same_line(&mut self, a: Id, b: Id) -> Option<bool> {
        let (v, w) = (&self.vectors[a as usize], &self.vectors[b as usize]);
        // Compared after scaling by the component that is greatest in the first.
        let k = (0..6).max_by(|i, j| v.x[*i].abs().total_cmp(&v.x[*j].abs())).unwrap_or(0);
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

    /// The orientation of four points, the sign of (b − a) × (c − a) · (d − a).
    pub fn orient(&mut self, a: u32, b: u32, c: u32, d: u32) -> Ordering {
        if let Some(sign) = crate::predicates::orient_points([
            &self.points[a as usize],
            &self.points[b as usize],
            &self.points[c as usize],
            &self.points[d as usize],
        ]) {
            self.decisions.filtered += 1;
            return sign;
        }
        let p = [a, b, c, d].map(|i| self.point_exact(i).clone());
        self.decisions.exact += 1;
        let sign = crate::predicates::orient_exact([&p[0], &p[1], &p[2], &p[3]]);
        self.decisions.zero += u64::from(sign == Ordering::Equal);
        sign
    }
}
