//! Which regions hold real lines: the sign of the Klein form on a cone.
//!
//! A ray x is a real line when K(x, x) = 0, and a region holds an open set of real lines exactly when K takes both
//! signs on it. K ≥ 0 (or ≤ 0) on all pairs of its extreme rays makes it so on the whole cone, since every inner
//! ray is a positive combination of them; that is the certificate that nothing real is left.

use std::cmp::Ordering;

use crate::cone::Region;
use crate::vector::{Id, Space, klein};

/// What a region holds.
#[derive(Clone, Debug)]
pub enum Contents {
    /// No open set of real lines, proved.
    Nothing,
    /// Real lines: these, rounded, first the one that is deepest inside.
    Lines(Vec<[f64; 6]>),
    /// The signs of pairs differ but no change of sign was found inside.
    Unsure,
}

/// Looks for real lines in a region; up to `most` of them.
pub fn contents(space: &mut Space, region: &Region, most: usize) -> Contents {
    let rays: Vec<Id> = region.rays.iter().map(|(r, _)| *r).collect();
    let x: Vec<[f64; 6]> = rays.iter().map(|r| *space.rounded(*r)).collect();
    let n = rays.len();
    let mut positive = false;
    let mut negative = false;
    // The pairs whose sums are farthest from real, to either side, by the rounded form.
    let mut extreme: [Vec<(f64, usize, usize)>; 2] = [Vec::new(), Vec::new()];
    let mut open: Vec<(Id, Id)> = Vec::new();
    for i in 0..n {
        for j in i..n {
            let value = klein(&x[i], &x[j]);
            match space.filtered_side(rays[i], rays[j]) {
                Some(Ordering::Greater) => positive = true,
                Some(_) => negative = true,
                None => open.push((rays[i], rays[j])),
            }
            extreme[usize::from(value < 0.0)].push((value.abs(), i, j));
        }
    }
    space.decisions.filtered += ((n * (n + 1)) / 2 - open.len()) as u64;
    if !(positive && negative) {
        for (a, b) in open {
            match space.exact_side(a, b) {
                Ordering::Greater => positive = true,
                Ordering::Less => negative = true,
                Ordering::Equal => {}
            }
            if positive && negative {
                break;
            }
        }
    }
    if !(positive && negative) {
        return Contents::Nothing;
    }
    let centre: [f64; 6] = std::array::from_fn(|i| x.iter().map(|v| v[i]).sum::<f64>() / n as f64);
    let at_centre = klein(&centre, &centre);
    // From the centre towards the pairs on the other side of the quadric.
    let towards = &mut extreme[usize::from(at_centre > 0.0)];
    towards.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut lines: Vec<(f64, [f64; 6])> = Vec::new();
    for (_, i, j) in towards.iter().take(4 * most) {
        let Some(end) = beyond(&x[*i], &x[*j], at_centre) else { continue };
        // K((1−t)c + te) = 0 with K(c), K(e) of different signs.
        let (c, m, e) = (at_centre, klein(&centre, &end), klein(&end, &end));
        let t = crossing(c, m, e);
        lines.push((t, std::array::from_fn(|k| (1.0 - t) * centre[k] + t * end[k])));
        if lines.len() == most {
            break;
        }
    }
    if lines.is_empty() {
        return Contents::Unsure;
    }
    // The nearer to the centre the better.
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    Contents::Lines(lines.into_iter().map(|l| l.1).collect())
}

/// The combination of two rays on which K is farthest from the sign of `from`; none when it keeps that sign.
fn beyond(a: &[f64; 6], b: &[f64; 6], from: f64) -> Option<[f64; 6]> {
    let turn = if from > 0.0 { -1.0 } else { 1.0 };
    let (p, q, r) = (turn * klein(a, a), turn * klein(a, b), turn * klein(b, b));
    // p(1−t)² + 2q t(1−t) + r t², greatest where its slope vanishes if it bends downwards.
    let bend = p - 2.0 * q + r;
    let t = if bend < 0.0 { ((p - q) / bend).clamp(0.0, 1.0) } else if p > r { 0.0 } else { 1.0 };
    let value = p * (1.0 - t) * (1.0 - t) + 2.0 * q * t * (1.0 - t) + r * t * t;
    (value > 0.0).then(|| std::array::from_fn(|i| (1.0 - t) * a[i] + t * b[i]))
}

/// The t in [0, 1] at which c(1−t)² + 2m t(1−t) + e t² vanishes, c and e having different signs.
fn crossing(c: f64, m: f64, e: f64) -> f64 {
    // Bisection: immune to cancellation, and twenty steps are as near as snapping needs.
    let at = |t: f64| c * (1.0 - t) * (1.0 - t) + 2.0 * m * t * (1.0 - t) + e * t * t;
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..52 {
        let middle = 0.5 * (low + high);
        if (at(middle) > 0.0) == (c > 0.0) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}
