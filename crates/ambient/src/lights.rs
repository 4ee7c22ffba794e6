//! The form factor of the visible part of a light: a convex polygon, with what hides it.

use glam::DVec3;

use crate::blockers::Blockers;
use crate::descend::{Ends, Rays, Scratch};
use crate::items::{Items, Reach};
use crate::lambert::{Cap, cosine};
use crate::partition::{Partition, Tells};
use crate::polygon::{Corner, Plane, Side, polygon, side, split};
use crate::receivers::{Receiver, Source, U};

/// A light that is no convex polygon.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LightError {
    /// Fewer than three corners, or too many.
    #[error("it has {0} corners; give a convex polygon of 3 to {MOST_CORNERS}")]
    Corners(usize),
    /// A coordinate that is not a number that single precision can hold.
    #[error("corner {0} is not finite; give three numbers below 3·10³⁸")]
    NotFinite(usize),
    /// Its corners lie on a line.
    #[error("it has no area; its corners lie on one line or are equal")]
    Flat,
    /// A corner is off the plane of the others.
    #[error("corner {0} is not in the plane of the others; divide the light into flat polygons")]
    Bent(usize),
    /// It turns both ways, or more than once.
    #[error(
        "it is not convex at corner {0}; divide it into convex polygons, with corners in order around each"
    )]
    NotConvex(usize),
}

/// Most corners of a light.
pub const MOST_CORNERS: usize = 1024;

/// A light: a flat convex polygon that shines from both sides.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    corners: Vec<DVec3>,
    normal: DVec3,
    /// How far corners are off the plane because they are rounded to single precision, as those of the scene
    /// are.
    slack: f64,
}

impl Light {
    /// A light from its corners, in world space and in order around it. They are rounded to single precision
    /// like the scene's, so that a light that is a face of the scene lies in its plane.
    ///
    /// # Errors
    /// [`LightError`] when it is not a convex polygon.
    pub fn new(corners: &[[f64; 3]]) -> Result<Self, LightError> {
        if !(3..=MOST_CORNERS).contains(&corners.len()) {
            return Err(LightError::Corners(corners.len()));
        }
        let corners: Vec<DVec3> = corners.iter().map(|c| DVec3::from(*c).as_vec3().as_dvec3()).collect();
        if let Some(k) = corners.iter().position(|c| !c.is_finite()) {
            return Err(LightError::NotFinite(k));
        }
        let n = corners.len();
        let area: DVec3 =
            (1..n - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
        // Half a unit in the last place of single precision at each corner, and as much at those of a scene.
        let most = corners.iter().fold(0.0f64, |m, c| m.max(c.abs().max_element()));
        let slack = 4.0 * f64::from(f32::EPSILON) * most;
        let Some(normal) = area.try_normalize() else { return Err(LightError::Flat) };
        if let Some(k) = corners.iter().position(|c| normal.dot(*c - corners[0]).abs() > slack) {
            return Err(LightError::Bent(k));
        }
        let mut turns = 0.0;
        for k in 0..n {
            let (a, b, c) = (corners[(k + n - 1) % n], corners[k], corners[(k + 1) % n]);
            let (p, q) = (b - a, c - b);
            let turn = normal.dot(p.cross(q));
            // A corner that is off by the slack turns an edge by slack / length.
            if turn < -slack * (p.length() + q.length())
                || p == DVec3::ZERO
                || (turn <= 0.0 && p.dot(q) < 0.0)
            {
                return Err(LightError::NotConvex(k));
            }
            turns += libm::atan2(turn, p.dot(q));
        }
        if turns > 3.0 * std::f64::consts::PI {
            return Err(LightError::NotConvex(0));
        }
        Ok(Self { corners, normal, slack })
    }

    /// The corners, in world space.
    pub fn corners(&self) -> &[DVec3] {
        &self.corners
    }

    /// The polygon of directions from `x` to what of the light is over the horizon of `n`; none from its
    /// plane.
    fn seen_from(&self, x: DVec3, n: DVec3) -> Vec<Corner> {
        let height = self.normal.dot(self.corners[0] - x);
        let most = self.corners.iter().fold(0.0f64, |m, c| m.max((*c - x).length()));
        if height.abs() <= 16.0 * U * most {
            return Vec::new();
        }
        let mut at: Vec<DVec3> = self.corners.iter().map(|c| (*c - x).normalize()).collect();
        // The corners turn to the left about the normal; from where it points to, as seen from outside.
        if height < 0.0 {
            at.reverse();
        }
        let corners = polygon(&at);
        let horizon = Plane { m: n, error: 4.0 * U };
        let mut values = Vec::new();
        match side(&horizon, &corners, &mut values) {
            Side::Inside(_) => corners,
            Side::Outside(_) => Vec::new(),
            Side::Both => {
                let (mut above, mut below) = (Vec::new(), Vec::new());
                split(&horizon, &corners, &values, &mut above, &mut below);
                above
            }
        }
    }
}

/// Adds up what is seen of a light.
struct Sum {
    n: DVec3,
    factor: f64,
    parts: u32,
}

impl Ends for Sum {
    fn free(&mut self, part: &[Corner], _: &[Cap]) {
        self.factor += cosine(self.n, part);
        self.parts += 1;
    }

    fn met(&mut self, _: u32, _: &[Corner]) {}
}

/// The form factors of a light from the receivers of one block, each with the bound on what rounding can have
/// changed.
pub fn factors(
    blockers: &Blockers,
    receivers: &[Receiver],
    light: &Light,
    (open_above, bytes): (f64, usize),
    scratch: &mut Scratch,
) -> Vec<(f64, f64)> {
    let source = Source::around(receivers);
    let own = receivers.first().and_then(|r| r.triangle).and_then(|t| blockers.of(t));
    let at = light.corners[0] - source.origin;
    let sides = source.corners.iter().map(|s| light.normal.dot(at - *s));
    let (least, most) = sides.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), d| (l.min(d), m.max(d)));
    // From both sides of the light's plane: nothing can be left out for it, and each receiver is by itself.
    if least <= source.slack && most >= -source.slack && receivers.len() > 1 {
        let one = |r: &Receiver| factors(blockers, &[*r], light, (open_above, bytes), scratch);
        return receivers.iter().flat_map(one).collect();
    }
    let normal = if most > 0.0 { light.normal } else { -light.normal };
    let mut items = Items::new(blockers, &source, Reach::Light { normal, at, slack: light.slack }, own);
    let root = items.begin(open_above);
    let mut tree = Partition::new(Tells::Union, root);
    let factor = |r: &Receiver| {
        let n = r.normal.normalize();
        let part = light.seen_from(r.point, n);
        let mut sum = Sum { n, factor: 0.0, parts: 0 };
        let mut rays =
            Rays { tree: &mut tree, items: &mut items, source: &source, bytes, most_told: usize::MAX };
        // Nothing gives it up.
        let bound = rays.descend(r.point - source.origin, &part, scratch, &mut sum).unwrap_or(1.0);
        (sum.factor.max(0.0), bound + f64::from(sum.parts + 1) * 16.0 * U)
    };
    receivers.iter().map(factor).collect()
}
