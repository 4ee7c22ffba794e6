//! Six-vectors in doubles with bounds on their errors: the filter that decides nearly all signs.
//!
//! A cut is computed in doubles from the doubles of its parents. Where errors have added up along the chain,
//! or a filter fails, the cut is solved from the lines it is on ([`super::solved`]), in double-doubles if
//! needed. Where that fails, the cut is computed in double-doubles from its parents, after all vectors they
//! are constructed from.

use std::cmp::Ordering;

use sightline_geometry::rounding::UNIT as U;

use super::solved::Solved;
use super::{Near, Origin, Space, Vector, VectorId, klein};
use crate::arithmetic::double_double::{DoubleDouble, STEP};
use crate::arithmetic::number::{normalised, rounded_double_double};

/// Rays that may be off by more than this are solved from the lines they are on, or computed in
/// double-doubles, at once; rays that are still off by as much are computed exactly. The search for lines in
/// a region needs rays with small errors. This threshold affects no sign: signs that a filter leaves open are
/// decided with more precision.
const COARSE: f64 = 1e-9;

/// Rays with at most this error in double-doubles are tested in double-doubles before integers.
const PRECISE: f64 = 1e-22;

impl Space {
    /// Adds a vector given in double-doubles, with a bound on their errors.
    pub(super) fn push(&mut self, x: [DoubleDouble; 6], fine: f64, origin: Origin) -> VectorId {
        let line = matches!(origin, Origin::Join(..) | Origin::Meet(..)).then(|| {
            self.meeting.push(Vec::new());
            (self.meeting.len() - 1) as u32
        });
        let id = VectorId(self.vectors.len() as u32);
        self.near.push(Near {
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

    /// Sets the double-doubles of a vector, with a bound on their errors.
    fn set(&mut self, v: VectorId, x: [DoubleDouble; 6], fine: f64) {
        let (high, scale) = normalised(x.map(|c| c.0));
        let rest = x.map(|c| c.1 * scale);
        let fine = fine * scale;
        let error = (fine + rest.iter().fold(0.0f64, |m, c| m.max(c.abs()))) * (1.0 + 4.0 * U);
        self.near[v.index()] = Near {
            x: high,
            error,
            sum: high.iter().map(|c| c.abs()).sum(),
        };
        let vector = &mut self.vectors[v.index()];
        (vector.rest, vector.fine, vector.refined) = (rest, fine, true);
    }

    /// Replaces the doubles of a vector by its rounded integers if the doubles are coarse.
    pub(super) fn improve(&mut self, v: VectorId, exact: &[dashu_int::IBig; 6]) {
        let vector = &self.vectors[v.index()];
        if !vector.refined || vector.fine.is_nan() || vector.fine >= COARSE {
            self.set(v, rounded_double_double(exact), STEP);
        }
    }

    /// A vector's rounded components, the greatest at most 1.
    pub fn rounded(&self, v: VectorId) -> &[f64; 6] {
        &self.near[v.index()].x
    }

    /// How far the rounded components may be off.
    pub fn error(&self, v: VectorId) -> f64 {
        self.near[v.index()].error
    }

    /// A refined vector in double-doubles.
    pub(super) fn fine(&self, v: VectorId) -> [DoubleDouble; 6] {
        let (x, rest) = (&self.near[v.index()].x, &self.vectors[v.index()].rest);
        std::array::from_fn(|i| DoubleDouble(x[i], rest[i]))
    }

    /// The Klein form, rounded, with a bound on its error.
    ///
    /// Six products and five sums of magnitudes |aᵢbⱼ| whose total is at most the lesser of the two sums S
    /// (no component exceeds 1): 6u·S. The errors of the vectors add e·S' + e'·S + 6ee'.
    #[inline]
    fn form(&self, a: VectorId, b: VectorId) -> (f64, f64) {
        let (v, w) = (&self.near[a.index()], &self.near[b.index()]);
        let bound = 8.0 * U * v.sum.min(w.sum)
            + 1.01 * (v.error * w.sum + w.error * v.sum + 6.0 * v.error * w.error);
        (klein(&v.x, &w.x), bound)
    }

    /// As [`Space::form`], of refined vectors in double-doubles: eleven operations of a step each of at most
    /// S.
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

    /// The sign, where doubles can tell.
    #[inline]
    pub fn filtered_side(&self, a: VectorId, b: VectorId) -> Option<Ordering> {
        let (value, bound) = self.form(a, b);
        (value.abs() > bound).then_some(if value > 0.0 {
            Ordering::Greater
        } else {
            Ordering::Less
        })
    }

    /// The sign where doubles could not tell: by double-doubles, then by integers.
    pub fn unfiltered_side(&mut self, a: VectorId, b: VectorId) -> Ordering {
        self.refined_side(a, b)
            .unwrap_or_else(|| self.exact_side(a, b))
    }

    /// The sign, where double-doubles can tell.
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

    /// The ray where the edge between `a` and `b`, on different sides of `half`, meets its border.
    ///
    /// x = αb + (1 − α)a with α = s/(s + |t|). With B the bounds of the forms s and t, α is off by at most
    /// max(B)/(s + |t| − 2 max(B)), and by no more than 1, since it is always in [0, 1]; the ray is off by
    /// this error times |b − a|, in addition to the errors of its parents. α itself is rounded by 3u, and
    /// three operations on numbers of at most 2 follow: 16u.
    ///
    /// `on` returns the lines the ray is on; it is called when this error is too large.
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
        self.near.push(Near {
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
        // False for NaN, too.
        let good = room > 0.0 && error < COARSE;
        if !good {
            match self.solved(x, error, &on(), false) {
                Some(Solved::Doubles(x, error)) => {
                    let (x, scale) = normalised(x);
                    let sum = x.iter().map(|c| c.abs()).sum();
                    self.near[id.index()] = Near {
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

    /// Computes a ray in double-doubles from the lines it is on, if the error is then below [`PRECISE`];
    /// returns whether it is.
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

    /// Computes a cut and the vectors it is constructed from in double-doubles.
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

    /// As [`Space::cut`], from refined parts, with a step in place of u.
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
            // A ray that is mostly error is of no use to filters or to the search for lines.
            self.vectors[id.index()].fine = f64::INFINITY;
            self.sharpen(id);
        }
    }
}
