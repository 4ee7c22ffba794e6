//! Conjugate gradients with the diagonal as preconditioner (Hestenes and Stiefel 1952), in a fixed order of
//! sums.

use std::cmp::Ordering;

/// Solves A·x = b for a symmetric positive definite A, starting from the given `x`.
///
/// Stops when the norm of the residual b − A·x is at most `tolerance` times the norm for x = 0, or after
/// `most` steps. The norm weights squares by the inverse of `diagonal`, the diagonal of A. `apply` writes A·v
/// for a vector v.
pub(crate) fn solve(
    apply: impl Fn(&[f64], &mut [f64]),
    diagonal: &[f64],
    b: &[f64],
    x: &mut [f64],
    tolerance: f64,
    most: usize,
) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let scaled = |r: &[f64]| -> Vec<f64> {
        r.iter()
            .zip(diagonal)
            .map(|(r, d)| if *d > 0.0 { r / d } else { 0.0 })
            .collect()
    };
    let mut product = vec![0.0; x.len()];
    apply(x, &mut product);
    let mut r: Vec<f64> = b.iter().zip(&product).map(|(b, a)| b - a).collect();
    let goal = tolerance * tolerance * dot(b, &scaled(b));
    let mut z = scaled(&r);
    let mut left = dot(&r, &z);
    let mut p = z.clone();
    for _ in 0..most {
        // Comparisons with NaN do not return `Greater`, so NaN also ends the loop.
        if left.partial_cmp(&goal) != Some(Ordering::Greater) {
            return;
        }
        apply(&p, &mut product);
        let curve = dot(&p, &product);
        if curve.partial_cmp(&0.0) != Some(Ordering::Greater) {
            return;
        }
        let step = left / curve;
        for i in 0..x.len() {
            x[i] += step * p[i];
            r[i] -= step * product[i];
        }
        z = scaled(&r);
        let next = dot(&r, &z);
        for (p, z) in p.iter_mut().zip(&z) {
            *p = z + next / left * *p;
        }
        left = next;
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn solves_chain() {
        // The matrix has 2 on the diagonal, and -1 next to it.
        let n = 50;
        let apply = |v: &[f64], out: &mut [f64]| {
            for i in 0..n {
                let beside = |j: usize| v.get(j).copied().unwrap_or(0.0);
                out[i] = 2.0 * v[i] - beside(i.wrapping_sub(1)) - beside(i + 1);
            }
        };
        let mut b = vec![0.0; n];
        (b[0], b[n - 1]) = (1.0, 1.0);
        let mut x = vec![0.0; n];
        super::solve(apply, &vec![2.0; n], &b, &mut x, 1e-12, 200);
        assert!(x.iter().all(|x| (x - 1.0).abs() < 1e-9), "{x:?}");
    }
}
