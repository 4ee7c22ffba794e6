//! Equal positions of triangle corners, and edges that two triangles share.

use glam::DVec3;
use sightline_scene::{Triangle, TriangleId};

/// Numbers the distinct positions of triangle corners, and returns the position number of each corner of each
/// triangle.
///
/// Positions that are equal bit for bit, except for the sign of a zero, have the same number. The numbers
/// follow the order of the coordinates' bits.
pub(crate) fn places(triangles: &[Triangle]) -> Vec<[u32; 3]> {
    let bits = |v: glam::Vec3| (v + glam::Vec3::ZERO).to_array().map(f32::to_bits);
    let corners = triangles.iter().flat_map(|t| t.v).map(bits);
    // Triangle ids have 32 bits, so indices of corners need more.
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

/// An edge of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Edge {
    /// The numbers of the points at the edge's ends, the smaller number first.
    pub ends: [u32; 2],
    /// The id of the triangle.
    pub triangle: TriangleId,
    /// The index of the triangle's corner at the first end, from 0 to 2.
    pub from: u8,
    /// The index of the triangle's corner at the second end, from 0 to 2.
    pub to: u8,
}

/// Returns the pairs of coincident edges of two triangles, for edges that exactly two triangles share.
///
/// `places` contains the number of the point at each corner of each triangle, such as a position number or
/// the index of an unknown.
pub(crate) fn pairs(places: &[[u32; 3]]) -> Vec<[Edge; 2]> {
    let mut edges = Vec::with_capacity(places.len() * 3);
    for (triangle, at) in (0u32..).map(TriangleId).zip(places) {
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

/// Computes the normal of a triangle by its winding, with a length of twice the area.
pub(crate) fn cross(triangle: &Triangle) -> DVec3 {
    let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
    (b - a).cross(c - a)
}
