//! Rays solved from the lines whose hyperplanes contain them, rather than from the rays from which they were
//! cut.
//!
//! Each cut of a chain multiplies the error by the ratio of an edge's length to its distance from the
//! hyperplane. After a few glancing cuts, no bit is correct. But an extreme ray is the only solution of K(x,
//! l) = 0 for the lines l whose hyperplanes contain it, and these lines are known to the last bit. The error
//! of that solution depends on one condition number and not on the length of the chain.

use sightline_geometry::rounding::UNIT as U;

use super::{Space, VectorId};
use crate::arithmetic::double_double::{DoubleDouble, STEP};

/// The minimum magnitude of a pivot; with a smaller pivot, doubles do not show that the lines determine the
/// ray.
const LEAST_PIVOT: f64 = 1e-12;
/// The largest error in doubles of a ray that needs no double-doubles.
const FINE: f64 = 1e-12;
/// The largest error of a ray at which doubles distinguish the ray from its negative, which solves the same
/// equations.
pub(super) const MOST_ERROR: f64 = 0.05;

impl Space {
    /// Computes the ray near `x` that lies on the hyperplanes of all `lines`. `x` is off by at most `error`.
    ///
    /// The result is `None` if `error` is too large or if the matrix of the lines is too ill-conditioned for
    /// doubles.
    ///
    /// Let M have the functionals of five of the lines as rows, and x̃ as the sixth row. Let N be nearly the
    /// inverse of M, and τ ≥ ‖I − NM‖. Let x be the multiple of the true ray for which x̃·x = x̃·x̃. Then
    /// M(x̃ − x) = r has the five forms K(x̃, l) and 0 as components, so ‖x̃ − x‖ ≤ ‖Nr‖ / (1 − τ) if τ < 1.
    /// M is then regular and the ray unique (Krawczyk 1969). First, x̃ is improved by −Nr.
    ///
    /// The function computes the ray in double-doubles, which is slower, only if `best` is true or the error
    /// in doubles is at least [`FINE`].
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
            // Most rays are on the hyperplanes of exactly five lines, which are then independent.
            5 => [0, 1, 2, 3, 4],
            n => independent((0..n).map(row).collect())?,
        };
        let mut m = [x; 6];
        for (row_of_m, k) in m.iter_mut().zip(chosen) {
            *row_of_m = row(k);
        }
        let n = inverse(m)?;
        let line = |k: usize| lines[chosen[k]].index();
        // In a row of NM, six products and sums of at most |n||m| each are rounded, and all rows of M except
        // the last have errors.
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
        // The test distinguishes the ray from its negative: the largest component is at least a half and has
        // not changed sign.
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
        // Loops replace closures that build arrays, which would become calls. Hard scenes spend most of their
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
        // The residuals include the error of six products and their sums, and the errors of the lines.
        let mut r = residuals(&next);
        for (k, r) in r.iter_mut().enumerate() {
            let line = &self.near[line(k)];
            *r = r.abs() + (8.0 * U * line.sum + 6.1 * line.error) * size;
        }
        let error = bound(r);
        if error < FINE && !best {
            return Some(Solved::Doubles(next, error));
        }
        // A second step uses residuals in double-doubles. Here x is the multiple whose sixth form equals the
        // sixth form of the improved x̃. After x̃ ← x̃ − N·r̃, the remaining x̃ − x is (I − NM)(x̃ − x), in
        // addition to the error of r̃ and the rounding of the product.
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

/// Computes the scalar product of a vector in double-doubles and a vector in doubles.
///
/// The result is computed as if in double-doubles and then rounded. The result is off by at most 2u times its
/// magnitude plus 8 times [`STEP`] times Σ|aᵢbᵢ| (Dot2, Ogita et al. 2005: u times the magnitude and γ² ≈
/// 36u² times the sum). The products and sums of the second doubles of `a` add less than that.
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
    /// Components in doubles.
    Doubles([f64; 6], f64),
    /// Components in double-doubles.
    Pairs([DoubleDouble; 6], f64),
}

/// Returns the vector whose scalar product with another vector is the Klein form of both.
pub(super) fn functional<T: Clone>(x: &[T; 6]) -> [T; 6] {
    let [a, b, c, d, e, f] = x.clone();
    [d, e, f, a, b, c]
}

/// Returns the indices of five rows that are far from linearly dependent, chosen by elimination with the
/// largest pivot. The result is `None` if a pivot is at most [`LEAST_PIVOT`].
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

/// Computes a rounded inverse in place, by Gauss–Jordan elimination with row pivots. The result is `None` if
/// a pivot is at most [`LEAST_PIVOT`].
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
