//! Sight lines: real lines near a line of a region, between points strictly inside both polygons.
//!
//! A snapped point is the mean of three corners of a polygon, with positive integer weights. So the point
//! lies exactly in the polygon.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::DVec3;

use crate::arithmetic::number::primitive;
use crate::geometry::frame::PointForm;
use crate::geometry::{PointOrigin, predicates};
use crate::line_space::space::mix;
use crate::line_space::stabbing_polyhedron;
use crate::search::local::{PairState, SightLineEnd};

/// The sum of the integer weights of a snapped point.
const WEIGHTS: u64 = 1 << 50;

/// The number of bits of the weights of a point that is snapped precisely.
const FINE: usize = 240;

impl PairState<'_> {
    /// Returns the ends of a real line near `line`, strictly inside both polygons.
    ///
    /// The result is `None` if the computation in doubles finds no point in a polygon.
    pub fn snap(&mut self, line: &[f64; 6]) -> Option<(SightLineEnd, SightLineEnd)> {
        let p = self.snap_end(line, 0)?;
        let q = self.snap_end(line, 1)?;
        Some((p, q))
    }

    fn snap_end(&mut self, line: &[f64; 6], end: usize) -> Option<SightLineEnd> {
        let ids = if end == 0 { &self.pair.a } else { &self.pair.b };
        let at = stabbing_polyhedron::crossing_point(&self.space, line, ids);
        if !at.is_finite() {
            return None;
        }
        let corner = |i: usize| DVec3::from(self.space.point_at(ids[i]).at);
        let o = corner(0);
        // `best` is the triangle of the polygon's fan that contains the point or comes closest to containing
        // it.
        let mut best: Option<(f64, usize, [f64; 3])> = None;
        for i in 1..ids.len() - 1 {
            let (x, y, d) = (corner(i) - o, corner(i + 1) - o, at - o);
            let n = x.cross(y);
            let area = n.length_squared();
            let (s, t) = (d.cross(y).dot(n) / area, x.cross(d).dot(n) / area);
            let w = [1.0 - s - t, s, t];
            let least = w[0].min(w[1]).min(w[2]);
            if least.is_finite() && best.is_none_or(|(l, _, _)| least > l) {
                best = Some((least, i, w));
            }
        }
        let (_, i, w) = best?;
        let total = WEIGHTS as f64;
        // Each corner's weight is at least 1, so that the point is strictly inside the triangle.
        let s = ((w[1] * total) as i64).clamp(1, WEIGHTS as i64 - 2) as u64;
        let t = ((w[2] * total) as i64).clamp(1, (WEIGHTS - 1 - s) as i64) as u64;
        let weights = [WEIGHTS - s - t, s, t];
        Some(self.mixed(
            end,
            i,
            weights.map(IBig::from),
            weights.map(|w| w as f64 / total),
        ))
    }

    /// Adds a point of the triangle of a polygon's fan between corners 0, `i` and `i` + 1. `end` is 0 for
    /// polygon A and 1 for polygon B.
    fn mixed(
        &mut self,
        end: usize,
        i: usize,
        weights: [IBig; 3],
        shares: [f64; 3],
    ) -> SightLineEnd {
        let ids = if end == 0 { &self.pair.a } else { &self.pair.b };
        let corner_ids = [ids[0], ids[i], ids[i + 1]];
        let near = self.ends[end].1;
        let near = near[0] * shares[0] + near[i] * shares[1] + near[i + 1] * shares[2];
        (self.space.mixed(corner_ids, weights, shares), near)
    }

    /// Returns the ends of a real line like [`PairState::snap`], but for a line in integers, with weights of
    /// [`FINE`] bits.
    pub fn snap_precisely(&mut self, line: &[IBig; 6]) -> Option<(SightLineEnd, SightLineEnd)> {
        let p = self.snap_end_precisely(line, 0)?;
        let q = self.snap_end_precisely(line, 1)?;
        Some((p, q))
    }

    fn snap_end_precisely(&mut self, line: &[IBig; 6], end: usize) -> Option<SightLineEnd> {
        let ids = if end == 0 {
            self.pair.a.clone()
        } else {
            self.pair.b.clone()
        };
        let corners: Vec<[IBig; 4]> = ids
            .iter()
            .map(|i| self.space.point_exact(*i).clone())
            .collect();
        let plane = predicates::plane([&corners[0], &corners[1], &corners[2]]);
        // x = (n × m + k d) / (n · d).
        let (d, m) = (&line[..3], &line[3..]);
        let cross = |i: usize, j: usize| &plane[i] * &m[j] - &plane[j] * &m[i];
        let w: IBig = (0..3).map(|i| &plane[i] * &d[i]).sum();
        let mut at = [cross(1, 2), cross(2, 0), cross(0, 1), w];
        (0..3).for_each(|i| at[i] += &plane[3] * &d[i]);
        if predicates::sign(&at[3]) == Ordering::Less {
            at.iter_mut().for_each(|c| *c = -std::mem::take(c));
        }
        if at[3].is_zero() {
            return None;
        }
        // With a point `off` the plane, the determinants of (x, b, c, off), … are x's weights, times w.
        let off: [IBig; 4] = std::array::from_fn(|k| {
            if k < 3 {
                &corners[0][k] + &plane[k] * &corners[0][3]
            } else {
                corners[0][3].clone()
            }
        });
        for i in 1..corners.len() - 1 {
            let triangle = [&corners[0], &corners[i], &corners[i + 1]];
            let parts: [IBig; 3] = std::array::from_fn(|k| {
                let mut with = triangle;
                with[k] = &at;
                predicates::determinant([with[0], with[1], with[2], &off]) * &triangle[k][3]
            });
            let total: IBig = parts.iter().sum();
            if total.is_zero()
                || parts
                    .iter()
                    .any(|p| predicates::sign(p) != predicates::sign(&total))
            {
                continue;
            }
            let weights = parts.map(|p| ((p << FINE) / &total).max(IBig::ONE));
            let sum: IBig = weights.iter().sum();
            let shares = [0, 1, 2].map(|k| sightline_numbers::integer::ratio(&weights[k], &sum));
            return Some(self.mixed(end, i, weights, shares));
        }
        None
    }

    /// Returns the exact position of a snapped point in world space. `end` is 0 for a point of polygon A and
    /// 1 for a point of polygon B.
    pub fn source(&self, point: u32, end: usize) -> PointOrigin {
        let PointForm::Mix(of, weights) = &self.space.point_at(point).place else {
            unreachable!("witness ends are snapped points")
        };
        let (polygon, ids) = (
            self.ends[end].0,
            if end == 0 { &self.pair.a } else { &self.pair.b },
        );
        let corners = of.map(|o| {
            let i = ids.iter().position(|x| *x == o).unwrap_or(0);
            predicates::integers(&polygon.points()[i])
        });
        let mut x = mix([&corners[0], &corners[1], &corners[2]], weights);
        primitive(&mut x);
        PointOrigin::Exact(Box::new(x))
    }
}
