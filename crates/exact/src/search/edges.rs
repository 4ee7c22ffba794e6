//! The lines of boundary edges in the space of a pair: all edges along one line share a vector.
//!
//! So if a ray is on the hyperplane of one edge, it is known to be on the hyperplanes of all edges along the
//! same line.

use glam::Vec3;
use rustc_hash::FxHashMap;
use sightline_geometry::predicates::collinear;

use crate::line_space::space::{Space, VectorId};
use crate::search::corners::Corners;
use crate::search::maps::with_room;

/// An edge of an occluder's border.
#[derive(Clone, Copy)]
pub struct Edge {
    /// The line that contains the edge.
    pub line: VectorId,
    /// True if the line runs opposite to the edge.
    pub flipped: bool,
}

/// The lines of all edges that were added to the space so far.
pub struct EdgeLines {
    /// The line of each edge. The key contains the edge's corner numbers, the lower number first.
    ///
    /// The flag is true if the line runs from the higher corner number to the lower.
    edges: FxHashMap<[u32; 2], (VectorId, bool)>,
    /// The lines by [`Space::fingerprint`], each with two points on the line. Equal lines are in the same
    /// bucket or in adjacent buckets.
    buckets: FxHashMap<i64, Vec<(VectorId, [Vec3; 2])>>,
}

impl EdgeLines {
    /// Creates an empty table.
    pub fn new() -> Self {
        Self {
            edges: with_room(64),
            buckets: with_room(64),
        }
    }

    /// Returns the lines of a border's edges, and adds missing lines to the space. `border` contains the
    /// corner numbers of each edge, and `ends` the positions.
    pub fn border(
        &mut self,
        space: &mut Space,
        corners: &mut Corners,
        border: &[[u32; 2]],
        ends: &[[Vec3; 2]],
    ) -> Vec<Edge> {
        border
            .iter()
            .zip(ends)
            .map(|(numbers, at)| self.edge(space, corners, *numbers, *at))
            .collect()
    }

    fn edge(
        &mut self,
        space: &mut Space,
        corners: &mut Corners,
        numbers: [u32; 2],
        [p, q]: [Vec3; 2],
    ) -> Edge {
        let back = numbers[0] > numbers[1];
        let key = if back {
            [numbers[1], numbers[0]]
        } else {
            numbers
        };
        if let Some((line, flipped)) = self.edges.get(&key) {
            return Edge {
                line: *line,
                flipped: *flipped != back,
            };
        }
        let a = corners.point(space, numbers[0], p);
        let b = corners.point(space, numbers[1], q);
        let new = space.join(a, b);
        let fingerprint = space.fingerprint(new);
        let same = (fingerprint - 1..=fingerprint + 1)
            .filter_map(|f| self.buckets.get(&f))
            .flatten()
            .find(|(_, [r, s])| collinear(*r, *s, p) && collinear(*r, *s, q));
        let (line, flipped) = match same {
            Some((line, other)) => (*line, !same_way(*other, [p, q])),
            None => {
                self.buckets
                    .entry(fingerprint)
                    .or_default()
                    .push((new, [p, q]));
                (new, false)
            }
        };
        self.edges.insert(key, (line, flipped != back));
        Edge { line, flipped }
    }
}

/// Returns true if two edges on one line run in the same direction.
fn same_way(e: [Vec3; 2], f: [Vec3; 2]) -> bool {
    (0..3).all(|k| {
        (f[1][k] > f[0][k]) == (e[1][k] > e[0][k]) && (f[1][k] < f[0][k]) == (e[1][k] < e[0][k])
    })
}
