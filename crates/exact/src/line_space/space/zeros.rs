//! Klein forms that are 0 for a geometric reason: rays lie on hyperplanes of occluders' edges, and edges
//! share planes and corners.
//!
//! Most signs that the filters cannot decide are such zeros, and lines have far smaller integers than rays.
//! Every rule in this module proves from the incidences of lines that a form is 0. A form that no rule covers
//! is computed in double-doubles and then in integers.

use std::cmp::Ordering;

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use super::{Meeting, Origin, Space, Tight, VectorId};

impl Space {
    /// Computes the sign of the Klein form of a ray and a line, after the filter in doubles failed. The
    /// hyperplanes of all lines of `tight` contain the ray.
    ///
    /// For example, a ray on the hyperplanes of three edges of one face is on the hyperplanes of all edges in
    /// the plane of the face.
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

    /// Computes the sign of the Klein form of two vectors if no rule shows that the form is 0.
    ///
    /// `rays` contains each of the two vectors that is a ray, with lines whose hyperplanes contain the
    /// ray.
    fn unexplained_side(
        &mut self,
        [a, b]: [VectorId; 2],
        rays: &[(VectorId, &[VectorId])],
    ) -> Ordering {
        // Compute the ray in double-doubles from these lines. Along its chain of cuts, double-doubles would
        // cost as much as integers.
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

    /// Returns true if incidences show that `line` is a combination of some of `lines`.
    ///
    /// The function recognises three cases: one of `lines` is the same line (neighbouring targets share
    /// edges), two of `lines` are in a pencil with `line`, or `line` meets three of `lines` that meet
    /// pairwise. Three lines that meet pairwise lie in a plane or pass through a point. If they are
    /// independent, a line that meets all three also lies in that plane or passes through that point, and all
    /// such lines span three dimensions.
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
                // An edge of A and an edge of B can be on the same line, and then both edges span only that
                // line.
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

    /// Returns true if a vector is a real line by its construction.
    pub(super) fn is_line(&self, v: VectorId) -> bool {
        self.vectors[v.index()].line.is_some()
    }

    /// Returns true if two vectors are lines that meet or coincide.
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

    /// Returns true if both lines were constructed from two points each and share one of these points.
    fn share_a_point(&self, a: VectorId, b: VectorId) -> bool {
        let [a, b] = [a, b].map(|l| &self.vectors[l.index()].origin);
        matches!((a, b), (Origin::Join(p, q), Origin::Join(r, s)) if p == r || p == s || q == r || q == s)
    }

    /// Tests whether two lines meet, after the filter in doubles failed.
    ///
    /// Two lines in one plane meet. Two lines that were constructed from points meet only if their four
    /// points are in one plane.
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

    /// Returns true if four points are in a plane.
    fn flat(&mut self, [p, q, r, s]: [u32; 4]) -> bool {
        self.orient(p, q, r, s) == Ordering::Equal
    }

    /// Computes the sign of the Klein form of two rays after filters failed.
    ///
    /// The hyperplanes of all lines `s` contain ray `a`, and the hyperplanes of all lines `t` contain ray
    /// `b`.
    ///
    /// The form is 0 if the hyperplanes of three independent lines that meet pairwise contain both rays.
    /// These lines span a space W of three dimensions on which the form vanishes. W is its own orthogonal
    /// complement, so both rays are in W. The form is also 0 if one of the rays is a combination of lines
    /// whose hyperplanes contain the other ray ([`Space::combines`]).
    pub fn rays_side(
        &mut self,
        a: VectorId,
        s: &[VectorId],
        b: VectorId,
        t: &[VectorId],
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

    /// Returns true if three of the lines are independent and meet pairwise.
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

    /// Returns true if incidences show that an extreme ray is one of `lines` or a combination of two of
    /// `lines`.
    ///
    /// `ray` contains the lines whose hyperplanes contain the extreme ray.
    ///
    /// An extreme ray is the only ray on the hyperplanes of all lines of `ray`. So a line that meets all of
    /// them is that ray. If two lines both meet all except one common line, the extreme ray is the
    /// combination of the two whose Klein form with this line is 0.
    fn combines(&mut self, ray: &[VectorId], lines: &[VectorId]) -> bool {
        // For each line, bit k is set if the line does not meet `ray[k]`. A vector that is not a real line
        // counts as meeting no line.
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

    /// Returns, for each of three lines, the world positions of the two points from which the line was
    /// constructed. The result is `None` if a line was constructed differently or a point was not given in
    /// doubles.
    ///
    /// The frame's map of lines is linear and regular, so it keeps the rank of the lines.
    fn joins(&self, lines: [VectorId; 3]) -> Option<[[DVec3; 2]; 3]> {
        let mut ends = [[DVec3::ZERO; 2]; 3];
        for (ends, l) in ends.iter_mut().zip(lines) {
            let Origin::Join(p, q) = self.vectors[l.index()].origin else {
                return None;
            };
            *ends = self.world([p, q])?;
        }
        Some(ends)
    }

    /// Returns true if doubles show that a 3 × 3 minor of three vectors is not 0, so that the vectors are
    /// independent.
    ///
    /// No component exceeds 1, and each is off by at most its vector's error e. A minor of six products of
    /// three factors is off by 6(e + e' + e'') and terms of higher order. The roundings add 5u of each
    /// product.
    pub(super) fn surely_independent(&self, lines: [VectorId; 3]) -> bool {
        let [x, y, z] = lines.map(|l| &self.near[l.index()]);
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

    /// Returns true if three lines that meet pairwise are linearly dependent.
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
        // If two of the lines are equal, the three lines also count as dependent; callers exclude this case
        // where it matters.
        let dependent = pivot.is_none_or(|(i, j)| {
            let d = minor(i, j);
            (0..6).all(|k| (&d * &z[k] - minor(i, k) * &z[j] + minor(j, k) * &z[i]).is_zero())
        });
        self.pencils.insert(key, dependent);
        dependent
    }
}
