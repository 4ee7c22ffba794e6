//! Evidence of what was decided about a view cell: a witness for every triangle seen, and proofs for what is hidden.
//!
//! What meets the cell needs none: V(C) = I(C) ∪ V(∂C), and whether a triangle meets a box can be decided again. Degenerate
//! triangles are never visible. How evidence is kept in bytes is in [`codec`]; what makes it valid, in
//! [`crate::checker::check_cell`].

pub mod codec;

use dashu_int::IBig;
use glam::Vec3;

use crate::proof::Proof;

/// Everything decided about one view cell, with the reasons.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Witnesses, ascending by triangle.
    pub seen: Vec<(u32, Witness)>,
    /// What is hidden; no triangle is in two of them, nor in one of those above.
    pub hidden: Vec<Hidden>,
    /// What is hidden from a box around this cell and some after it.
    pub shared: Option<Shared>,
    /// The cell so many before this one in the result, 0 for this one, keeps what is hidden from a box around both.
    pub above: Option<u32>,
}

/// What is hidden from all of a box, and so from all cells in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Shared {
    /// The box, by its least and greatest corner.
    pub bounds: [Vec3; 2],
    /// What is hidden from it, at least one; no triangle is in two of them. Nothing is hidden by [`Target::Surfaces`] or [`Target::Half`] here.
    pub hidden: Vec<Hidden>,
}

/// A segment from the cell through the inside of a triangle that meets no other triangle, but for those in its plane.
#[derive(Clone, Debug, PartialEq)]
pub enum Witness {
    /// From a point of the cell to one beyond the triangle.
    Floats([Vec3; 2]),
    /// From a point of the cell's surface to one inside the triangle, homogeneous with w > 0.
    Exact(Box<[[IBig; 4]; 2]>),
}

/// Triangles that are hidden from the cell, together.
#[derive(Clone, Debug, PartialEq)]
pub struct Hidden {
    /// What was shown to be hidden.
    pub target: Target,
    /// The triangles, ascending; at least one. For a box those in it about which nothing else was known.
    pub triangles: Vec<u32>,
    /// A proof for each pair of a face of the cell and a polygon of the target between which lines can run, in the order of the
    /// faces ([`faces`]) and, for each, of the target's polygons.
    pub proofs: Vec<Proof>,
}

/// Whether a surface of so many triangles has few enough edges with an odd number of triangles to be closed by patches
/// (`surfaces`): at most 64, and at most one for four triangles.
pub fn few_odd_edges(odd: usize, triangles: usize) -> bool {
    odd <= 64.min(triangles / 4)
}

/// What proofs are about.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// The one triangle.
    Triangle,
    /// The one triangle; from one side of its plane it is hidden by the closed surface it is part of, and the proofs are about what
    /// of the cell's faces is on the other side.
    Half,
    /// Any number of triangles, each by the closed surface it is part of (`surfaces`); there are no proofs.
    Surfaces,
    /// A box that does not touch the cell, by its least and greatest corner: its polygons are the faces that face the cell.
    Box([Vec3; 2]),
    /// A convex flat polygon, by its corners in order: triangles that lie in it.
    Polygon(Box<[Vec3]>),
}

/// The faces of a box in the order proofs come in: axis by axis, the lesser first; each as axis and whether it is the greater.
pub fn faces() -> impl Iterator<Item = (usize, bool)> {
    (0..6).map(|k| (k / 2, k % 2 == 1))
}

impl Evidence {
    /// The evidence about one triangle.
    pub fn about(&self, triangle: u32) -> Option<Reason<'_>> {
        if let Ok(at) = self.seen.binary_search_by_key(&triangle, |(t, _)| *t) {
            return Some(Reason::Seen(&self.seen[at].1));
        }
        find(&self.hidden, triangle).map(Reason::Hidden)
    }
}

impl Shared {
    /// The evidence about one triangle.
    pub fn about(&self, triangle: u32) -> Option<&Hidden> {
        find(&self.hidden, triangle)
    }
}

fn find(hidden: &[Hidden], triangle: u32) -> Option<&Hidden> {
    hidden.iter().find(|h| h.triangles.binary_search(&triangle).is_ok())
}

/// Why a triangle is in a cell's set, or is not.
pub enum Reason<'a> {
    /// It is seen along a segment.
    Seen(&'a Witness),
    /// It is hidden, perhaps with others.
    Hidden(&'a Hidden),
}

impl Witness {
    /// Its ends, rounded to doubles.
    pub fn rounded(&self) -> [[f64; 3]; 2] {
        match self {
            Self::Floats(ends) => ends.map(|e| e.as_dvec3().to_array()),
            Self::Exact(ends) => {
                let [p, q] = &**ends;
                [p, q].map(|e| std::array::from_fn(|k| sightline_numbers::integer::ratio(&e[k], &e[3])))
            }
        }
    }
}
