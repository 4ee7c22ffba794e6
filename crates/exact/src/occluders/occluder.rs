//! Occluders: sets of triangles that block a region of line space, described by their boundary edges.
//!
//! Give each triangle of a set an orientation and remove every edge that two triangles run along in opposite
//! directions. The signed number of crossings of a line with the triangles depends on the remaining edges
//! only, since two surfaces with the same boundary differ by a closed surface. A line that has every
//! remaining edge on the same side, if any edge remains, winds around the boundary at least once and so
//! crosses at least one triangle. The half-spaces of the remaining edges therefore bound a region of line
//! space that the set blocks (Nirenstein 2003, section 2.4, silhouettes). The set need not be convex, flat or
//! connected. Convex flat sets block most for their number of edges, so [`super::Occluders`] merges triangles
//! into those.

use glam::Vec3;
use sightline_certificate::proof::OccluderTriangle;

/// An occluder of a scene, by its index there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OccluderId(pub u32);

/// An occluder of a scene with its winding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OrientedOccluder {
    /// The occluder.
    pub id: OccluderId,
    /// Whether the winding is the reverse of the scene's.
    pub reversed: bool,
}

/// A convex set of coplanar triangles.
#[derive(Clone, Debug)]
pub struct Occluder {
    /// The triangles, reversed where that makes all face the same way.
    pub triangles: Vec<OccluderTriangle>,
    /// The boundary edges, directed, in the order of the triangles and their edges.
    pub border: Vec<[Vec3; 2]>,
    /// The same edges by corner numbers; equal positions have equal numbers.
    pub edges: Vec<[u32; 2]>,
}

impl Occluder {
    /// The corners of its convex polygon in order, including corners on the line through their neighbours.
    pub fn outline(&self) -> Vec<Vec3> {
        let mut at = 0;
        (0..self.border.len())
            .map(|_| {
                let corner = self.border[at][0];
                // A merged face has one loop: the next edge starts where this one ends.
                at = self
                    .edges
                    .iter()
                    .position(|e| e[0] == self.edges[at][1])
                    .unwrap_or(at);
                corner
            })
            .collect()
    }
}

/// The edges that remain when opposite edges are struck out, in the order of the triangles and their edges.
pub fn border(
    members: &[OccluderTriangle],
    triangles: &[[Vec3; 3]],
    corners: &[u32],
) -> (Vec<[u32; 2]>, Vec<[Vec3; 2]>) {
    let mut left: Vec<([u32; 2], [Vec3; 2])> = Vec::new();
    for OccluderTriangle { triangle, reversed } in members {
        let (c, v) = (
            &corners[3 * *triangle as usize..],
            &triangles[*triangle as usize],
        );
        for k in 0..3 {
            let (i, j) = if *reversed {
                ((k + 1) % 3, k)
            } else {
                (k, (k + 1) % 3)
            };
            match left.iter().rposition(|(e, _)| *e == [c[j], c[i]]) {
                Some(at) => {
                    left.remove(at);
                }
                None => left.push(([c[i], c[j]], [v[i], v[j]])),
            }
        }
    }
    left.into_iter().unzip()
}
