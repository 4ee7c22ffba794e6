//! Receivers, and the blocks of receivers that share a partition of rays.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;
use sightline_scene::TriangleId;

/// A point whose openness is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// The point, in world space.
    pub point: DVec3,
    /// The normal, of any length but 0. The openness refers to the hemisphere over the normal.
    pub normal: DVec3,
    /// The triangle that contains the point, if known. This triangle and the coplanar triangles joined to it
    /// are ignored.
    pub triangle: Option<TriangleId>,
}

/// The convex set S that rays start from: the hull of some corners, which contains all points of a block
/// except for a slack.
#[derive(Clone, Debug)]
pub struct ReceiverHull {
    /// The origin of coordinates: a point near the middle, which single precision can represent.
    pub origin: DVec3,
    /// The corners, relative to the origin: one for a point, two for a line, four for a flat block, otherwise
    /// eight.
    pub corners: Vec<DVec3>,
    /// Maximum distance of a receiver from the origin: the distance of the farthest corner plus the slack.
    pub radius: f64,
    /// Maximum distance of a receiver from the hull of the corners, which covers rounding errors.
    pub slack: f64,
    /// The common unit normal of all receivers, if all normals are equal.
    pub normal: Option<DVec3>,
    /// A lower bound of normal·x over the receivers x, relative to the origin.
    pub lowest: f64,
}

impl ReceiverHull {
    /// Computes the hull of some receivers.
    pub fn around(receivers: &[Receiver]) -> Self {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for r in receivers {
            (min, max) = (min.min(r.point), max.max(r.point));
        }
        let origin = ((min + max) * 0.5).as_vec3().as_dvec3();
        // The slack covers the rounding of a point's coordinates, of its difference from the origin, and of
        // the rotation to a frame and back.
        let slack =
            4.0 * U * min.abs().max(max.abs()).max_element() + 64.0 * U * (max - min).length();
        let first = receivers.first().map_or(DVec3::Z, |r| r.normal);
        let same = receivers.iter().all(|r| r.normal == first);
        let w = first.normalize();
        let (u, v) = w.any_orthonormal_pair();
        let (mut least, mut most) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for r in receivers {
            let x = r.point - origin;
            let x = DVec3::new(u.dot(x), v.dot(x), w.dot(x));
            (least, most) = (least.min(x), most.max(x));
        }
        let mut corners = vec![u * least.x + v * least.y + w * least.z];
        for (axis, size) in [u, v, w].into_iter().zip((most - least).to_array()) {
            if size > slack {
                let far: Vec<DVec3> = corners.iter().map(|c| *c + axis * size).collect();
                corners.extend(far);
            }
        }
        let radius = corners.iter().fold(0.0f64, |r, c| r.max(c.length())) + slack;
        Self {
            origin,
            corners,
            radius,
            slack,
            normal: same.then_some(w),
            lowest: least.z - slack,
        }
    }
}

/// The number of bits of a coordinate in a Morton code.
const BITS: u32 = 21;

/// Sorts receivers into blocks of at most `most` receivers, whose extent is at most `size`, in units of the
/// scene. Returns the blocks as lists of indices into `receivers`.
///
/// The receivers of a block are near each other and have equal normals. `polygon` returns the number of the
/// surface that contains a triangle; the receivers of a block are on one surface, or all on no known surface.
/// The blocks depend only on the arguments.
pub fn blocks(
    receivers: &[Receiver],
    polygon: impl Fn(TriangleId) -> Option<u32>,
    most: usize,
    size: f64,
) -> Vec<Vec<u32>> {
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for r in receivers {
        (min, max) = (min.min(r.point), max.max(r.point));
    }
    let unit = (max - min).max_element().max(f64::MIN_POSITIVE) / f64::from((1u32 << BITS) - 1);
    let spread = |x: f64| {
        let x = x as u64;
        (0..BITS).fold(0u64, |code, bit| code | (x >> bit & 1) << (3 * bit))
    };
    // Sort by polygon, then by normal, then by Morton code.
    let mut keys: Vec<(Option<u32>, [u64; 3], u64, u32)> = receivers
        .iter()
        .enumerate()
        .map(|(i, r)| {
            let on = r.triangle.and_then(&polygon);
            let at = (r.point - min) / unit;
            let code = spread(at.x) | spread(at.y) << 1 | spread(at.z) << 2;
            (on, r.normal.to_array().map(f64::to_bits), code, i as u32)
        })
        .collect();
    keys.sort_unstable();
    let mut blocks: Vec<Vec<u32>> = Vec::new();
    for group in keys.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let mut open = vec![group];
        while let Some(part) = open.pop() {
            let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            for key in part {
                let at = receivers[key.3 as usize].point;
                (min, max) = (min.min(at), max.max(at));
            }
            if part.len() <= most && ((max - min).length() <= size || part.len() == 1) {
                blocks.push(part.iter().map(|key| key.3).collect());
                continue;
            }
            // Divide at the highest bit in which the codes differ. Halve a group of equal codes.
            let (low, high) = (part[0].2, part[part.len() - 1].2);
            let at = match (low ^ high).checked_ilog2() {
                Some(bit) => part.partition_point(|key| key.2 >> bit == low >> bit),
                None => part.len() / 2,
            };
            let (before, after) = part.split_at(at);
            open.extend([after, before]);
        }
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_contain_every_receiver_once() {
        let receivers: Vec<Receiver> = (0..1000)
            .map(|i| {
                let (x, y) = (f64::from(i % 40), f64::from(i / 40));
                Receiver {
                    point: DVec3::new(x, y, 0.0),
                    normal: DVec3::Z,
                    triangle: None,
                }
            })
            .collect();
        let blocks = blocks(&receivers, |_| None, 64, 12.0);
        let mut all: Vec<u32> = blocks.iter().flatten().copied().collect();
        all.sort_unstable();
        assert!(all.iter().copied().eq(0..1000));
        assert!(blocks.iter().all(|b| b.len() <= 64));
        assert!(blocks.len() < 60, "{}", blocks.len());
    }
}
