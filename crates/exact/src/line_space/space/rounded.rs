//! Six-vectors in doubles with bounds on their errors: the filter that decides nearly all signs.
//!
//! A cut is computed in doubles from the doubles of its parents. If the error along the chain of cuts is too
//! large, or a filter fails, the space solves the cut from the lines whose hyperplanes contain it
//! ([`super::solved_rays`]), in double-doubles if needed. If that fails, the space computes the cut in
//! double-doubles from its parents, after all vectors from which the parents are constructed.

use std::cmp::Ordering;

use sightline_geometry::rounding::UNIT as U;

use super::solved_rays::Solved;
use super::{FilterVector, Origin, Space, Vector, VectorId, klein};
use crate::arithmetic::double_double::{DoubleDouble, STEP};
use crate::arithmetic::number::{normalised, rounded_double_double};

/// The error above which [`Space::cut`] computes a new ray again with more precision.
///
/// The space solves such a ray from the lines whose hyperplanes contain it, or computes it in double-doubles.
/// If the error is still too large, the space computes the ray exactly. The search for lines in a region
/// needs rays with small errors. The threshold does not affect a sign: if a filter cannot determine a sign,
/// the space computes it with more precision.
const COARSE: f64 = 1e-9;

/// The error in double-doubles below which [`Space::refine_from`] replaces a ray's components by
/// double-doubles. With a larger error, callers compute the ray in integers.
const PRECISE: f64 = 1e-22;

impl Space {
    /// Adds a vector given in double-doubles. `fine` bounds the error of each component.
    pub(super) fn push(&mut self, x: [DoubleDouble; 6], fine: f64, origin: Origin) -> VectorId {
        let line = matches!(origin, Origin::Join(..) | Origin::Meet(..)).then(|| {
            self.meeting.push(Vec::new());
            (self.meeting.len() - 1) as u32
        });
        let id = VectorId(self.vectors.len() as u32);
        self.near.push(FilterVector {
            x: [0.0; 6],
            error: 0.0,
            sum: 0.0,
        });
        self.vectors.push(Vector {
            rest: [0.0; 6],
            fine: 0.0,
            refined: true,
            origin,
            exact: None,
            line,
        });
        self.set(id, x, fine);
        id
    }

    /// Replaces the components of a vector by double-doubles, scaled so that the largest rounded component is
    /// at most 1. `fine` bounds the error of each component before scaling.
    fn set(&mut self, v: VectorId, x: [DoubleDouble; 6], fine: f64) {
        let (high, scale) = normalised(x.map(|c| c.0));
        let rest = x.map(|c| c.1 * scale);
        let fine = fine * scale;
        let error = (fine + rest.iter().fold(0.0f64, |m, c| m.max(c.abs()))) * (1.0 + 4.0 * U);
        self.near[v.index()] = FilterVector {
            x: high,
            error,
            sum: high.iter().map(|c| c.abs()).sum(),
        };
        let vector = &mut self.vectors[v.index()];
        (vector.rest, vector.fine, vector.refined) = (rest, fine, true);
    }

    /// Replaces the doubles of a vector by its exact components, rounded, if the error of the doubles is
    /// [`COARSE`] or more.
    pub(super) fn improve(&mut self, v: VectorId, exact: &[dashu_int::IBig; 6]) {
        let vector = &self.vectors[v.index()];
        if !vector.refined || vector.fine.is_nan() || vector.fine >= COARSE {
            self.set(v, rounded_double_double(exact), STEP);
        }
    }

    /// Returns a vector's rounded components, the largest of which is at most 1 in magnitude.
    pub fn rounded(&self, v: VectorId) -> &[f64; 6] {
        &self.near[v.index()].x
    }

    /// Returns the error bound of a vector's rounded components.
    pub fn error(&self, v: VectorId) -> f64 {
        self.near[v.index()].error
    }

    /// Returns the components of a refined vector as double-doubles.
    pub(super) fn fine(&self, v: VectorId) -> [DoubleDouble; 6] {
        let (x, rest) = (&self.near[v.index()].x, &self.vectors[v.index()].rest);
        std::array::from_fn(|i| DoubleDouble(x[i], rest[i]))
    }

    /// Computes the rounded Klein form, with a bound on its error.
    ///
    /// The form has six products and five sums of magnitudes |aᵢbⱼ|, whose total is at most the lower of the
    /// two sums S (no component exceeds 1): 6u·S. The errors of the vectors add e·S' + e'·S + 6ee'.
    #[inline]
    fn form(&self, a: VectorId, b: VectorId) -> (f64, f64) {
        let (v, w) = (&self.near[a.index()], &self.near[b.index()]);
        let bound = 8.0 * U * v.sum.min(w.sum)
            + 1.01 * (v.error * w.sum + w.error * v.sum + 6.0 * v.error * w.error);
        (klein(&v.x, &w.x), bound)
    }

    /// Computes the Klein form like [`Space::form`], but of refined vectors in double-doubles.
    ///
    /// Each of eleven operations is off by at most [`STEP`] times S.
    fn fine_form(&self, a: VectorId, b: VectorId) -> (DoubleDouble, f64) {
        let (x, y) = (self.fine(a), self.fine(b));
        let term = |i: usize, j: usize| x[i].times(y[j]);
        let value = term(0, 3)
            .plus(term(1, 4))
            .plus(term(2, 5))
            .plus(term(3, 0).plus(term(4, 1)).plus(term(5, 2)));
        let (v, w) = (self.near[a.index()].sum, self.near[b.index()].sum);
        let (e, f) = (self.vectors[a.index()].fine, self.vectors[b.index()].fine);
        (
            value,
            16.0 * STEP * v.min(w) + 1.01 * (e * w + f * v + 6.0 * e * f),
        )
    }

    /// Returns the sign of the Klein form, or `None` if doubles cannot decide it.
    #[inline]
    pub fn filtered_side(&self, a: VectorId, b: VectorId) -> Option<Ordering> {
        let (value, bound) = self.form(a, b);
        (value.abs() > bound).then_some(if value > 0.0 {
            Ordering::Greater
        } else {
            Ordering::Less
        })
    }

    /// Computes the sign of the Klein form after the filter in doubles failed: in double-doubles and, if
    /// these cannot decide it, in integers.
    pub fn unfiltered_side(&mut self, a: VectorId, b: VectorId) -> Ordering {
        self.refined_side(a, b)
            .unwrap_or_else(|| self.exact_side(a, b))
    }

    /// Computes the sign of the Klein form, or returns `None` if double-doubles cannot decide it.
    pub(super) fn refined_side(&mut self, a: VectorId, b: VectorId) -> Option<Ordering> {
        self.refine(a);
        self.refine(b);
        let (value, bound) = self.fine_form(a, b);
        let sure = value.0.abs() > bound;
        self.decisions.refined += u64::from(sure);
        sure.then_some(if value.0 > 0.0 {
            Ordering::Greater
        } else {
            Ordering::Less
        })
    }

    /// Adds the ray at which the edge between `a` and `b` meets the border of `half`.
    ///
    /// `a` and `b` are on different sides of `half`.
    ///
    /// The ray is x = αb + (1 − α)a with α = s/(s + |t|). With B the bounds of the forms s and t, α is off by
    /// at most max(B)/(s + |t| − 2 max(B)). α is off by at most 1, because it is always in [0, 1]. The ray is
    /// off by this error times |b − a|, in addition to the errors of its parents. α itself is rounded by 3u,
    /// and three operations on numbers of at most 2 follow: 16u.
    ///
    /// `on` returns the lines whose hyperplanes contain the new ray. The function calls `on` only if this
    /// error is too large.
    pub fn cut(
        &mut self,
        [a, b]: [VectorId; 2],
        half: VectorId,
        on: impl FnOnce() -> Vec<VectorId>,
    ) -> VectorId {
        let ((s, es), (t, et)) = (self.form(a, half), self.form(b, half));
        let (v, w) = (&self.near[a.index()], &self.near[b.index()]);
        let (s, t) = (s.abs(), t.abs());
        let total = s + t;
        let alpha = s / total;
        let mut apart = 0.0f64;
        let mut x = v.x;
        for (x, w) in x.iter_mut().zip(w.x) {
            let d = w - *x;
            apart = apart.max(d.abs());
            *x += alpha * d;
        }
        let bound = es.max(et);
        let room = total - 2.0 * bound;
        let off = if room > bound {
            1.01 * bound / room
        } else {
            1.0
        };
        let error = v.error.max(w.error) + off.min(1.0) * (apart + v.error + w.error) + 16.0 * U;
        let id = VectorId(self.vectors.len() as u32);
        let (x, scale) = normalised(x);
        let error = error * scale;
        self.near.push(FilterVector {
            x,
            error,
            sum: x.iter().map(|c| c.abs()).sum(),
        });
        self.vectors.push(Vector {
            rest: [0.0; 6],
            fine: f64::INFINITY,
            refined: false,
            origin: Origin::Cut { a, b, half },
            exact: None,
            line: None,
        });
        // The condition is also false for NaN.
        let good = room > 0.0 && error < COARSE;
        if !good {
            match self.solved(x, error, &on(), false) {
                Some(Solved::Doubles(x, error)) => {
                    let (x, scale) = normalised(x);
                    let sum = x.iter().map(|c| c.abs()).sum();
                    self.near[id.index()] = FilterVector {
                        x,
                        error: error * scale,
                        sum,
                    };
                }
                Some(Solved::Pairs(x, fine)) if fine < COARSE => self.set(id, x, fine),
                _ => self.refine(id),
            }
        }
        id
    }

    /// Computes a ray in double-doubles from the lines `on`, whose hyperplanes contain it, if the error is
    /// then below [`PRECISE`].
    ///
    /// The function returns true if it replaced the ray's components.
    pub(super) fn refine_from(&mut self, ray: VectorId, on: &[VectorId]) -> bool {
        let near = &self.near[ray.index()];
        match self.solved(near.x, near.error, on, true) {
            Some(Solved::Pairs(x, fine)) if fine < PRECISE => {
                self.set(ray, x, fine);
                true
            }
            _ => false,
        }
    }

    /// Computes a cut, and the vectors from which it is constructed, in double-doubles.
    fn refine(&mut self, v: VectorId) {
        if self.vectors[v.index()].refined {
            return;
        }
        // Chains of constructions can be long, so there is no recursion.
        let mut open = vec![v];
        while let Some(id) = open.last().copied() {
            let (false, Origin::Cut { a, b, half }) = (
                self.vectors[id.index()].refined,
                &self.vectors[id.index()].origin,
            ) else {
                open.pop();
                continue;
            };
            let parts = [*a, *b, *half];
            let before = open.len();
            open.extend(
                parts
                    .into_iter()
                    .filter(|p| !self.vectors[p.index()].refined),
            );
            if open.len() == before {
                self.refine_cut(id, parts);
                open.pop();
            }
        }
    }

    /// Computes a cut like [`Space::cut`], but from parents in double-doubles, so that [`STEP`] replaces u in
    /// the error bound.
    fn refine_cut(&mut self, id: VectorId, [a, b, half]: [VectorId; 3]) {
        let ((s, es), (t, et)) = (self.fine_form(a, half), self.fine_form(b, half));
        let (p, q) = (self.fine(a), self.fine(b));
        let (e, f) = (self.vectors[a.index()].fine, self.vectors[b.index()].fine);
        let (s, t) = (s.abs(), t.abs());
        let total = s.plus(t);
        let alpha = s.over(total);
        let mut apart = 0.0f64;
        let x: [DoubleDouble; 6] = std::array::from_fn(|i| {
            let d = q[i].minus(p[i]);
            apart = apart.max(d.0.abs());
            p[i].plus(alpha.times(d))
        });
        let bound = es.max(et);
        let room = total.0 - 2.0 * bound;
        let off = if room > bound {
            1.01 * bound / room
        } else {
            1.0
        };
        self.set(
            id,
            x,
            e.max(f) + off.min(1.0) * (apart + e + f) + 16.0 * STEP,
        );
        let good = room > 0.0 && self.vectors[id.index()].fine < COARSE;
        if !good {
            // Filters and the search for lines cannot use a ray with such a large error.
            self.vectors[id.index()].fine = f64::INFINITY;
            self.sharpen(id);
        }
    }
}
