//! Rays solved from the lines they are on, rather than from the rays they were cut from.
//!
//! Errors multiply along a chain of cuts, by the ratio of an edge's length to its distance from the
//! hyperplane: a few glancing cuts use up all bits. But an extreme ray is the one solution of K(x, l) = 0 for
//! the lines l it is on, which are known to the last bit, and solving that system has one condition number
//! and no chain.

use sightline_geometry::rounding::UNIT as U;

use super::{Space, VectorId};
use crate::arithmetic::double_double::{DoubleDouble, STEP};

/// Pivots below this mean that the lines do not determine the ray, as far as doubles can tell.
const LEAST_PIVOT: f64 = 1e-12;
/// Rays with at most this error in doubles need no double-doubles.
const FINE: f64 = 1e-12;
/// Rays with a greater error do not tell which of two opposite solutions is meant.
pub(super) const MOST_ERROR: f64 = 0.05;

impl Space {
    /// The ray on `lines` that is near `x`, which is off by at most `error`. None where doubles are too
    /// coarse to tell.
    ///
    /// Let M have the functionals of five of the lines as rows and x̃ as the sixth, and N be nearly its
    /// inverse, τ ≥ ‖I − NM‖. With x the multiple of the true ray for which x̃·x = x̃·x̃, M(x̃ − x) = r has
    /// the five forms K(x̃, l) and 0 as components, so ‖x̃ − x‖ ≤ ‖Nr‖ / (1 − τ) if τ < 1; M is then regular
    /// and the ray unique (Krawczyk 1969). x̃ is improved by −Nr first.
    ///
    /// Double-doubles take longer. They are used only if `best`, or where doubles are too coarse.
    pub(super) fn solved(
        &self,
        x: [f64; 6],
        error: f64,
        lines: &[VectorId],
        best: bool,
    ) -> Option<Solved> {
        if !(0.0..MOST_ERROR).contains(&error) {
            return None;
        }
        let row = |k: usize| functional(&self.near[lines[k].index()].x);
        let chosen = match lines.len() {
            0..5 => return None,
            // Most rays are on five lines, which are independent then.
            5 => [0, 1, 2, 3, 4],
            n => independent((0..n).map(row).collect())?,
        };
        let mut m = [x; 6];
        for (row_of_m, k) in m.iter_mut().zip(chosen) {
            *row_of_m = row(k);
        }
        let n = inverse(m)?;
        let line = |k: usize| lines[chosen[k]].index();
        // Of a row of NM, six products and sums of at most |n||m| each are rounded, and all rows of M but the
        // last are off.
        let mut rounding = [0.0; 6];
        for (k, r) in rounding.iter_mut().enumerate() {
            let off = if k < 5 { self.near[line(k)].error } else { 0.0 };
            *r = 16.0 * U * m[k].iter().map(|c| c.abs()).sum::<f64>() + 6.0 * off;
        }
        let mut tau = 0.0f64;
        for (i, row) in n.iter().enumerate() {
            let mut product = [0.0; 6];
            product[i] = -1.0;
            let mut sum = 0.0;
            for (c, (row_of_m, rounding)) in row.iter().zip(m.iter().zip(rounding)) {
                for (p, x) in product.iter_mut().zip(row_of_m) {
                    *p += c * x;
                }
                sum += c.abs() * rounding;
            }
            let sum = 1.01 * (sum + product.iter().map(|p| p.abs()).sum::<f64>());
            if sum.is_nan() || sum >= 0.5 {
                return None;
            }
            tau = tau.max(sum);
        }
        // Checks that the solution is the ray and not its opposite: the greatest component is at least a half
        // and has not changed sign.
        let same = |c: f64, x: f64| (c - x).abs() < 0.2;
        let bound = |r: [f64; 5]| {
            let most = n
                .iter()
                .map(|row| row.iter().zip(r).map(|(c, r)| c.abs() * r).sum::<f64>());
            1.01 * most.fold(
                0.0f64,
                |m, sum| if sum > m || sum.is_nan() { sum } else { m },
            ) / (1.0 - tau)
        };
        // Loops rather than closures that build arrays, which become calls: hard scenes spend most of their
        // time here.
        let residuals = |x: &[f64; 6]| -> [f64; 5] {
            let mut r = [0.0; 5];
            for (r, row) in r.iter_mut().zip(&m) {
                for (c, x) in row.iter().zip(x) {
                    *r += c * x;
                }
            }
            r
        };
        let r = residuals(&x);
        let mut next = x;
        for (c, row) in next.iter_mut().zip(&n) {
            for (f, r) in row.iter().zip(r) {
                *c -= f * r;
            }
        }
        if !next.iter().zip(x).all(|(c, x)| same(*c, x)) {
            return None;
        }
        let size = next.iter().fold(0.0f64, |m, c| m.max(c.abs()));
        // The error of six products and their sums, and the errors of the lines.
        let mut r = residuals(&next);
        for (k, r) in r.iter_mut().enumerate() {
            let line = &self.near[line(k)];
            *r = r.abs() + (8.0 * U * line.sum + 6.1 * line.error) * size;
        }
        let error = bound(r);
        if error < FINE && !best {
            return Some(Solved::Doubles(next, error));
        }
        // Once more, with residuals in double-doubles, x being the multiple whose sixth form is that of the
        // improved x̃. After x̃ ← x̃ − N·r̃, the remaining x̃ − x is (I − NM)(x̃ − x), in addition to the
        // error of r̃ and the rounding of the product.
        let (mut r, mut off) = ([0.0; 5], [0.0; 5]);
        for (k, (r, off)) in r.iter_mut().zip(&mut off).enumerate() {
            *r = dot(&functional(&self.fine(lines[chosen[k]])), &next);
            let (sum, fine) = (self.near[line(k)].sum, self.vectors[line(k)].fine);
            *off = 2.0 * U * r.abs() + 8.0 * STEP * sum * size + 6.1 * fine * size;
        }
        let mut near = [DoubleDouble::default(); 6];
        for (c, (row, x)) in near.iter_mut().zip(n.iter().zip(next)) {
            let mut step = 0.0;
            for (f, r) in row.iter().zip(r) {
                step += f * r;
            }
            *c = DoubleDouble::difference(x, step);
        }
        if !near.iter().zip(x).all(|(c, x)| same(c.0, x)) {
            return None;
        }
        let (most, off) = (bound(r.map(f64::abs)), bound(off));
        let error = 1.01 * (tau * (most + off) + off + 8.0 * U * most);
        error.is_finite().then_some(Solved::Pairs(near, error))
    }
}

/// The scalar product, the first vector in double-doubles, as if computed in them and then rounded: off by
/// at most 2u of itself and 8 steps of the magnitudes that go in (Dot2, Ogita et al. 2005: u and γ² ≈ 36u² of
/// them; the second doubles' products and sums add less than that).
fn dot(a: &[DoubleDouble; 6], b: &[f64; 6]) -> f64 {
    let mut sum = DoubleDouble::default();
    for (a, b) in a.iter().zip(b) {
        let product = DoubleDouble::product(a.0, *b);
        let next = DoubleDouble::sum(sum.0, product.0);
        sum = DoubleDouble(next.0, sum.1 + (next.1 + (product.1 + a.1 * b)));
    }
    sum.0 + sum.1
}

/// A solved ray, with a bound on the error of its components.
pub(super) enum Solved {
    /// In doubles.
    Doubles([f64; 6], f64),
    /// In double-doubles.
    Pairs([DoubleDouble; 6], f64),
}

/// The vector whose scalar product with another vector is their Klein form.
pub(super) fn functional<T: Clone>(x: &[T; 6]) -> [T; 6] {
    let [a, b, c, d, e, f] = x.clone();
    [d, e, f, a, b, c]
}

/// Five rows that are far from dependent, chosen by elimination with the greatest pivot.
pub(super) fn independent(mut left: Vec<[f64; 6]>) -> Option<[usize; 5]> {
    let mut chosen = [usize::MAX; 5];
    for k in 0..5 {
        let (mut most, mut row, mut column) = (LEAST_PIVOT, usize::MAX, 0);
        for (i, r) in left
            .iter()
            .enumerate()
            .filter(|(i, _)| !chosen[..k].contains(i))
        {
            for (j, c) in r.iter().enumerate() {
                if c.abs() > most {
                    (most, row, column) = (c.abs(), i, j);
                }
            }
        }
        let pivot = *left.get(row)?;
        chosen[k] = row;
        for r in &mut left {
            let f = r[column] / pivot[column];
            (0..6).for_each(|j| r[j] -= f * pivot[j]);
        }
    }
    Some(chosen)
}

/// An inverse, rounded, by Gauss and Jordan with row pivots, in place.
fn inverse(mut m: [[f64; 6]; 6]) -> Option<[[f64; 6]; 6]> {
    let mut swapped = [0; 6];
    for k in 0..6 {
        let best = (k + 1..6).fold(k, |b, i| if m[i][k].abs() > m[b][k].abs() { i } else { b });
        m.swap(k, best);
        swapped[k] = best;
        let pivot = m[k][k];
        if pivot.is_nan() || pivot.abs() <= LEAST_PIVOT {
            return None;
        }
        let factor = 1.0 / pivot;
        m[k][k] = 1.0;
        m[k].iter_mut().for_each(|c| *c *= factor);
        let row = m[k];
        for (i, other) in m.iter_mut().enumerate() {
            if i != k {
                let f = std::mem::take(&mut other[k]);
                for (c, r) in other.iter_mut().zip(row) {
                    *c -= f * r;
                }
            }
        }
    }
    // The inverse of a matrix with rows swapped has columns swapped.
    for k in (0..6).rev() {
        m.iter_mut().for_each(|row| row.swap(k, swapped[k]));
    }
    Some(m)
}
