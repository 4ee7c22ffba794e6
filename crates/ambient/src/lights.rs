//! The form factor of the visible part of a light: a convex polygon, partly hidden by occluders.

use glam::DVec3;
use sightline_geometry::convex::{Convex, ConvexError};
use sightline_geometry::rounding::UNIT as U;

use crate::blockers::Blockers;
use crate::descent::{PartSink, RayPartition, Scratch};
use crate::items::{HidingRange, Items};
use crate::lambert::{Cap, cosine};
use crate::partition::{Partition, PartitionUse};
use crate::polygon::{Corner, Plane, Side, polygon, side, split};
use crate::receivers::{Receiver, ReceiverHull};

/// A light: a flat convex polygon that shines from both sides.
#[derive(Clone, Debug, PartialEq)]
pub struct Light(Convex);

impl Light {
    /// Creates a light from its corners, in world space and in order around the polygon.
    ///
    /// The corners are rounded to single precision like the corners of the scene. So a light that is a face
    /// of the scene lies in the plane of that face.
    ///
    /// # Errors
    /// [`ConvexError`] if the corners do not form a convex polygon.
    pub fn new(corners: &[[f64; 3]]) -> Result<Self, ConvexError> {
        Convex::new(corners).map(Self)
    }

    /// Returns the corners, in world space.
    pub fn corners(&self) -> &[DVec3] {
        self.0.corners()
    }

    /// Computes the polygon of directions from the point `x` to the part of the light above the horizon of
    /// the normal `n`. The polygon is empty if `x` lies in the light's plane.
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
        // The corners run counter-clockwise about the normal. For a point on the normal's side, this order is
        // clockwise as seen from outside the sphere.
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

/// The sum of the form factors of the visible parts of a light.
struct LightSum {
    n: DVec3,
    factor: f64,
    parts: u32,
}

impl PartSink for LightSum {
    fn free(&mut self, part: &[Corner], _: &[Cap]) {
        self.factor += cosine(self.n, part);
        self.parts += 1;
    }

    fn met(&mut self, _: u32, _: &[Corner]) {}
}

/// Computes the form factor of a light from each receiver of one block, with a bound on its rounding error.
///
/// Boxes with a solid angle of more than `open_above` steradians are opened first. `bytes` is the maximum
/// memory of the partition and its items.
pub fn factors(
    blockers: &Blockers,
    receivers: &[Receiver],
    light: &Light,
    open_above: f64,
    bytes: usize,
    scratch: &mut Scratch,
) -> Vec<(f64, f64)> {
    let source = ReceiverHull::around(receivers);
    let own = receivers
        .first()
        .and_then(|r| r.triangle)
        .and_then(|t| blockers.triangle_surface(t));
    let at = light.corners()[0] - source.origin;
    let sides = source.corners.iter().map(|s| light.0.normal().dot(at - *s));
    let (least, most) = sides.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), d| {
        (l.min(d), m.max(d))
    });
    // The receivers lie on both sides of the light's plane, so the plane excludes no item. Each receiver is
    // solved separately.
    if least <= source.slack && most >= -source.slack && receivers.len() > 1 {
        let one = |r: &Receiver| factors(blockers, &[*r], light, open_above, bytes, scratch);
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
        HidingRange::Light {
            normal,
            at,
            slack: light.0.slack(),
        },
        own,
    );
    let root = items.begin(open_above);
    let mut tree = Partition::new(PartitionUse::Union, root);
    let factor = |r: &Receiver| {
        let n = r.normal.normalize();
        let part = light.seen_from(r.point, n);
        let mut sum = LightSum {
            n,
            factor: 0.0,
            parts: 0,
        };
        let mut rays = RayPartition {
            tree: &mut tree,
            items: &mut items,
            source: &source,
            bytes,
            most_told: usize::MAX,
        };
        rays.begin();
        // `most_told` is unlimited, so the descent always completes.
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
