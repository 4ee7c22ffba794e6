//! The checker of proofs that one polygon is hidden from another, and of witnesses that it is visible.
//!
//! Every decision is a comparison of integers, or of floats if that comparison is exact. The checker reads
//! the scene's triangles and the certificate. From the certificate's module it uses only the types, the order
//! of a box's faces, and the limit on odd edges. None of these can make a false claim true.
//! `docs/formats/certificate.md` contains the same arguments in more detail.
//!
//! # Meaning of a proof
//!
//! A proof shows that no unobstructed line from the interior of A to the interior of B exists. Triangles are
//! closed sets, so unobstructed lines form an open set. It therefore suffices to show that no *open* set of
//! lines is unobstructed, and lines through edges or vertices do not matter. Lines are vectors of Plücker
//! coordinates in six dimensions, up to a positive factor. The Klein form of two lines is 0 if and only if
//! they meet, and its sign gives the side on which one line passes the other (Teller 1992, section 2).
//!
//! 1. *Parts.* Each polygon is cut along the plane of the other, so each part is on one side of the other's
//!    plane. Every line between the polygons runs between two parts. Polygons in one plane leave no open set
//!    of lines.
//! 2. *Start.* (Σλᵢaᵢ) ∧ (Σμⱼbⱼ) = Σλᵢμⱼ(aᵢ ∧ bⱼ), so every line from A to B is a positive combination of the
//!    lines through pairs of vertices. The cone of these lines contains every line from A to B. If the
//!    intersection k of both planes occurs among them in both directions, the cone contains the whole line
//!    spanned by k. Then take the hyperplane of a line from a vertex of A off B's plane to a vertex of B off
//!    A's plane, which does not meet k. This hyperplane divides the cone into two pointed cones.
//! 3. *Block.* An occluder blocks a cone if each extreme ray satisfies the occluder's constraints. The next
//!    section proves this.
//! 4. *Unreal.* Suppose that the Klein form is never negative (or never positive) on two rays of a cone. A
//!    vector in the interior is a positive combination of all rays, so the form with itself is 0 only if it
//!    is 0 on every two rays. But rays that span six dimensions cannot all be orthogonal in a form that is
//!    not degenerate. So the interior contains no vector with form 0, and these vectors are the real lines.
//! 5. *Split and Divide.* A hyperplane divides a cone into two parts, and a line divides a polygon into two
//!    parts. If the claim holds for both parts, it holds for the whole, up to a set of lines that is not
//!    open.
//!
//! # Proof that an occluder blocks
//!
//! An occluder is a list of triangles, each with a winding. Cancel every pair of edges that two triangles
//! traverse in opposite directions. The remaining directed edges are the *boundary edges* (the silhouette
//! edges of Nirenstein 2003, section 2.4). They are the boundary of a chain of triangles and therefore form
//! closed loops.
//!
//! Claim: if there is at least one boundary edge, a line that passes every boundary edge on the same side
//! meets a triangle of the occluder. Proof: project along the line onto a plane. The line becomes a point o,
//! and the boundary becomes a set of closed loops that avoid o. The sign of the Klein form with an edge
//! determines whether the projected edge turns around o counter-clockwise or clockwise. All edges turn in the
//! same direction, none by the angle 0, so the winding number of the loops around o is not 0. If no triangle
//! met the line, the projected triangles would be a chain in the plane without o, with these loops as its
//! boundary, and the winding number would be 0. So a triangle meets the line. The argument does not require
//! the occluder to be convex, flat, connected, or free of self-intersections. A triangle without area meets
//! no open set of lines.
//!
//! The crossing must also be between A and B. If no vertex of the occluder is on the far side of A's plane,
//! as seen from B, the crossing is beyond A; the same holds for B. Otherwise the occluder must lie in one
//! plane and its triangles must face the same direction. Let a be A's plane with B on its positive side, b
//! the occluder's plane, and k their intersection. For a line through p and q the Klein form with k is
//! a(p)b(q) − a(q)b(p). With p on b this is a(p)b(q): its sign is the direction in which the line crosses the
//! occluder times the side of A's plane that contains the crossing. The boundary edges fix the direction. So
//! one more constraint, the line k with the sign of the boundary edges, puts the crossing on B's side of A's
//! plane. The checker rejects a triangle in the plane of A or B.
//!
//! Both kinds of constraint are linear. If every extreme ray of a cone satisfies them weakly, every vector in
//! the interior of the cone satisfies them strictly.

mod boxes;
mod cell;
mod cone;
mod geometry;
mod group;
mod hidden;
mod occluder;
mod polygon;
mod start;
mod surfaces;
#[cfg(test)]
mod tests;
mod tree;
mod triangles;
mod vector;
mod witness;

use dashu_int::IBig;
use glam::DVec3;

pub use cell::{CellClaims, CellRefusal, Claim, check_box_claim, check_cell, check_cell_until};
pub use hidden::check_hidden;
pub use triangles::{Kinds, Triangles};
pub use witness::check_witness;

/// The reason why the checker rejects a proof or a witness.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The proof ends before all regions are covered, or continues after that.
    #[error("the proof has {0} steps")]
    Length(&'static str),
    /// An occluder contains a triangle that is not in the scene, has no boundary edge, or has a boundary edge
    /// without length.
    #[error(
        "occluder {0} is invalid: a triangle is not in the scene or does not block, or the \
         boundary is empty or degenerate"
    )]
    Occluder(usize),
    /// A polygon of the query is not convex or not flat, or has no area.
    #[error("a polygon of the query is not convex and flat, or a corner does not have w > 0")]
    Polygon,
    /// The lines between two polygons do not span a region of line space. The lines between valid polygons
    /// always do.
    #[error("the lines between two polygons do not span a region of line space")]
    Start,
    /// A step refers to an item that does not exist.
    #[error("step {step} refers to {what} that does not exist")]
    Unknown {
        /// The index of the step.
        step: usize,
        /// The missing item, as a noun phrase for the message.
        what: &'static str,
    },
    /// A step makes a false claim.
    #[error("step {step}: {what}")]
    False {
        /// The index of the step.
        step: usize,
        /// The reason why the claim is false.
        what: &'static str,
    },
    /// The witness does not start inside A or end inside B, or meets a triangle.
    #[error("{0}")]
    Witness(String),
}

/// The corners of a convex flat polygon in order, homogeneous (x, y, z, w) with w > 0.
pub type Corners = Vec<[IBig; 4]>;

/// Converts corners in double precision to exact points.
pub fn corners(points: &[DVec3]) -> Corners {
    points
        .iter()
        .map(|p| geometry::point(p.to_array()))
        .collect()
}
