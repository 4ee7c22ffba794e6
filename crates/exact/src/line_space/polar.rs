//! The split of a region by a polar hyperplane. It is used if pairs of the region's rays have both signs of
//! the Klein form and no real line inside was found.
//!
//! Let K(a, a), K(b, b) < 0 < K(a, b), or all signs reversed. For any α, β > 0, the hyperplane polar to βb −
//! αa has a on one side and b on the other. The reason is that K(a, βb − αa) = βK(a, b) − αK(a, a) and K(b,
//! βb − αa) = βK(b, b) − αK(a, b) have different signs. So neither part contains that pair, and the new rays
//! between a and b are nearer to each.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::BitTest as _;

use crate::arithmetic::number::{integers, primitive};
use crate::geometry::predicates::sign;
use crate::line_space::cone::Region;
use crate::line_space::klein::fine;
use crate::line_space::space::{Space, klein, klein_exact};

/// The number of bits of a hyperplane's components, unless the split needs more.
const SHORT: usize = 64;

/// A hyperplane's Plücker vector in world space, and the two parts of a region.
///
/// The parts are on the negative and on the positive side of the hyperplane.
pub type PolarSplit = ([IBig; 6], [Region; 2]);

/// Splits a region by a polar hyperplane.
///
/// The hyperplane is chosen in doubles. If that hyperplane does not split the region, the function chooses
/// one in integers and uses the fewest bits that split the region, at most 512. The result is `None` if no
/// tried hyperplane splits the region.
pub fn split(space: &mut Space, region: &Region) -> Option<PolarSplit> {
    if let Some(polar) = in_doubles(space, region)
        && let Some(found) = split_by(space, region, &integers(polar).0, SHORT)
    {
        return Some(found);
    }
    let polar = in_integers(space, region)?;
    (1..4).find_map(|k| split_by(space, region, &polar, SHORT << k))
}

/// Splits a region by the hyperplane polar to `polar`, a vector in the frame.
///
/// The function truncates the hyperplane's components in world space to `bits` bits. The result is `None` if
/// the region's rays are not on both sides of the truncated hyperplane.
fn split_by(
    space: &mut Space,
    region: &Region,
    polar: &[IBig; 6],
    bits: usize,
) -> Option<PolarSplit> {
    let mut polar = space.frame().line_to_world(polar);
    let longest = polar.iter().map(|c| c.bit_len()).max().unwrap_or(0);
    polar
        .iter_mut()
        .for_each(|c| *c >>= longest.saturating_sub(bits));
    if polar.iter().all(IBig::is_zero) {
        return None;
    }
    primitive(&mut polar);
    let line = space.frame().line_from_world(&polar);
    let line = space.fixed(line);
    let mut sides = Vec::new();
    region.sides(space, line, &mut sides);
    if !sides.contains(&Ordering::Less) || !sides.contains(&Ordering::Greater) {
        return None;
    }
    let parts = region.split(space, line, &sides).ok()?;
    Some((polar, parts))
}

/// Computes, in doubles, the hyperplane for two rays a and b. K(a, b) has the sign opposite to the sign of K
/// at the region's centre, and no other pair of rays has such a form with a larger magnitude.
fn in_doubles(space: &Space, region: &Region) -> Option<[f64; 6]> {
    let x: Vec<[f64; 6]> = region
        .rays
        .iter()
        .map(|(r, _)| *space.rounded(*r))
        .collect();
    let centre: [f64; 6] =
        std::array::from_fn(|i| x.iter().map(|v| v[i]).sum::<f64>() / x.len() as f64);
    let wrong = if klein(&centre, &centre) > 0.0 {
        -1.0
    } else {
        1.0
    };
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
    // Scale both rays so that the magnitude of each ray's form with itself is 1.
    let size = |v: &[f64; 6]| klein(v, v).abs().sqrt().max(1e-6);
    let (p, q) = (size(&x[i]), size(&x[j]));
    Some(std::array::from_fn(|k| x[j][k] / q - x[i][k] / p))
}

/// Computes, in integers, the hyperplane for the two rays a and b with the largest mutual form K(a, b).
///
/// The mutual form must have the sign opposite to both own forms, K(a, a) and K(b, b). Its size is measured
/// relative to the own forms, as K(a, b)² / (K(a, a) K(b, b)).
///
/// If the own form of a ray is 0 or the two own forms have different signs, a combination of the two rays is
/// a real line, and [`crate::line_space::klein::precise`] finds it.
fn in_integers(space: &mut Space, region: &Region) -> Option<[IBig; 6]> {
    let rays = fine(space, region);
    let own: Vec<IBig> = rays.iter().map(|x| klein_exact(x, x)).collect();
    let mut best: Option<(f64, usize, usize)> = None;
    for (i, j) in (0..rays.len()).flat_map(|i| (i + 1..rays.len()).map(move |j| (i, j))) {
        let pair = klein_exact(&rays[i], &rays[j]);
        let signs = [&own[i], &own[j]].map(sign);
        if signs[0] != signs[1] || signs[0] == Ordering::Equal || sign(&pair) != signs[0].reverse()
        {
            continue;
        }
        // The form of the pair relative to the own forms of the two rays.
        let [p, q, r] = [&own[i], &pair, &own[j]].map(|x| x.to_f64().value().abs());
        let much = (q / p) * (q / r);
        if best.is_none_or(|(m, _, _)| much > m) {
            best = Some((much, i, j));
        }
    }
    let (_, i, j) = best?;
    // The rays are scaled to about the same size; the split is correct for any factors.
    let bits = |x: &IBig| x.bit_len() / 2;
    let (p, q) = (bits(&own[i]), bits(&own[j]));
    let (up, over) = (p.saturating_sub(q), q.saturating_sub(p));
    Some(std::array::from_fn(|k| {
        (&rays[j][k] << up) - (&rays[i][k] << over)
    }))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::arithmetic::random::Random;
    use crate::geometry::frame::Frame;
    use crate::line_space::forms::Forms;
    use crate::line_space::klein::{self, Contents, contents};

    /// Creates six vectors within 2^−`apart` of one real line, each a little off the quadric to the same
    /// side.
    fn nearly_one(random: &mut Random, apart: usize) -> [[IBig; 6]; 6] {
        let mut any = || IBig::from((random.unit() * f64::powi(2.0, 40)) as i64) << apart;
        std::array::from_fn(|_| {
            let half = IBig::ONE << (39 + apart);
            let [a, b, d, e] = std::array::from_fn(|_| any() - &half);
            // K(x, x) = 2(ad + be + cf), negative.
            let c = IBig::ONE << (40 + 2 * apart);
            let f = -(&a * &d + &b * &e + (any() << (39 + apart))) / &c;
            [a, b, c, d, e, f]
        })
    }

    fn space() -> Space {
        let square = |z: f64| {
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, z))
        };
        Space::new(Frame::around(&square(0.0), &square(3.0)))
    }

    fn simplex(space: &mut Space, corner_rays: &[[IBig; 6]; 6]) -> Region {
        let (rays, halves) = space.simplex(corner_rays);
        Region {
            rays,
            halves: halves.into(),
        }
    }

    #[test]
    fn precise_lines_are_real_and_inside_region() {
        let mut random = Random::new(5, 0);
        let mut found = 0;
        for round in 0..800 {
            let mut space = space();
            let region = simplex(&mut space, &nearly_one(&mut random, 20 + round % 80));
            let Some(line) = klein::precise(&mut space, &region) else {
                continue;
            };
            found += 1;
            let bits = line.iter().map(|c| c.bit_len()).max().unwrap();
            assert!(
                klein_exact(&line, &line).bit_len() + 250 < 2 * bits,
                "round {round}"
            );
            // The line is on the same side of each facet as the ray opposite the facet.
            for (half, (ray, _)) in region.halves.iter().zip(&region.rays) {
                let (half, ray) = (space.exact(*half).clone(), space.exact(*ray).clone());
                let sides = [&line, &ray].map(|x| sign(&klein_exact(x, &half)));
                assert!(
                    sides[0] == sides[1] || sides[0] == Ordering::Equal,
                    "round {round}"
                );
            }
        }
        assert!(found > 100, "{found} had lines");
    }

    #[test]
    fn polar_splits_decide_regions_without_found_lines() {
        let mut random = Random::new(7, 0);
        let (mut forms, mut finely) = (Forms::default(), 0);
        for round in 0..2000 {
            let mut space = space();
            let cone = nearly_one(&mut random, 20 + round % 80);
            let mut open = vec![simplex(&mut space, &cone)];
            let mut splits = 0;
            while let Some(region) = open.pop() {
                if !matches!(
                    contents(&mut space, &region, 2, &mut forms),
                    Contents::Unsure
                ) || klein::precise(&mut space, &region).is_some()
                {
                    continue;
                }
                finely += u32::from(
                    in_doubles(&space, &region)
                        .and_then(|p| split_by(&mut space, &region, &integers(p).0, SHORT))
                        .is_none(),
                );
                splits += 1;
                assert!(
                    splits <= crate::search::QueryLimits::default().splits,
                    "a query would end before"
                );
                let (_, parts) = split(&mut space, &region).expect("a pair has the other sign");
                open.extend(parts);
            }
        }
        assert!(finely > 100, "{finely} needed integers");
    }
}
