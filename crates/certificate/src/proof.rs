//! Proofs that nothing is seen: what a step can say.
//!
//! A proof for two polygons says how to take the region of lines between them apart. It names
//! triangles, and now and then a hyperplane: who checks it derives everything else from the scene, and the steps need not
//! have been found the same way. See [`crate::checker`] for what each step claims.

use dashu_int::IBig;

/// One step of a proof, in depth-first order.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// The region holds no real lines: the Klein form has one sign on all pairs of its rays.
    Unreal,
    /// The occluder blocks. The region is split along the `cuts`-th of its constraints one after the other, each outer
    /// part being the business of the steps that follow, in order; what stays inside all of them is blocked.
    Block {
        /// Index into [`Proof::occluders`].
        occluder: u32,
        /// Whether lines pass the edges on their negative side.
        negative: bool,
        /// Which constraints: border edges by number, then A's plane, then B's plane.
        cuts: Vec<u16>,
    },
    /// The region is split by the hyperplane polar to this vector of world space; the negative side follows, then the
    /// positive one.
    Split {
        /// The Plücker vector; any multiple by a positive number says the same.
        polar: Box<[IBig; 6]>,
    },
    /// The polygon `of` is divided along the line through two of its points; both halves follow, first the one that
    /// begins with `from`. Point 2i is vertex i, point 2i + 1 the middle of the edge after it.
    Divide {
        /// Which polygon.
        of: Which,
        /// Where the line comes in.
        from: u16,
        /// Where it goes out.
        to: u16,
    },
}

/// One of the polygons of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// The one lines come from.
    A,
    /// The one they go to.
    B,
}

/// A proof that B is hidden from A.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Proof {
    /// The occluders it speaks of: triangles, each with whether it is turned round.
    pub occluders: Vec<Vec<(u32, bool)>>,
    /// The steps, for each pair of parts of A and B in the order of the query, and for each region of the pair.
    pub steps: Vec<Step>,
}

impl Proof {
    /// The triangles it rests on, ascending.
    pub fn blockers(&self) -> Vec<u32> {
        let mut out: Vec<u32> = self.occluders.iter().flatten().map(|(t, _)| *t).collect();
        out.sort_unstable();
        out.dedup();
        out
    }
}
