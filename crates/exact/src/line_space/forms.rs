//! The Klein form of one vector with many: with all rays of a region, and with sampled real lines inside it.
//!
//! Rays are the corners of a region. The number of rays that an occluder blocks says little about how much of
//! the region it blocks: an occluder in front of the middle may block no ray at all. Real lines inside the
//! region are therefore counted as well.

use crate::arithmetic::random::Random;
use crate::line_space::cone::Region;
use crate::line_space::space::{Space, klein};

/// Combinations of two rays that are tried when real lines are sampled. Sampling gives at least half this
/// number of lines, or none.
const MIXED: usize = 32;

/// The vectors of a region, stored by component so that loops over them vectorise.
#[derive(Default)]
pub struct Forms {
    /// The components of all rays, followed by those of the sampled lines.
    columns: [Vec<f64>; 6],
    rays: usize,
    /// The mean of the rays.
    pub centre: [f64; 6],
    /// The factor of the forms in [`Forms::row`]: 1 or −1.
    pub turn: f64,
    row: Vec<f64>,
    /// For each ray, its greatest form with itself and the rays after it; kept to reuse its memory.
    pub farthest: Vec<f64>,
    /// Combinations of rays on either side of the quadric, with their forms; kept to reuse the memory.
    mixed: [Vec<(f64, [f64; 6])>; 2],
}

impl Forms {
    /// Starts with another region.
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

    /// Adds real lines inside the region, the same on every call; adds none if all combinations are on one
    /// side of the quadric. Returns the number of rays and lines.
    ///
    /// Each line is the point in which the segment between combinations on different sides meets the quadric.
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

    /// The forms of all rays, and of the lines sampled so far, with a line.
    pub fn against(&self, line: &[f64; 6], out: &mut Vec<f64>) {
        forms(self.columns.each_ref().map(|c| &c[..]), *line, out);
    }

    /// The forms of ray `i` with itself and all rays after it.
    pub fn row(&mut self, i: usize) -> &[f64] {
        let columns = self.columns.each_ref().map(|c| &c[i..self.rays]);
        let ray = columns.map(|c| self.turn * c[0]);
        forms(columns, ray, &mut self.row);
        &self.row
    }
}

/// The forms of one vector with many, given by columns.
fn forms(columns: [&[f64]; 6], with: [f64; 6], out: &mut Vec<f64>) {
    let n = columns[0].len();
    out.resize(n, 0.0);
    // Slices of equal length, so that the loop has no bounds checks and vectorises.
    let [a, b, c, d, e, f] = columns.map(|c| &c[..n]);
    let out = &mut out[..n];
    let [p, q, r, s, t, u] = with;
    for j in 0..n {
        out[j] = (p * d[j] + q * e[j] + r * f[j]) + (s * a[j] + t * b[j] + u * c[j]);
    }
}

/// The t in [0, 1] at which c(1−t)² + 2m t(1−t) + e t² vanishes, c and e having different signs.
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

    /// The forms of a region with these rays; their tight half-spaces do not matter here.
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
    fn lines_are_real_and_in_the_region() {
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
    fn there_are_none_where_the_form_has_one_sign() {
        let mut rays = axes(1.0);
        (0..6).for_each(|k| rays[k][(k + 3) % 6] = 0.5);
        assert_eq!(forms_of(&rays).sample(), 6);
    }
}
