//! Regions that contain real lines: the signs of the Klein form on a cone.
//!
//! A ray x is a real line if K(x, x) = 0. A region contains an open set of real lines exactly if K has both
//! signs on it. If K ≥ 0 (or ≤ 0) on all pairs of its extreme rays, the same holds on the whole cone, because
//! every interior ray is a positive combination of extreme rays. These signs are the certificate that the
//! region contains no open set of real lines.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::{Abs as _, BitTest as _, SquareRoot as _};
use sightline_geometry::rounding::UNIT as U;

use crate::arithmetic::number::rounded;
use crate::geometry::predicates::sign;
use crate::line_space::cone::Region;
use crate::line_space::forms::{Forms, crossing};
use crate::line_space::space::{Space, VectorId, klein, klein_exact};

/// The result of the search for real lines in a region.
#[derive(Clone, Debug)]
pub enum Contents {
    /// The region contains no open set of real lines; this is proved.
    Nothing,
    /// The region contains these real lines, as Plücker coordinates rounded to doubles. The line nearest to
    /// the region's centre comes first.
    Lines(Vec<[f64; 6]>),
    /// The Klein form has both signs on pairs of the region's rays, but the computation in doubles finds no
    /// real line inside.
    Unsure,
}

/// Searches for at most `most` real lines in a region.
pub fn contents(space: &mut Space, region: &Region, most: usize, forms: &mut Forms) -> Contents {
    let n = region.rays.len();
    forms.begin(space, region);
    let at_centre = klein(&forms.centre, &forms.centre);
    forms.turn = if at_centre > 0.0 { -1.0 } else { 1.0 };
    // The bound is the largest error of a form of two rays. No component exceeds 1, and the sum of six
    // products is at most 6.
    let error = region
        .rays
        .iter()
        .fold(0.0f64, |m, (r, _)| m.max(space.error(*r)));
    let bound = 48.0 * U + 13.0 * error + 7.0 * error * error;
    // `sure`, the number of signs that the filter determines, is a double so that the loop vectorises.
    let (mut right, mut wrong, mut sure) = (false, false, 0.0f64);
    // For each ray, the largest distance that its pairs with itself and later rays reach to the side of the
    // quadric opposite the centre.
    let mut farthest = std::mem::take(&mut forms.farthest);
    farthest.clear();
    for i in 0..n {
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in forms.row(i) {
            least = if *value < least { *value } else { least };
            greatest = if *value > greatest { *value } else { greatest };
            sure += if value.abs() > bound { 1.0 } else { 0.0 };
        }
        right |= least < -bound;
        wrong |= greatest > bound;
        farthest.push(greatest);
    }
    space.decisions.filtered += sure as u64;
    let both = right && wrong || both_signs(space, region, forms, bound, [right, wrong]);
    let mut lines: Vec<(f64, [f64; 6])> = Vec::with_capacity(most);
    while both && lines.len() < most {
        let first = |b: usize, i: usize| if farthest[i] > farthest[b] { i } else { b };
        let i = (1..n).fold(0, first);
        let value = std::mem::replace(&mut farthest[i], 0.0);
        if value.is_nan() || value <= 0.0 {
            break;
        }
        let j = i + forms.row(i).iter().position(|v| *v == value).unwrap_or(0);
        // Values of the form below `noise` can be rounding errors and would lead to lines that are not real.
        let noise = 64.0 * U + 16.0 * error;
        let (a, b) = (
            space.rounded(region.rays[i].0),
            space.rounded(region.rays[j].0),
        );
        let Some(end) = beyond(a, b, at_centre, noise) else {
            continue;
        };
        // The line is the root of K((1−t)c + te) = 0, where K(c) and K(e) have different signs.
        let (c, m, e) = (at_centre, klein(&forms.centre, &end), klein(&end, &end));
        let t = crossing(c, m, e);
        lines.push((
            t,
            std::array::from_fn(|k| (1.0 - t) * forms.centre[k] + t * end[k]),
        ));
    }
    forms.farthest = farthest;
    if !both {
        return Contents::Nothing;
    }
    if lines.is_empty() {
        return Contents::Unsure;
    }
    // Lines nearer to the centre come first.
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    Contents::Lines(lines.into_iter().map(|l| l.1).collect())
}

/// Returns true if the Klein form has both signs on pairs of the region's rays.
///
/// The filter has found at most one of the two signs so far: `right` or `wrong`. The function decides the
/// pairs within the filter's error `bound` with exact arithmetic.
fn both_signs(
    space: &mut Space,
    region: &Region,
    forms: &mut Forms,
    bound: f64,
    [right, wrong]: [bool; 2],
) -> bool {
    // For each ray, the lines whose hyperplanes contain the ray, filled on first use.
    let mut on: Vec<Vec<VectorId>> = vec![Vec::new(); region.rays.len()];
    let turned = forms.turn < 0.0;
    let (mut positive, mut negative) = (
        right && turned || wrong && !turned,
        right && !turned || wrong && turned,
    );
    for i in 0..on.len() {
        for (j, _) in forms
            .row(i)
            .iter()
            .enumerate()
            .filter(|(_, v)| v.abs() <= bound || v.is_nan())
        {
            let j = i + j;
            for k in [i, j] {
                if on[k].is_empty() {
                    on[k].extend(region.tight(region.rays[k].1));
                }
            }
            match space.rays_side(region.rays[i].0, &on[i], region.rays[j].0, &on[j]) {
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

/// Returns the combination (1 − t)a + tb of two rays, t in [0, 1], at which K has the sign opposite to the
/// sign of `from` and the largest magnitude.
///
/// The result is `None` if this magnitude is at most `noise` for every t.
fn beyond(a: &[f64; 6], b: &[f64; 6], from: f64, noise: f64) -> Option<[f64; 6]> {
    let turn = if from > 0.0 { -1.0 } else { 1.0 };
    let (p, q, r) = (turn * klein(a, a), turn * klein(a, b), turn * klein(b, b));
    // The maximum of p(1−t)² + 2q t(1−t) + r t² is where its slope is 0, if it bends downwards.
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

/// The number of bits of the integer components of rays, used if doubles are too coarse.
const FINE: usize = 256;

/// The magnitude above which the Klein form of two rounded vectors has the sign of the exact form.
///
/// The value is the bound of [`contents`] with an error of u for each vector.
const SURELY: f64 = 64.0 * U;

/// The maximum number of pairs of rays for which [`precise`] computes a combination in integers. More than
/// one pair is needed because rounding errors can change the ranking of the pairs.
const MOST_TRIED: usize = 8;

/// Returns the rays of a region as integers truncated to 256 bits.
///
/// The truncation affects the lines that the search tries, but does not affect a verdict.
pub fn fine(space: &mut Space, region: &Region) -> Vec<[IBig; 6]> {
    region
        .rays
        .iter()
        .map(|(r, tight)| {
            let on: Vec<VectorId> = region.tight(*tight).collect();
            space.sharpen_from(*r, &on);
            let x = space.exact(*r);
            let longest = x.iter().map(|c| c.bit_len()).max().unwrap_or(0);
            x.clone().map(|c| {
                if longest > FINE {
                    c >> (longest - FINE)
                } else {
                    c << (FINE - longest)
                }
            })
        })
        .collect()
}

/// Computes a line inside a region that is too thin for doubles, as Plücker coordinates. The line is on the
/// Klein quadric up to a rounding of about 2⁻²⁵⁶.
///
/// Returns `None` if the Klein form has no sign opposite to the sign at the region's centre, neither at an
/// extreme ray nor at a tried combination of two extreme rays.
pub fn precise(space: &mut Space, region: &Region) -> Option<[IBig; 6]> {
    let rays = fine(space, region);
    let sum =
        |a: &[IBig; 6], b: &[IBig; 6]| -> [IBig; 6] { std::array::from_fn(|i| &a[i] + &b[i]) };
    let centre = rays[1..].iter().fold(rays[0].clone(), |s, r| sum(&s, r));
    let c = klein_exact(&centre, &centre);
    let turn = if sign(&c) == Ordering::Greater {
        -1.0
    } else {
        1.0
    };
    let wrong = |x: IBig| if turn < 0.0 { -x } else { x };
    // Doubles rank the pairs by the distance that they reach to the other side; integers decide the signs.
    let near: Vec<[f64; 6]> = rays.iter().map(rounded).collect();
    // The forms are scaled like the doubles, so that products do not overflow.
    let scale = f64::powi(2.0, -2 * FINE as i32);
    let form = |i: usize, j: usize| wrong(klein_exact(&rays[i], &rays[j])).to_f64().value() * scale;
    let own: Vec<f64> = (0..rays.len()).map(|i| form(i, i)).collect();
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (i, a) in near.iter().enumerate() {
        pairs.push((own[i], i, i));
        for (j, b) in near.iter().enumerate().skip(i + 1) {
            // No combination of the two rays has a form above max(p, q, r), and the largest form is between
            // the rays only if q is this maximum.
            if turn * klein(a, b) < -SURELY {
                continue;
            }
            let (p, q, r) = (own[i], form(i, j), own[j]);
            if p < q && r < q {
                pairs.push(((q * q - p * r) / (2.0 * q - p - r), i, j));
            }
        }
    }
    // Keep pairs whose value is within the rounding error of 0; integers decide their signs.
    pairs.retain(|pair| pair.0 > -1e-14);
    pairs.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mixed = |(i, j): (usize, usize)| -> [IBig; 6] {
        let (a, b) = (&rays[i], &rays[j]);
        if i == j {
            return a.clone();
        }
        let [p, q, r] = [(a, a), (a, b), (b, b)].map(|(x, y)| wrong(klein_exact(x, y)));
        let (s, t) = (&q - &r, &q - &p);
        std::array::from_fn(|k| (&a[k] * &s + &b[k] * &t) / (&s + &t))
    };
    let end = pairs
        .iter()
        .take(MOST_TRIED)
        .map(|(_, i, j)| mixed((*i, *j)))
        .find(|end| sign(&wrong(klein_exact(end, end))) == Ordering::Greater)?;
    if c.is_zero() {
        return Some(centre);
    }
    // As in `crossing`, e s² + 2m s + c = 0 holds for the line through centre + s·end, with s = n/d.
    let (m, e) = (klein_exact(&centre, &end), klein_exact(&end, &end));
    let under = &m * &m - &c * &e;
    let up = FINE.saturating_sub(under.bit_len() / 2);
    let root = IBig::from((under << (2 * up)).sqrt()) + (m.clone().abs() << up);
    let (n, d) = if sign(&m) == sign(&e) {
        (c.abs() << up, root)
    } else {
        (root, e.abs() << up)
    };
    Some(std::array::from_fn(|k| &centre[k] * &d + &end[k] * &n))
}
