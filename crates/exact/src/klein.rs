//! Which regions hold real lines: the sign of the Klein form on a cone.
//!
//! A ray x is a real line when K(x, x) = 0, and a region holds an open set of real lines exactly when K takes both
//! signs on it. K ≥ 0 (or ≤ 0) on all pairs of its extreme rays makes it so on the whole cone, since every inner
//! ray is a positive combination of them; that is the certificate that nothing real is left.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::BitTest as _;

use crate::cone::Region;
use crate::number::U;
use crate::predicates::sign;
use crate::vector::{Id, Space, klein, klein_exact};

/// What a region holds.
#[derive(Clone, Debug)]
pub enum Contents {
    /// No open set of real lines, proved.
    Nothing,
    /// Real lines: these, rounded, first the one that is deepest inside.
    Lines(Vec<[f64; 6]>),
    /// The signs of pairs differ but doubles show no change of sign inside.
    Unsure,
}

/// Looks for real lines in a region; up to `most` of them.
pub fn contents(space: &mut Space, region: &Region, most: usize) -> Contents {
    let n = region.rays.len();
    let x: Vec<[f64; 6]> = region.rays.iter().map(|(r, _)| *space.rounded(*r)).collect();
    let centre: [f64; 6] = std::array::from_fn(|i| x.iter().map(|v| v[i]).sum::<f64>() / n as f64);
    let at_centre = klein(&centre, &centre);
    let turn = if at_centre > 0.0 { -1.0 } else { 1.0 };
    // No form of two of these rays is off by more: no component exceeds 1, and six of them are at most 6.
    let error = region.rays.iter().fold(0.0f64, |m, (r, _)| m.max(space.error(*r)));
    let bound = 48.0 * U + 13.0 * error + 7.0 * error * error;
    let mut forms = Forms::new(&x, turn);
    // How many signs are sure, in doubles so that several are counted at once.
    let (mut right, mut wrong, mut sure) = (false, false, 0.0f64);
    // The pairs on the other side of the quadric than the centre, those farthest from it first.
    let mut towards: Vec<(f64, usize, usize)> = Vec::with_capacity(4 * most + 1);
    for i in 0..n {
        let row = forms.row(i);
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in row {
            least = if *value < least { *value } else { least };
            greatest = if *value > greatest { *value } else { greatest };
            sure += if value.abs() > bound { 1.0 } else { 0.0 };
        }
        right |= least < -bound;
        wrong |= greatest > bound;
        let enough = |towards: &Vec<(f64, usize, usize)>| {
            if towards.len() < 4 * most { 0.0 } else { towards[towards.len() - 1].0 }
        };
        if greatest <= enough(&towards) {
            continue;
        }
        for (j, value) in row.iter().enumerate() {
            if *value > enough(&towards) {
                let at = towards.partition_point(|t| t.0 >= *value);
                towards.insert(at, (*value, i, i + j));
                towards.truncate(4 * most);
            }
        }
    }
    space.decisions.filtered += sure as u64;
    let both = right && wrong || both_signs(space, region, &mut forms, bound, [right, wrong]);
    if !both {
        return Contents::Nothing;
    }
    let mut lines: Vec<(f64, [f64; 6])> = Vec::new();
    for (_, i, j) in &towards {
        // Values of the form below this are rounding and would lead to lines that are none.
        let noise = 64.0 * U + 16.0 * error;
        let Some(end) = beyond(&x[*i], &x[*j], at_centre, noise) else { continue };
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

/// Whether the form has both signs on pairs of rays where filters show one at most, given which: integers say so.
fn both_signs(
    space: &mut Space,
    region: &Region,
    forms: &mut Forms,
    bound: f64,
    [right, wrong]: [bool; 2],
) -> bool {
    // The lines each ray is on, once they are needed.
    let mut on: Vec<Vec<Id>> = vec![Vec::new(); region.rays.len()];
    let turned = forms.turn < 0.0;
    let (mut positive, mut negative) =
        (right && turned || wrong && !turned, right && !turned || wrong && turned);
    for i in 0..on.len() {
        for (j, _) in forms.row(i).iter().enumerate().filter(|(_, v)| v.abs() <= bound || v.is_nan()) {
            let j = i + j;
            for k in [i, j] {
                if on[k].is_empty() {
                    on[k].extend(region.tight(region.rays[k].1));
                }
            }
            match space.rays_side((region.rays[i].0, &on[i]), (region.rays[j].0, &on[j])) {
                Ordering::Greater => positive = true,
                Ordering::Less => negative = true,
                Ordering::Equal => {}
            }
            if positive && negative {
                return true;
            }
        }
    }
    false
}

/// The form on all pairs of some rays, a row at a time.
struct Forms {
    /// The components of all rays, one component after the other, so that a row is computed several pairs at once.
    columns: [Vec<f64>; 6],
    turn: f64,
    row: Vec<f64>,
}

impl Forms {
    /// Of rays, times 1 or −1.
    fn new(x: &[[f64; 6]], turn: f64) -> Self {
        let columns = std::array::from_fn(|k| x.iter().map(|v| v[k]).collect());
        Self { columns, turn, row: Vec::with_capacity(x.len()) }
    }

    /// The form of a ray with itself and all that follow.
    fn row(&mut self, i: usize) -> &[f64] {
        let [a, b, c, d, e, f] = self.columns.each_ref().map(|c| &c[i..]);
        let [p, q, r, s, t, u] = [a[0], b[0], c[0], d[0], e[0], f[0]].map(|c| self.turn * c);
        let n = a.len();
        // Slices of one length need no check inside the loop.
        let (b, c, d, e, f) = (&b[..n], &c[..n], &d[..n], &e[..n], &f[..n]);
        self.row.clear();
        self.row.extend((0..n).map(|j| (p * d[j] + q * e[j] + r * f[j]) + (s * a[j] + t * b[j] + u * c[j])));
        &self.row
    }
}

/// The combination of two rays on which K is farthest from the sign of `from`; none when it keeps that sign.
fn beyond(a: &[f64; 6], b: &[f64; 6], from: f64, noise: f64) -> Option<[f64; 6]> {
    let turn = if from > 0.0 { -1.0 } else { 1.0 };
    let (p, q, r) = (turn * klein(a, a), turn * klein(a, b), turn * klein(b, b));
    // p(1−t)² + 2q t(1−t) + r t², greatest where its slope vanishes if it bends downwards.
    let bend = p - 2.0 * q + r;
    let t = if bend < 0.0 {
        ((p - q) / bend).clamp(0.0, 1.0)
    } else if p > r {
        0.0
    } else {
        1.0
    };
    let value = p * (1.0 - t) * (1.0 - t) + 2.0 * q * t * (1.0 - t) + r * t * t;
    (value > noise).then(|| std::array::from_fn(|i| (1.0 - t) * a[i] + t * b[i]))
}

/// The polar of a combination of the two rays whose pair is most of the wrong sign while each alone is not: one of them is
/// on each side of its hyperplane, and the pairs of either part are nearer to having one sign.
pub fn polar(space: &Space, region: &Region) -> Option<[f64; 6]> {
    let x: Vec<[f64; 6]> = region.rays.iter().map(|(r, _)| *space.rounded(*r)).collect();
    let centre: [f64; 6] = std::array::from_fn(|i| x.iter().map(|v| v[i]).sum::<f64>() / x.len() as f64);
    let wrong = if klein(&centre, &centre) > 0.0 { -1.0 } else { 1.0 };
    let mut best: Option<(f64, usize, usize)> = None;
    for i in 0..x.len() {
        for j in i + 1..x.len() {
            let value = wrong * klein(&x[i], &x[j]);
            if value > 0.0 && best.is_none_or(|(v, _, _)| value > v) {
                best = Some((value, i, j));
            }
        }
    }
    let (_, i, j) = best?;
    // With K(a, a), K(b, b) ≥ 0 > K(a, b): K(a, b/√K(b,b) − a/√K(a,a)) < 0 < K(b, …).
    let size = |v: &[f64; 6]| klein(v, v).abs().sqrt().max(1e-6);
    let (p, q) = (size(&x[i]), size(&x[j]));
    Some(std::array::from_fn(|k| x[j][k] / q - x[i][k] / p))
}

/// Bits behind the point of rays and parameters where doubles are too coarse.
const FINE: usize = 256;

/// A line inside a region, real to 2⁻²⁵⁶: for regions so thin that doubles do not show what is in them. None where no pair
/// of rays shows a change of sign.
pub fn precise(space: &mut Space, region: &Region) -> Option<[IBig; 6]> {
    // Rays of one size, cut off far behind what doubles hold; only where to look depends on it.
    let rays: Vec<[IBig; 6]> = region
        .rays
        .iter()
        .map(|(r, _)| {
            let x = space.exact(*r);
            let longest = x.iter().map(|c| c.bit_len()).max().unwrap_or(0);
            x.clone().map(|c| if longest > FINE { c >> (longest - FINE) } else { c << (FINE - longest) })
        })
        .collect();
    let sum = |a: &[IBig; 6], b: &[IBig; 6]| -> [IBig; 6] { std::array::from_fn(|i| &a[i] + &b[i]) };
    let centre = rays[1..].iter().fold(rays[0].clone(), |s, r| sum(&s, r));
    let c = klein_exact(&centre, &centre);
    let wrong = |x: IBig| if sign(&c) == Ordering::Greater { -x } else { x };
    let mut best: Option<(IBig, [IBig; 6])> = None;
    for (i, a) in rays.iter().enumerate() {
        let p = wrong(klein_exact(a, a));
        for b in &rays[i..] {
            let (q, r) = (wrong(klein_exact(a, b)), wrong(klein_exact(b, b)));
            let bend = &p - &q - &q + &r;
            // The best mix of the two: at (p − q)/bend if it bends down and the best is between them.
            let mixed = sign(&bend) == Ordering::Less && p < q && r < q;
            let end: [IBig; 6] = if mixed {
                let (s, t) = (&q - &r, &q - &p);
                std::array::from_fn(|k| (&a[k] * &s + &b[k] * &t) / (&s + &t))
            } else {
                a.clone()
            };
            let value = wrong(klein_exact(&end, &end));
            if sign(&value) == Ordering::Greater && best.as_ref().is_none_or(|(v, _)| value > *v) {
                best = Some((value, end));
            }
        }
    }
    let (_, end) = best?;
    let (m, e) = (klein_exact(&centre, &end), klein_exact(&end, &end));
    let whole = IBig::ONE << FINE;
    let (mut low, mut high) = (IBig::ZERO, whole.clone());
    for _ in 0..FINE {
        let t: IBig = (&low + &high) >> 1;
        let s = &whole - &t;
        let value = &c * &s * &s + ((&m * &s * &t) << 1) + &e * &t * &t;
        if sign(&value) == sign(&c) { low = t } else { high = t }
    }
    let rest = &whole - &low;
    Some(std::array::from_fn(|k| &centre[k] * &rest + &end[k] * &low))
}

/// The t in [0, 1] at which c(1−t)² + 2m t(1−t) + e t² vanishes, c and e having different signs.
fn crossing(c: f64, m: f64, e: f64) -> f64 {
    // Bisection: immune to cancellation.
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
