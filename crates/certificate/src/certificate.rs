//! The certificate of a view cell: a witness for each visible triangle, and proofs for the hidden ones.
//!
//! A triangle that meets the cell needs no witness, because the checker computes the intersection itself. A
//! triangle without area is never visible and needs no proof. [`crate::codec`] describes the bytes of a
//! certificate. [`crate::checker`] describes the conditions under which a certificate is valid.

use dashu_int::IBig;
use glam::Vec3;
use sightline_numbers::Aabb;

use crate::proof::Proof;

/// The reasons for the visibility set of one view cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellCertificate {
    /// The ids of visible triangles, each with a witness, in ascending order.
    pub seen: Vec<(u32, Witness)>,
    /// The groups of hidden triangles. No triangle is in two groups, and no triangle of a group is in `seen`.
    pub hidden: Vec<HiddenGroup>,
    /// The certificate of a box around this cell and some later cells, if this cell stores one.
    pub shared: Option<GroupCertificate>,
    /// The cell that stores the certificate of a box around this cell. The value is the number of cells by
    /// which the storing cell precedes this cell in the result; 0 is this cell. `None` if this cell relies on
    /// no such certificate.
    pub above: Option<u32>,
    /// The boxes around other cells of the result that are hidden from this cell.
    pub apart: Vec<HiddenBox>,
}

/// A box whose points are all hidden from the cell. The box and the cell share no volume and no part of a
/// face.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenBox {
    /// The box, in scene coordinates.
    pub bounds: Aabb,
    /// The proofs, in the form of [`HiddenGroup::proofs`] for [`Target::Box`].
    pub proofs: Vec<Proof>,
}

/// The certificate of a cell group: triangles that are hidden from a box, and therefore from every cell in
/// it.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupCertificate {
    /// The box, in scene coordinates.
    pub bounds: Aabb,
    /// The groups of triangles that are hidden from the box, at least one. No triangle is in two groups.
    /// [`Target::Surfaces`] and [`Target::Half`] are not allowed here.
    pub hidden: Vec<HiddenGroup>,
}

/// A segment that shows that a triangle is visible from a cell.
///
/// The segment crosses the interior of the triangle. Before this crossing, the segment meets no other
/// triangle, except triangles in the plane of the shown triangle.
#[derive(Clone, Debug, PartialEq)]
pub enum Witness {
    /// A segment from a point of the cell to a point on the other side of the triangle's plane.
    Floats([Vec3; 2]),
    /// A segment from a point of the cell to a point inside the triangle. Both points are homogeneous (x, y,
    /// z, w) with w > 0.
    Exact(Box<[[IBig; 4]; 2]>),
}

/// A group of triangles that one set of proofs shows to be hidden from the cell.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenGroup {
    /// The polygons that the proofs show to be hidden.
    pub target: Target,
    /// The ids of the triangles of the group, in ascending order, at least one.
    pub triangles: Vec<u32>,
    /// The proofs, one for each pair of a face of the cell and a polygon of the target. A pair needs a proof
    /// if the polygon has a part with area on the outer side of the face. The proofs are ordered by face in
    /// the order of [`faces`], then by polygon in the order of the target.
    pub proofs: Vec<Proof>,
}

/// Returns true if a surface has few enough odd edges to be closed by patches. An odd edge belongs to an odd
/// number of triangles. A surface may have at most 64 odd edges, and at most one odd edge per four triangles.
/// The limit bounds the checker's work. The limit is part of the definition of a surface, so the search
/// applies it, too.
pub fn few_odd_edges(odd: usize, triangles: usize) -> bool {
    odd <= 64.min(triangles / 4)
}

/// The polygons that the proofs of a [`HiddenGroup`] show to be hidden.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// The group's only triangle.
    Triangle,
    /// The group's only triangle, which a closed surface hides from one side of its plane. The proofs start
    /// from the parts of the cell's faces on the other side.
    Half,
    /// Any number of triangles, each hidden by the closed surface that it belongs to. The group contains no
    /// proofs.
    Surfaces,
    /// A box that does not touch the cell and contains the triangles. The polygons are the faces of the box
    /// with area that face the cell, in the order of [`faces`].
    Box(Aabb),
    /// A convex flat polygon that contains the triangles, given by its corners in order.
    Polygon(Box<[Vec3]>),
}

/// Returns the six faces of a box in the order of proofs: by axis, the lower face first. Each face consists
/// of its axis (0, 1, 2 for x, y, z) and a flag that is true for the upper face.
pub fn faces() -> impl Iterator<Item = (usize, bool)> {
    (0..6).map(|k| (k / 2, k % 2 == 1))
}

impl CellCertificate {
    /// Returns the reason that the certificate states for one triangle, or `None` if it states no reason.
    pub fn about(&self, triangle: u32) -> Option<Reason<'_>> {
        if let Ok(at) = self.seen.binary_search_by_key(&triangle, |(t, _)| *t) {
            return Some(Reason::Seen(&self.seen[at].1));
        }
        find(&self.hidden, triangle).map(Reason::Hidden)
    }
}

impl GroupCertificate {
    /// Returns the group that contains a triangle, or `None` if no group contains it.
    pub fn about(&self, triangle: u32) -> Option<&HiddenGroup> {
        find(&self.hidden, triangle)
    }
}

fn find(hidden: &[HiddenGroup], triangle: u32) -> Option<&HiddenGroup> {
    hidden
        .iter()
        .find(|h| h.triangles.binary_search(&triangle).is_ok())
}

/// The reason why a triangle is or is not in a cell's set.
pub enum Reason<'a> {
    /// The triangle is visible along a segment.
    Seen(&'a Witness),
    /// The triangle is hidden, possibly together with other triangles.
    Hidden(&'a HiddenGroup),
}

impl Witness {
    /// Returns the ends of the witness, rounded to double precision.
    pub fn rounded(&self) -> [[f64; 3]; 2] {
        match self {
            Self::Floats(ends) => ends.map(|e| e.as_dvec3().to_array()),
            Self::Exact(ends) => {
                let [p, q] = &**ends;
                [p, q].map(|e| {
                    std::array::from_fn(|k| sightline_numbers::integer::ratio(&e[k], &e[3]))
                })
            }
        }
    }
}
