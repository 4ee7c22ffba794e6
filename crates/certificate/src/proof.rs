//! Proofs that one polygon is hidden from another, and the steps of a proof.
//!
//! A proof subdivides the set of lines between two polygons until each part is blocked or empty. A proof
//! names triangles, edges, and sometimes a hyperplane; the checker derives all other data from the scene. The
//! search may find the steps in any way. [`crate::checker`] documents the claim of each step and the reason
//! why it is sound.

use dashu_int::IBig;

/// One step of a proof. The steps are in depth-first order.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// The region contains no open set of real lines: the Klein form does not have both signs on pairs of the
    /// region's rays.
    Unreal,
    /// An occluder blocks the region. Each listed constraint splits the region, one after another. The next
    /// steps prove the outer part of each split, in the order of `cuts`. The occluder must block the part
    /// inside all constraints.
    Block {
        /// The index into [`Proof::occluders`].
        occluder: u32,
        /// True if the blocked lines pass the boundary edges on their negative side.
        negative: bool,
        /// The numbers of constraints: first the boundary edges, then the plane of A, then the plane of B.
        cuts: Vec<u16>,
    },
    /// A hyperplane splits the region. The steps for the negative side follow, then the steps for the
    /// positive side.
    Split {
        /// The Plücker vector to which the hyperplane is polar. A positive multiple gives the same
        /// hyperplane.
        polar: Box<[IBig; 6]>,
    },
    /// The line through two points on the border of a polygon divides the polygon. The steps for both parts
    /// follow, first for the part whose boundary runs from `from` to `to`. Point 2i is vertex i; point 2i + 1
    /// is the midpoint of the edge from vertex i to vertex i + 1.
    Divide {
        /// The polygon that the line divides.
        polygon: QueryPolygon,
        /// The number of the first point on the line.
        from: u16,
        /// The number of the second point on the line.
        to: u16,
    },
}

/// One of the two polygons of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueryPolygon {
    /// The polygon that the lines start from.
    A,
    /// The polygon that the lines lead to.
    B,
}

/// A triangle of an occluder, with its winding: the order of its corners.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OccluderTriangle {
    /// The index of the triangle in the scene.
    pub triangle: u32,
    /// True if the occluder uses the triangle's corners in the reverse order of the scene.
    pub reversed: bool,
}

impl From<(u32, bool)> for OccluderTriangle {
    fn from(member: (u32, bool)) -> Self {
        let (triangle, reversed) = member;
        Self { triangle, reversed }
    }
}

/// A proof that polygon B is hidden from polygon A.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Proof {
    /// The occluders that [`Step::Block`] refers to, each as its triangles.
    pub occluders: Vec<Vec<OccluderTriangle>>,
    /// The steps, for each pair of parts of A and B, and for each starting region of the pair.
    pub steps: Vec<Step>,
}

impl Proof {
    /// Returns the triangles of all occluders, ascending and without duplicates.
    pub fn blockers(&self) -> Vec<u32> {
        let mut out: Vec<u32> = self
            .occluders
            .iter()
            .flatten()
            .map(|t| t.triangle)
            .collect();
        out.sort_unstable();
        out.dedup();
        out
    }
}
