//! Occluders: sets of triangles that block a region of line space, described by their boundary edges.
//!
//! Give each triangle of a set an orientation, and remove every edge along which two triangles run in
//! opposite directions. The signed number of crossings of a line with the triangles depends only on the
//! remaining edges, because two surfaces with the same boundary differ by a closed surface. A line that has
//! every remaining edge on the same side, if any edge remains, winds around the boundary at least once. So it
//! crosses at least one triangle. The half-spaces of the remaining edges therefore bound a region of line
//! space that the set blocks (Nirenstein 2003, section 2.4, silhouettes). The set need not be convex, flat or
//! connected. Convex flat sets block most for their number of edges, so [`super::Occluders`] merges triangles
//! into such sets.

use glam::Vec3;
use sightline_certificate::proof::OccluderTriangle;

/// An occluder of a scene, identified by its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OccluderId(pub u32);

/// An occluder of a scene, with the direction of its boundary edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OrientedOccluder {
    /// The occluder.
    pub id: OccluderId,
    /// True if the boundary edges run opposite to [`Occluder::border`].
    pub reversed: bool,
}

/// A convex set of coplanar triangles.
#[derive(Clone, Debug)]
pub struct Occluder {
    /// The triangles, each reversed if needed so that all face in the same direction.
    pub triangles: Vec<OccluderTriangle>,
    /// The directed boundary edges, in the order of the triangles and their edges.
    pub border: Vec<[Vec3; 2]>,
    /// The edges of `border` as pairs of corner numbers. Corners at equal positions have equal numbers.
    pub edges: Vec<[u32; 2]>,
}

impl Occluder {
    /// Returns the corners of the occluder's convex polygon in order.
    ///
    /// The list includes corners on the line through their neighbours.
    pub fn outline(&self) -> Vec<Vec3> {
        let mut at = 0;
        (0..self.border.len())
            .map(|_| {
                let corner = self.border[at][0];
                // A merged face has one loop: the next edge starts where this edge ends.
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

/// Returns the edges that remain after opposite edges cancel, as corner numbers and as positions. Both lists
/// are in the order of the triangles and their edges. `corners` contains three corner numbers per triangle of
/// the scene.
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
