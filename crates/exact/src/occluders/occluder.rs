//! Occluders: sets of triangles that block together, known by the edges around them.
//!
//! Take triangles, each turned one way or the other, and strike out every edge that two of them run along in opposite
//! directions. The signed number of times a line crosses the triangles depends on what is left alone, since two
//! surfaces with the same border differ by a closed one. A line that has every remaining edge on the same side winds
//! around at least once, if any edge remains at all, and so crosses at least one of the triangles. So the remaining edges' half-spaces are the
//! region of line space the set blocks, or part of it (thesis §2.4, silhouettes), whatever its shape: nothing here needs
//! to be convex, flat or even connected to be right. Convex flat sets block most for their number of edges, and
//! those are what [`Occluders`] looks for.

use glam::Vec3;

/// A set of triangles in one plane that block together.
#[derive(Clone, Debug)]
pub struct Occluder {
    /// The triangles, each with whether it is turned round so that all face the same way.
    pub triangles: Vec<(u32, bool)>,
    /// What is left of their edges, directed, in the order of the triangles and their edges.
    pub border: Vec<[Vec3; 2]>,
    /// The same by numbers of corners, equal where positions are.
    pub edges: Vec<[u32; 2]>,
}

impl Occluder {
    /// The corners of the convex polygon it is, in order, those on the line of their neighbours among them.
    pub fn outline(&self) -> Vec<Vec3> {
        let mut at = 0;
        (0..self.border.len())
            .map(|_| {
                let corner = self.border[at][0];
                // Merged faces have one loop, which goes on where an edge ends.
                at = self.edges.iter().position(|e| e[0] == self.edges[at][1]).unwrap_or(at);
                corner
            })
            .collect()
    }
}

/// The edges that remain when opposite ones are struck out, in the order of the triangles and of their edges.
pub fn border(
    members: &[(u32, bool)],
    triangles: &[[Vec3; 3]],
    corners: &[u32],
) -> (Vec<[u32; 2]>, Vec<[Vec3; 2]>) {
    let mut left: Vec<([u32; 2], [Vec3; 2])> = Vec::new();
    for (t, turned) in members {
        let (c, v) = (&corners[3 * *t as usize..], &triangles[*t as usize]);
        for k in 0..3 {
            let (i, j) = if *turned { ((k + 1) % 3, k) } else { (k, (k + 1) % 3) };
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
