//! The form factor of the visible part of a light: a convex polygon, with what hides it.

use glam::DVec3;
use sightline_geometry::convex::{Convex, ConvexError};
use sightline_geometry::rounding::UNIT as U;

use crate::blockers::Blockers;
use crate::descend::{Ends, Rays, Scratch};
use crate::items::{Items, Reach};
use crate::lambert::{Cap, cosine};
use crate::partition::{Partition, Tells};
use crate::polygon::{Corner, Plane, Side, polygon, side, split};
use crate::receivers::{Receiver, Source};

/// A light: a flat convex polygon that shines from both sides.
#[derive(Clone, Debug, PartialEq)]
pub struct Light(Convex);

impl Light {
    /// A light from its corners, in world space and in order around it. They are rounded to single precision
    /// like the scene's, so that a light that is a face of the scene lies in its plane.
    ///
    /// # Errors
    /// [`ConvexError`] when it is not a convex polygon.
    pub fn new(corners: &[[f64; 3]]) -> Result<Self, ConvexError> {
        Convex::new(corners).map(Self)
    }

    /// The corners, in world space.
    pub fn corners(&self) -> &[DVec3] {
        self.0.corners()
    }

    /// The polygon of directions from `x` to what of the light is over the horizon of `n`; none from its
    /// plane.
    fn seen_from(&self, x: DVec3, n: DVec3) -> Vec<Corner> {
        let height = self.0.normal().dot(self.corners()[0] - x);
        let most = self
            .corners()
            .iter()
            .fold(0.0f64, |m, c| m.max((*c - x).length()));
        if height.abs() <= 16.0 * U * most {
            return Vec::new();
        }
        let mut at: Vec<DVec3> = self
            .corners()
            .iter()
            .map(|c| (*c - x).normalize())
            .collect();
        // The corners turn to the left about the normal; from where it points to, as seen from outside.
        if height < 0.0 {
            at.reverse();
        }
        let corners = polygon(&at);
        let horizon = Plane {
            m: n,
            error: 4.0 * U,
        };
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
struct LightSum {
    n: DVec3,
    factor: f64,
    parts: u32,
}

impl Ends for LightSum {
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
    let own = receivers
        .first()
        .and_then(|r| r.triangle)
        .and_then(|t| blockers.of(t));
    let at = light.corners()[0] - source.origin;
    let sides = source.corners.iter().map(|s| light.0.normal().dot(at - *s));
    let (least, most) = sides.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), d| {
        (l.min(d), m.max(d))
    });
    // From both sides of the light's plane: nothing can be left out for it, and each receiver is by itself.
    if least <= source.slack && most >= -source.slack && receivers.len() > 1 {
        let one = |r: &Receiver| factors(blockers, &[*r], light, (open_above, bytes), scratch);
        return receivers.iter().flat_map(one).collect();
    }
    let normal = if most > 0.0 {
        light.0.normal()
    } else {
        -light.0.normal()
    };
    let mut items = Items::new(
        blockers,
        &source,
        Reach::Light {
            normal,
            at,
            slack: light.0.slack(),
        },
        own,
    );
    let root = items.begin(open_above);
    let mut tree = Partition::new(Tells::Union, root);
    let factor = |r: &Receiver| {
        let n = r.normal.normalize();
        let part = light.seen_from(r.point, n);
        let mut sum = LightSum {
            n,
            factor: 0.0,
            parts: 0,
        };
        let mut rays = Rays {
            tree: &mut tree,
            items: &mut items,
            source: &source,
            bytes,
            most_told: usize::MAX,
        };
        rays.begin();
        // Nothing gives it up.
        let bound = rays
            .descend(r.point - source.origin, &part, scratch, &mut sum)
            .unwrap_or(1.0);
        (
            sum.factor.max(0.0),
            bound + f64::from(sum.parts + 1) * 16.0 * U,
        )
    };
    receivers.iter().map(factor).collect()
}
