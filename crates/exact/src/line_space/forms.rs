//! The Klein form of one vector with many vectors: with all rays of a region, and with sampled real lines
//! inside it.
//!
//! Rays are the corners of a region. The number of rays that an occluder blocks is a poor measure of the
//! blocked part of the region: an occluder in front of the middle may block no ray at all. So the search also
//! counts blocked real lines that this module samples inside the region.

use crate::arithmetic::random::Random;
use crate::line_space::cone::Region;
use crate::line_space::space::{Space, klein};

/// The number of combinations of two rays that are tried when real lines are sampled.
///
/// [`Forms::sample`] adds at least half this number of lines, or none.
const MIXED: usize = 32;

/// The vectors of a region, stored by component so that loops over them vectorise.
#[derive(Default)]
pub struct Forms {
    /// One list per Plücker coordinate: the coordinate of each ray, followed by the coordinate of each
    /// sampled line.
    columns: [Vec<f64>; 6],
    rays: usize,
    /// The mean of the rays, component by component.
    pub centre: [f64; 6],
    /// The factor of the forms in [`Forms::row`]: 1 or −1.
    pub turn: f64,
    row: Vec<f64>,
    /// For each ray, its largest form with itself and the rays after it, times `turn`. The buffer is reused.
    pub farthest: Vec<f64>,
    /// The combinations of two rays with a positive form, and the combinations with another form, each with
    /// its form. The buffer is reused.
    mixed: [Vec<(f64, [f64; 6])>; 2],
}

impl Forms {
    /// Replaces the stored rays by the rays of `region`, and removes the sampled lines.
    pub fn begin(&mut self, space: &Space, region: &Region) {
        self.columns.iter_mut().for_each(Vec::clear);
        self.rays = region.rays.len();
        let mut sum = [0.0; 6];
        for (ray, _) in &region.rays {
            for ((column, x), s) in self
                .columns
                .iter_mut()
                .zip(space.rounded(*ray))
                .zip(&mut sum)
            {
                column.push(*x);
                *s += x;
            }
        }
        self.centre = sum.map(|s| s / region.rays.len() as f64);
        self.turn = 1.0;
    }

    /// Samples real lines inside the region, adds them after the rays, and returns the number of rays and
    /// lines.
    ///
    /// Every call replaces the sampled lines by the same lines.
    ///
    /// The function adds no lines if all tried combinations of two rays are on one side of the Klein quadric.
    ///
    /// Each line is the point at which the segment between two combinations on different sides meets the
    /// quadric.
    pub fn sample(&mut self) -> usize {
        self.columns.iter_mut().for_each(|c| c.truncate(self.rays));
        let mut random = Random::new(0, 0);
        let mut any = || (random.unit() * self.rays as f64) as usize;
        let [above, below] = &mut self.mixed;
        above.clear();
        below.clear();
        for _ in 0..MIXED {
            let (i, j) = (any(), any());
            let x: [f64; 6] =
                std::array::from_fn(|k| 0.5 * (self.columns[k][i] + self.columns[k][j]));
            let form = klein(&x, &x);
            if form > 0.0 {
                above.push((form, x))
            } else {
                below.push((form, x))
            }
        }
        if above.is_empty() || below.is_empty() {
            return self.rays;
        }
        for i in 0..above.len().max(below.len()) {
            let ((c, x), (e, y)) = (above[i % above.len()], below[i % below.len()]);
            let t = crossing(c, klein(&x, &y), e);
            for (column, (x, y)) in self.columns.iter_mut().zip(x.into_iter().zip(y)) {
                column.push((1.0 - t) * x + t * y);
            }
        }
        self.columns[0].len()
    }

    /// Computes the Klein form of `line` with each ray and then with each sampled line, and writes the forms
    /// to `out`.
    pub fn against(&self, line: &[f64; 6], out: &mut Vec<f64>) {
        forms(self.columns.each_ref().map(|c| &c[..]), *line, out);
    }

    /// Computes the Klein forms of ray `i` with itself and with all rays after it, times [`Forms::turn`].
    pub fn row(&mut self, i: usize) -> &[f64] {
        let columns = self.columns.each_ref().map(|c| &c[i..self.rays]);
        let ray = columns.map(|c| self.turn * c[0]);
        forms(columns, ray, &mut self.row);
        &self.row
    }
}

/// Computes the Klein forms of one vector with many vectors, which are given as one list per coordinate.
fn forms(columns: [&[f64]; 6], with: [f64; 6], out: &mut Vec<f64>) {
    let n = columns[0].len();
    out.resize(n, 0.0);
    // The slices have equal length, so that the loop has no bounds checks and vectorises.
    let [a, b, c, d, e, f] = columns.map(|c| &c[..n]);
    let out = &mut out[..n];
    let [p, q, r, s, t, u] = with;
    for j in 0..n {
        out[j] = (p * d[j] + q * e[j] + r * f[j]) + (s * a[j] + t * b[j] + u * c[j]);
    }
}

/// Computes the t in [0, 1] at which c(1−t)² + 2m t(1−t) + e t² is 0.
///
/// c and e must have different signs.
pub fn crossing(c: f64, m: f64, e: f64) -> f64 {
    // With t = s/(1 + s), s is the positive root of e s² + 2m s + c, computed without cancellation.
    let root = (m * m - c * e).sqrt();
    let s = if (m > 0.0) == (e > 0.0) {
        -c / (m.abs() + root).copysign(e)
    } else {
        (m.abs() + root) / e.abs()
    };
    if s.is_finite() {
        (s / (1.0 + s)).clamp(0.0, 1.0)
    } else {
        1.0
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::frame::Frame;

    /// Creates the forms of a region with the given rays. The tight half-spaces of the rays do not matter
    /// here.
    fn forms_of(rays: &[[f64; 6]]) -> Forms {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p + DVec3::Z);
        let mut space = Space::new(Frame::around(&[DVec3::ZERO, DVec3::X, DVec3::Y], &corners));
        let rays = rays.iter().map(|r| (space.given(*r), 0)).collect();
        let mut forms = Forms::default();
        forms.begin(
            &space,
            &Region {
                rays,
                halves: [].into(),
            },
        );
        forms
    }

    fn axes(last: f64) -> [[f64; 6]; 6] {
        let mut rays = [[0.0; 6]; 6];
        (0..6).for_each(|k| rays[k][k] = if k == 5 { last } else { 1.0 });
        rays
    }

    #[test]
    fn sampled_lines_are_real_and_in_region() {
        let mut forms = forms_of(&axes(-1.0));
        let many = forms.sample();
        assert!(many >= 6 + MIXED / 2);
        for at in 6..many {
            let line: [f64; 6] = std::array::from_fn(|k| forms.columns[k][at]);
            assert!(klein(&line, &line).abs() < 1e-15, "{line:?}");
            assert!(
                line[..5].iter().all(|c| *c >= 0.0) && line[5] <= 0.0,
                "{line:?}"
            );
            assert!(line.iter().any(|c| *c != 0.0));
        }
        // A second call replaces the lines.
        assert_eq!(forms.sample(), many);
    }

    #[test]
    fn sample_adds_no_lines_if_form_has_one_sign() {
        let mut rays = axes(1.0);
        (0..6).for_each(|k| rays[k][(k + 3) % 6] = 0.5);
        assert_eq!(forms_of(&rays).sample(), 6);
    }
}
