//! Klein forms that vanish for a geometric reason: rays lie on edges of occluders, and edges share planes and
//! corners.
//!
//! Most signs that the filters cannot decide are such zeros, and lines have far smaller integers than rays.
//! Every rule here proves that a form is 0 from the incidences of lines. A form that no rule covers is
//! computed in double-doubles and then in integers.

use std::cmp::Ordering;

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use super::{Meeting, Origin, Space, Tight, VectorId};

impl Space {
    /// The sign for a ray that is known to be on all of `tight`, where doubles could not tell.
    ///
    /// For example, a ray on three edges of one face is on all edges in its plane.
    pub fn unfiltered_ray_side(
        &mut self,
        ray: VectorId,
        line: VectorId,
        tight: impl Iterator<Item = VectorId>,
    ) -> Ordering {
        let tight: Vec<VectorId> = tight.collect();
        if self.spans(line, &tight) {
            self.decisions.spanned += 1;
            return Ordering::Equal;
        }
        self.unexplained_side([ray, line], &[(ray, &tight)])
    }

    /// The sign of a form that no rule shows to be 0. `rays` holds the vectors that are rays, with lines they
    /// are on.
    fn unexplained_side(
        &mut self,
        [a, b]: [VectorId; 2],
        rays: &[(VectorId, &[VectorId])],
    ) -> Ordering {
        // In double-doubles from the lines a ray is on: along its chain of cuts, double-doubles would cost as
        // much as integers.
        for (ray, on) in rays {
            if !self.vectors[ray.index()].refined && !self.refine_from(*ray, on) {
                self.sharpen_from(*ray, on);
            }
        }
        if let Some(sign) = self.refined_side(a, b) {
            return sign;
        }
        for (ray, on) in rays {
            self.sharpen_from(*ray, on);
        }
        self.exact_side(a, b)
    }

    /// Whether `line` is shown to be a combination of some of `lines`: of one equal line (neighbouring
    /// targets share edges), of two lines in a pencil with it, or of three lines that meet pairwise. Three
    /// lines that meet pairwise lie in a plane or pass through a point; if they are independent, a line that
    /// meets all three also lies in that plane or passes through that point, and all such lines span three
    /// dimensions.
    fn spans(&mut self, line: VectorId, lines: &[VectorId]) -> bool {
        if !self.is_line(line) {
            return false;
        }
        let mut met: Vec<VectorId> = Vec::with_capacity(8);
        for l in lines {
            if self.is_line(*l) && self.meets(line, *l) {
                if self.same_line(line, *l).is_some() {
                    return true;
                }
                met.push(*l);
            }
        }
        for (k, a) in met.iter().enumerate() {
            for b in &met[k + 1..] {
                // An edge of A and an edge of B can be the same line, and then span that line only.
                if self.meets(*a, *b)
                    && self.same_line(*a, *b).is_none()
                    && self.pencil(line, *a, *b)
                {
                    return true;
                }
            }
        }
        self.triple(&met)
    }

    /// Whether a vector is a real line by its construction.
    pub(super) fn is_line(&self, v: VectorId) -> bool {
        self.vectors[v.index()].line.is_some()
    }

    /// Whether two vectors are lines that meet (or are the same).
    fn meets(&mut self, a: VectorId, b: VectorId) -> bool {
        let (Some(r), Some(s)) = (self.vectors[a.index()].line, self.vectors[b.index()].line)
        else {
            return false;
        };
        let (row, column) = (r.max(s) as usize, r.min(s) as usize);
        if row == column {
            return true;
        }
        match self.meeting[row].get(column) {
            Some(Meeting::Apart) => return false,
            Some(Meeting::Meets) => return true,
            _ => {}
        }
        let meets = self.share_a_point(a, b)
            || match self.filtered_side(a, b) {
                Some(_) => false,
                None => self.unfiltered_meets(a, b),
            };
        let known = &mut self.meeting[row];
        if known.len() <= column {
            self.asked += column + 1 - known.len();
            known.resize(column + 1, Meeting::NotAsked);
        }
        known[column] = if meets {
            Meeting::Meets
        } else {
            Meeting::Apart
        };
        meets
    }

    /// Whether two lines are joins with a common point.
    fn share_a_point(&self, a: VectorId, b: VectorId) -> bool {
        let [a, b] = [a, b].map(|l| &self.vectors[l.index()].origin);
        matches!((a, b), (Origin::Join(p, q), Origin::Join(r, s)) if p == r || p == s || q == r || q == s)
    }

    /// Whether two lines meet, where doubles cannot tell: lines in one plane meet, and two joins meet only in
    /// that case.
    fn unfiltered_meets(&mut self, a: VectorId, b: VectorId) -> bool {
        let [x, y] = [a, b].map(|l| self.vectors[l.index()].origin.clone());
        match (x, y) {
            (Origin::Join(p, q), Origin::Join(r, s)) => self.flat([p, q, r, s]),
            (Origin::Join(p, q), Origin::Meet(planes))
            | (Origin::Meet(planes), Origin::Join(p, q)) => {
                planes.iter().any(|through| {
                    let [r, s, t] = through.points;
                    self.flat([r, s, t, p]) && self.flat([r, s, t, q])
                }) || self.unfiltered_side(a, b) == Ordering::Equal
            }
            _ => self.unfiltered_side(a, b) == Ordering::Equal,
        }
    }

    /// Whether four points are in a plane.
    fn flat(&mut self, [p, q, r, s]: [u32; 4]) -> bool {
        self.orient(p, q, r, s) == Ordering::Equal
    }

    /// The Klein form's sign for two rays that are known to be on all of the lines `s` and `t`, where filters
    /// cannot tell.
    ///
    /// It is 0 for two rays on three independent lines that meet pairwise: these span a space W of three
    /// dimensions on which the form vanishes, W is its own orthogonal complement, and so both rays are in W.
    /// It is also 0 if one of the rays is a combination of lines that the other is on ([`Space::combines`]).
    pub fn rays_side(
        &mut self,
        (a, s): (VectorId, &[VectorId]),
        (b, t): (VectorId, &[VectorId]),
    ) -> Ordering {
        let common: Vec<VectorId> = s
            .iter()
            .copied()
            .filter(|l| self.is_line(*l) && t.contains(l))
            .collect();
        if self.triple(&common) || self.combines(s, t) || (a != b && self.combines(t, s)) {
            self.decisions.spanned += 1;
            return Ordering::Equal;
        }
        self.unexplained_side([a, b], &[(a, s), (b, t)])
    }

    /// Whether three of the lines are independent and meet pairwise.
    fn triple(&mut self, lines: &[VectorId]) -> bool {
        for (i, a) in lines.iter().enumerate() {
            for (j, b) in lines[i + 1..].iter().enumerate() {
                if !self.meets(*a, *b) {
                    continue;
                }
                for c in &lines[i + j + 2..] {
                    if self.meets(*a, *c) && self.meets(*b, *c) && !self.pencil(*a, *b, *c) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Whether the extreme ray that is on all lines of `ray` is shown to be one of `lines`, or a combination
    /// of two of them.
    ///
    /// An extreme ray is the only one on all of its lines. So a line that meets them all is that ray. If two
    /// lines both meet all but the same one, the ray is the combination of the two that is on that one, too.
    fn combines(&mut self, ray: &[VectorId], lines: &[VectorId]) -> bool {
        // For each line, the ray's lines that it does not meet, as bits; a vector that is no real line meets
        // none.
        let mut missed: Vec<(VectorId, Tight)> = Vec::with_capacity(lines.len());
        for l in lines
            .iter()
            .filter(|l| self.is_line(**l))
            .copied()
            .collect::<Vec<_>>()
        {
            let miss = ray
                .iter()
                .enumerate()
                .fold(0, |m, (k, r)| m | Tight::from(!self.meets(l, *r)) << k);
            if miss == 0 {
                return true;
            }
            missed.push((l, miss));
        }
        for (k, (l, m)) in missed.iter().enumerate() {
            for (o, n) in &missed[k + 1..] {
                // The combination of two equal lines could be 0.
                if (m | n).is_power_of_two() && self.same_line(*l, *o).is_none() {
                    return true;
                }
            }
        }
        false
    }

    /// The points in world space that three lines join; the frame's map of lines is linear and regular, so it
    /// keeps their rank.
    fn joins(&self, of: [VectorId; 3]) -> Option<[[DVec3; 2]; 3]> {
        let mut ends = [[DVec3::ZERO; 2]; 3];
        for (ends, l) in ends.iter_mut().zip(of) {
            let Origin::Join(p, q) = self.vectors[l.index()].origin else {
                return None;
            };
            *ends = self.world([p, q])?;
        }
        Some(ends)
    }

    /// Whether doubles show a 3×3 minor of three vectors that does not vanish.
    ///
    /// No component exceeds 1 and each is off by at most its vector's error e: a minor of six products of
    /// three factors is off by 6(e + e' + e'') and terms of higher order, and by 5u of each product for the
    /// roundings.
    pub(super) fn surely_independent(&self, of: [VectorId; 3]) -> bool {
        let [x, y, z] = of.map(|l| &self.near[l.index()]);
        let error = x.error + y.error + z.error;
        if error.is_nan() || error > 1e-3 {
            return false;
        }
        let bound = 6.1 * error + 40.0 * U;
        let mut pivot = (0.0f64, 0, 1);
        for i in 0..6 {
            for j in i + 1..6 {
                let m = x.x[i] * y.x[j] - x.x[j] * y.x[i];
                if m.abs() > pivot.0.abs() {
                    pivot = (m, i, j);
                }
            }
        }
        let (m, i, j) = pivot;
        let minor = |a: &[f64; 6], b: &[f64; 6], i: usize, j: usize| a[i] * b[j] - a[j] * b[i];
        (0..6).any(|k| {
            let det =
                m * z.x[k] - minor(&x.x, &y.x, i, k) * z.x[j] + minor(&x.x, &y.x, j, k) * z.x[i];
            det.abs() > bound
        })
    }

    /// Whether three lines that meet pairwise are dependent.
    fn pencil(&mut self, a: VectorId, b: VectorId, c: VectorId) -> bool {
        let mut key = [a, b, c];
        key.sort_unstable();
        if let Some(known) = self.pencils.get(&key) {
            return *known;
        }
        if self.surely_independent(key) {
            self.decisions.filtered += 1;
            self.pencils.insert(key, false);
            return false;
        }
        if let Some(known) = self.joins(key).and_then(super::small::dependent) {
            self.decisions.exact += 1;
            self.decisions.zero += u64::from(known);
            self.pencils.insert(key, known);
            return known;
        }
        let [x, y, z] = key.map(|l| self.exact(l).clone());
        let minor = |i: usize, j: usize| &x[i] * &y[j] - &x[j] * &y[i];
        let pivot = (0..6)
            .flat_map(|i| (i + 1..6).map(move |j| (i, j)))
            .find(|(i, j)| !minor(*i, *j).is_zero());
        // Two equal lines also count as dependent; callers exclude this case where it matters.
        let dependent = pivot.is_none_or(|(i, j)| {
            let d = minor(i, j);
            (0..6).all(|k| (&d * &z[k] - minor(i, k) * &z[j] + minor(j, k) * &z[i]).is_zero())
        });
        self.pencils.insert(key, dependent);
        dependent
    }
}
