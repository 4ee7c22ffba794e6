//! The certificate of a view cell: a witness for each visible triangle, and proofs for the hidden ones.
//!
//! A triangle that meets the cell needs no witness, because the checker can decide that again. A triangle
//! without area is never visible and needs no proof. The bytes of a certificate are in [`crate::codec`]; the
//! conditions under which a certificate is valid are in [`crate::checker`].

use dashu_int::IBig;
use glam::Vec3;
use sightline_numbers::Aabb;

use crate::proof::Proof;

/// The reasons for the visibility set of one view cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellCertificate {
    /// Visible triangles with a witness each, ascending by triangle.
    pub seen: Vec<(u32, Witness)>,
    /// Groups of hidden triangles. No triangle is in two groups, nor in `seen`.
    pub hidden: Vec<HiddenGroup>,
    /// The certificate of a box around this cell and some later cells, if this cell stores one.
    pub shared: Option<GroupCertificate>,
    /// Where the certificate of a box around this cell is stored: that many cells before this one in the
    /// result, 0 for this cell itself. `None` if this cell relies on no such certificate.
    pub above: Option<u32>,
    /// Boxes that are hidden from the cell, around other cells of the result.
    pub apart: Vec<HiddenBox>,
}

/// A box of which no point is seen from the cell. The box and the cell share no volume and no part of a face.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenBox {
    /// The box, in scene coordinates.
    pub bounds: Aabb,
    /// As [`HiddenGroup::proofs`] for [`Target::Box`].
    pub proofs: Vec<Proof>,
}

/// The certificate of a cell group: triangles that are hidden from a box, and so from every cell in it.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupCertificate {
    /// The box, in scene coordinates.
    pub bounds: Aabb,
    /// Groups of triangles that are hidden from the box, at least one. No triangle is in two groups.
    /// [`Target::Surfaces`] and [`Target::Half`] are not allowed here.
    pub hidden: Vec<HiddenGroup>,
}

/// A segment that shows that a triangle is visible from a cell.
///
/// It crosses the interior of the triangle, and meets no other triangle before that except triangles in the
/// plane of this one.
#[derive(Clone, Debug, PartialEq)]
pub enum Witness {
    /// From a point of the cell to a point on the other side of the triangle's plane.
    Floats([Vec3; 2]),
    /// From a point of the cell to a point inside the triangle, both homogeneous (x, y, z, w) with w > 0.
    Exact(Box<[[IBig; 4]; 2]>),
}

/// Triangles that one set of proofs shows to be hidden from the cell.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenGroup {
    /// What the proofs are about.
    pub target: Target,
    /// The triangles, ascending, at least one.
    pub triangles: Vec<u32>,
    /// One proof for each pair of a face of the cell and a polygon of the target that has a part with area on
    /// the outer side of that face: by face in the order of [`faces`], then by polygon in the order of the
    /// target.
    pub proofs: Vec<Proof>,
}

/// Whether a surface of this many triangles has few enough edges with an odd number of triangles to be closed
/// by patches: at most 64, and at most one for every four triangles. The rule bounds the checker's work. It
/// is part of the definition of a surface, so the search uses it too.
pub fn few_odd_edges(odd: usize, triangles: usize) -> bool {
    odd <= 64.min(triangles / 4)
}

/// What the proofs of a [`HiddenGroup`] are about.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// The group's one triangle.
    Triangle,
    /// The group's one triangle. A closed surface hides it from one side of its plane, and the proofs start
    /// from the parts of the cell's faces on the other side.
    Half,
    /// Any number of triangles, each hidden by the closed surface that it belongs to. There are no proofs.
    Surfaces,
    /// A box that does not touch the cell and contains the triangles. Its
    /// polygons are the faces with area that face the cell, in the order of [`faces`].
    Box(Aabb),
    /// A convex flat polygon that contains the triangles, by its corners in order.
    Polygon(Box<[Vec3]>),
}

/// The six faces of a box in the order of proofs: by axis, the lesser one first. Each is its axis (0, 1, 2
/// for x, y, z) and whether it is the greater one.
pub fn faces() -> impl Iterator<Item = (usize, bool)> {
    (0..6).map(|k| (k / 2, k % 2 == 1))
}

impl CellCertificate {
    /// The reason this certificate gives for one triangle, if it gives one.
    pub fn about(&self, triangle: u32) -> Option<Reason<'_>> {
        if let Ok(at) = self.seen.binary_search_by_key(&triangle, |(t, _)| *t) {
            return Some(Reason::Seen(&self.seen[at].1));
        }
        find(&self.hidden, triangle).map(Reason::Hidden)
    }
}

impl GroupCertificate {
    /// The group that contains a triangle, if one does.
    pub fn about(&self, triangle: u32) -> Option<&HiddenGroup> {
        find(&self.hidden, triangle)
    }
}

fn find(hidden: &[HiddenGroup], triangle: u32) -> Option<&HiddenGroup> {
    hidden
        .iter()
        .find(|h| h.triangles.binary_search(&triangle).is_ok())
}

/// Why a triangle is in a cell's set, or is not.
pub enum Reason<'a> {
    /// It is visible along a segment.
    Seen(&'a Witness),
    /// It is hidden, perhaps together with other triangles.
    Hidden(&'a HiddenGroup),
}

impl Witness {
    /// Its ends, rounded to double precision.
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
