//! The sources of a view cell's lines: its faces, or the parts of its faces that contain viewpoints.
//!
//! Viewpoints may be in only a part of the cell. The part must contain every free segment in the cell that
//! begins in it. A region bounded by walls fulfils this condition, and so does a box without the walls in its
//! faces. A line from a viewpoint then leaves the cell through the part of a face that belongs to the region.
//! So the triangles visible from the part are the triangles that meet it and the triangles visible from its
//! parts of the faces.

use glam::Vec3;
use sightline_certificate::certificate::faces;
use sightline_numbers::Aabb;

use crate::arithmetic::random::Random;
use crate::geometry::Cell;
use crate::geometry::polygon::Polygon;

/// The part of space that contains viewpoints.
///
/// Within a cell, an unobstructed segment that begins in the region must not leave the region.
pub trait ExactViewRegion: Sync {
    /// Returns true if a point of the cell is a viewpoint.
    fn hold(&self, point: Vec3) -> bool;
    /// Returns the parts of a cell's face through which unobstructed segments from viewpoints leave the cell.
    fn parts(&self, face: &Polygon) -> Vec<Polygon>;
    /// Returns true if a triangle shares an area with the closed region within the closed box `within`.
    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool;
}

/// A view cell with the parts of its faces through which lines leave.
pub struct Sources<'a> {
    cell: Cell,
    region: Option<&'a dyn ExactViewRegion>,
    /// For each face of the cell, in the order of [`faces`], the parts through which lines leave.
    faces: [Vec<Polygon>; 6],
}

impl<'a> Sources<'a> {
    /// Creates the sources of a cell: its faces, or the parts of its faces in `region`.
    pub fn new(cell: Cell, region: Option<&'a dyn ExactViewRegion>) -> Self {
        let mut all = faces().map(|(axis, up)| {
            let face = Polygon::face_of(cell.bounds(), axis, up);
            match region {
                None => vec![face],
                Some(region) => region.parts(&face),
            }
        });
        let faces = std::array::from_fn(|_| all.next().unwrap_or_default());
        Self {
            cell,
            region,
            faces,
        }
    }

    /// Returns the cell.
    pub fn cell(&self) -> Cell {
        self.cell
    }

    /// Iterates over the faces of the cell.
    ///
    /// Each item contains the axis that the face is perpendicular to, a flag that is true for the upper face,
    /// and the parts of the face.
    pub fn faces(&self) -> impl Iterator<Item = ((usize, bool), &[Polygon])> {
        faces().zip(self.faces.iter().map(Vec::as_slice))
    }

    /// Returns true if a point of the cell is a viewpoint.
    pub fn holds(&self, point: Vec3) -> bool {
        self.region.is_none_or(|region| region.hold(point))
    }

    /// Returns true if a triangle that meets the cell meets the part that contains viewpoints.
    pub fn is_met_by(&self, triangle: [Vec3; 3]) -> bool {
        self.region
            .is_none_or(|region| region.touch(triangle, self.cell.bounds()))
    }

    /// Draws a random viewpoint.
    ///
    /// The point is anywhere in the cell or, if the cell has a region of viewpoints, on a part of the cell's
    /// faces.
    ///
    /// The result is `None` if no face has such a part or if rounding moved the point out of the region.
    pub fn viewpoint(&self, random: &mut Random) -> Option<Vec3> {
        let [min, max] = self.cell.corners();
        if self.region.is_none() {
            let r = glam::DVec3::new(random.unit(), random.unit(), random.unit());
            let p = (min.as_dvec3() + (max.as_dvec3() - min.as_dvec3()) * r).as_vec3();
            return Some(p.clamp(min, max));
        }
        let parts: usize = self.faces.iter().map(Vec::len).sum();
        let number = (random.unit() * parts as f64) as usize;
        let corners = self
            .faces
            .iter()
            .flatten()
            .nth(number.min(parts.checked_sub(1)?))?
            .rounded();
        // The point is uniform in a random triangle of the part's fan.
        let fan = (random.unit() * (corners.len() - 2) as f64) as usize;
        let [a, b, c] = [0, fan + 1, fan + 2].map(|i| corners[i.min(corners.len() - 1)]);
        let (s, t) = (random.unit().sqrt(), random.unit());
        let p = a * (1.0 - s) + b * (s * (1.0 - t)) + c * (s * t);
        let p = p.as_vec3().clamp(min, max);
        self.holds(p).then_some(p)
    }
}
