//! Proofs that one polygon is hidden from another: the steps a proof is made of.
//!
//! A proof subdivides the set of lines between two polygons until each part is blocked or empty. It names
//! triangles, edges, and sometimes a hyperplane; the checker derives everything else from the scene. The
//! search may find the steps in any way. [`crate::checker`] says what each step claims and why that is sound.

use dashu_int::IBig;

/// One step of a proof. The steps are in depth-first order.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// The region holds no open set of real lines: the Klein form has one sign on all pairs of its rays.
    Unreal,
    /// An occluder blocks. The region is split along the listed constraints, one after another. The outer
    /// part of each split is left to the steps that follow, in the order of `cuts`. The part inside all of
    /// them must be blocked by the occluder.
    Block {
        /// Index into [`Proof::occluders`].
        occluder: u32,
        /// Whether the blocked lines pass the boundary edges on their negative side.
        negative: bool,
        /// Numbers of constraints: the boundary edges come first, then the plane of A, then the plane of B.
        cuts: Vec<u16>,
    },
    /// The region is split by a hyperplane. The steps for the negative side follow, then those for the
    /// positive side.
    Split {
        /// The Plücker vector whose polar hyperplane it is. A positive multiple means the same.
        polar: Box<[IBig; 6]>,
    },
    /// A polygon is divided along the line through two of its points. The steps for both parts follow, first
    /// the part whose boundary runs from `from` to `to`. Point 2i is vertex i; point 2i + 1 is the midpoint
    /// of the edge from vertex i to vertex i + 1.
    Divide {
        /// Which polygon.
        of: Which,
        /// The first point of the line.
        from: u16,
        /// The second point of the line.
        to: u16,
    },
}

/// One of the two polygons of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// The polygon that the lines start from.
    A,
    /// The polygon that the lines lead to.
    B,
}

/// A triangle of an occluder with its winding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OccluderTriangle {
    /// Index of the triangle in the scene.
    pub triangle: u32,
    /// Whether the winding is the reverse of the scene's.
    pub reversed: bool,
}

impl From<(u32, bool)> for OccluderTriangle {
    fn from((triangle, reversed): (u32, bool)) -> Self {
        Self { triangle, reversed }
    }
}

/// A proof that polygon B is hidden from polygon A.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Proof {
    /// The occluders that [`Step::Block`] refers to.
    pub occluders: Vec<Vec<OccluderTriangle>>,
    /// The steps, for each pair of parts of A and B, and for each starting region of the pair.
    pub steps: Vec<Step>,
}

impl Proof {
    /// The triangles of all occluders, ascending and without duplicates.
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
