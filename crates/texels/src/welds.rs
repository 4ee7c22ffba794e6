//! Which corners of triangles are at the same place, and which edges two triangles share.

use glam::DVec3;
use sightline_scene::Triangle;

/// For each corner of each triangle the number of its place. Places that are equal bit for bit, but for the
/// sign of a zero, have the same number; numbers follow the order of coordinates.
pub(crate) fn places(triangles: &[Triangle]) -> Vec<[u32; 3]> {
    let bits = |v: glam::Vec3| (v + glam::Vec3::ZERO).to_array().map(f32::to_bits);
    let corners = triangles.iter().flat_map(|t| t.v).map(bits);
    // Triangles are numbered in 32 bits, their corners not.
    let mut order: Vec<([u32; 3], u64)> = corners.zip(0u64..).collect();
    order.sort_unstable();
    let mut places = vec![[0u32; 3]; triangles.len()];
    let mut number = 0u32;
    for (i, (at, corner)) in order.iter().enumerate() {
        if i > 0 && order[i - 1].0 != *at {
            number += 1;
        }
        places[(corner / 3) as usize][(corner % 3) as usize] = number;
    }
    places
}

/// An edge of a triangle: from a corner to the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Edge {
    /// The places of its ends, the smaller one first.
    pub ends: [u32; 2],
    /// The triangle.
    pub triangle: u32,
    /// The corner at the first of the ends.
    pub from: u8,
    /// The corner at the other one.
    pub to: u8,
}

/// Pairs of edges of two triangles that lie upon each other, for edges that exactly two triangles share.
pub(crate) fn pairs(places: &[[u32; 3]]) -> Vec<[Edge; 2]> {
    let mut edges = Vec::with_capacity(places.len() * 3);
    for (triangle, at) in (0u32..).zip(places) {
        for (from, to) in [(0u8, 1u8), (1, 2), (2, 0)] {
            let ends = [at[usize::from(from)], at[usize::from(to)]];
            if ends[0] < ends[1] {
                edges.push(Edge {
                    ends,
                    triangle,
                    from,
                    to,
                });
            } else if ends[0] > ends[1] {
                edges.push(Edge {
                    ends: [ends[1], ends[0]],
                    triangle,
                    from: to,
                    to: from,
                });
            }
        }
    }
    edges.sort_unstable();
    edges
        .chunk_by(|a, b| a.ends == b.ends)
        .filter_map(|group| <[Edge; 2]>::try_from(group).ok())
        .filter(|[a, b]| a.triangle != b.triangle)
        .collect()
}

/// Twice the area of a triangle times its normal by the winding.
pub(crate) fn cross(triangle: &Triangle) -> DVec3 {
    let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
    (b - a).cross(c - a)
}
