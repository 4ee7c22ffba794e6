//! Rays from the lines they are on, rather than from the rays they were cut from.
//!
//! Errors multiply along a chain of cuts, by the ratio of an edge's length to how far it gets from the hyperplane: a few
//! glancing cuts use up all bits there are. But an extreme ray is the one solution of K(x, l) = 0 for the lines l it is on, which are
//! known to the last bit, and solving that anew has one condition number and no chain.

use super::{Id, Space};
use crate::double::{Double, STEP};
use crate::number::U;

/// Pivots below this mean that the lines do not determine the ray, as far as doubles can tell.
const LEAST_PIVOT: f64 = 1e-12;
/// Rays known no better than this have no sign to go by.
const MOST_ERROR: f64 = 0.05;

impl Space {
    /// The ray on `lines` that is near `x`, which is off by at most `error`: in pairs of doubles, and how far they may be off. None
    /// where doubles are too coarse to tell.
    ///
    /// Let M have the functionals of five of the lines as rows and x̃ as the sixth, and N be nearly its inverse, τ ≥ ‖I − NM‖. With x
    /// the multiple of the true ray for which x̃·x = x̃·x̃, M(x̃ − x) = r has the five forms K(x̃, l) and 0 as components, so
    /// ‖x̃ − x‖ ≤ ‖Nr‖ / (1 − τ) if τ < 1; M is then regular and the ray unique (Krawczyk 1969). x̃ is improved by −Nr first.
    pub(super) fn solved(&self, x: [f64; 6], error: f64, lines: &[Id]) -> Option<([Double; 6], f64)> {
        if !(0.0..MOST_ERROR).contains(&error) {
            return None;
        }
        let rows: Vec<[f64; 6]> = lines.iter().map(|l| functional(&self.near[*l as usize].x)).collect();
        let chosen = independent(&rows)?;
        let m: [[f64; 6]; 6] = std::array::from_fn(|k| if k < 5 { rows[chosen[k]] } else { x });
        let n = inverse(m)?;
        let line = |k: usize| lines[chosen[k]] as usize;
        // How far a component of a row of M may be off: the last row is exact.
        let off: [f64; 6] = std::array::from_fn(|k| if k < 5 { self.near[line(k)].error } else { 0.0 });
        let mut tau = 0.0f64;
        for (i, row) in n.iter().enumerate() {
            let product = |j: usize| (0..6).map(|k| row[k] * m[k][j]).sum::<f64>();
            let apart: f64 = (0..6).map(|j| (f64::from(u8::from(i == j)) - product(j)).abs()).sum();
            // Six products and sums of at most |n||m| each are rounded, and M is off.
            let rounding = |k: usize| {
                let size: f64 = m[k].iter().map(|c| c.abs()).sum();
                row[k].abs() * (16.0 * U * size + 6.0 * off[k])
            };
            let sum = 1.01 * (apart + (0..6).map(rounding).sum::<f64>());
            if sum.is_nan() || sum >= 0.5 {
                return None;
            }
            tau = tau.max(sum);
        }
        let mut near = x.map(|c| Double(c, 0.0));
        let residuals = |near: &[Double; 6]| -> [Double; 5] {
            std::array::from_fn(|k| {
                let f = functional(&self.fine(lines[chosen[k]]));
                (0..6).fold(Double::default(), |s, i| s.plus(f[i].times(near[i])))
            })
        };
        let r = residuals(&near);
        for (i, c) in near.iter_mut().enumerate() {
            let step: f64 = (0..5).map(|k| n[i][k] * r[k].0).sum();
            *c = c.minus(Double(step, 0.0));
        }
        // Still the ray that was meant and not its opposite: the greatest component is at least a half and has not changed sign.
        let same = |(c, x): (&Double, f64)| (c.0 - x).abs() < 0.2;
        if !near.iter().zip(x).all(same) {
            return None;
        }
        let r = residuals(&near);
        let size = near.iter().fold(0.0f64, |m, c| m.max(c.0.abs()));
        // Twelve operations of a step each of the magnitudes that go in, and what the lines are off.
        let r: [f64; 5] = std::array::from_fn(|k| {
            let (sum, fine) = (self.near[line(k)].sum, self.vectors[line(k)].fine);
            r[k].0.abs() + 24.0 * STEP * sum * size + 6.1 * fine * size
        });
        let mut most = 0.0f64;
        for row in &n {
            let sum: f64 = (0..5).map(|k| row[k].abs() * r[k]).sum();
            if !sum.is_finite() {
                return None;
            }
            most = most.max(sum);
        }
        Some((near, 1.01 * most / (1.0 - tau)))
    }
}

/// What a six-vector does to another in the Klein form, as a scalar product.
fn functional<T: Copy>(x: &[T; 6]) -> [T; 6] {
    [x[3], x[4], x[5], x[0], x[1], x[2]]
}

/// Five rows that are far from dependent: elimination with the greatest pivot there is.
fn independent(rows: &[[f64; 6]]) -> Option<[usize; 5]> {
    let mut left = rows.to_vec();
    let mut chosen = [usize::MAX; 5];
    for k in 0..5 {
        let (mut most, mut row, mut column) = (LEAST_PIVOT, usize::MAX, 0);
        for (i, r) in left.iter().enumerate().filter(|(i, _)| !chosen[..k].contains(i)) {
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

/// An inverse, rounded, by Gauss and Jordan with row pivots.
fn inverse(mut m: [[f64; 6]; 6]) -> Option<[[f64; 6]; 6]> {
    let mut n: [[f64; 6]; 6] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    for k in 0..6 {
        let best = (k..6).max_by(|i, j| m[*i][k].abs().total_cmp(&m[*j][k].abs()))?;
        m.swap(k, best);
        n.swap(k, best);
        let pivot = m[k][k];
        if pivot.is_nan() || pivot.abs() <= LEAST_PIVOT {
            return None;
        }
        let (row, other) = (m[k].map(|c| c / pivot), n[k].map(|c| c / pivot));
        for i in 0..6 {
            let f = m[i][k];
            if i != k {
                (0..6).for_each(|j| m[i][j] -= f * row[j]);
                (0..6).for_each(|j| n[i][j] -= f * other[j]);
            }
        }
        (m[k], n[k]) = (row, other);
    }
    Some(n)
}
