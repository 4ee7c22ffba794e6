//! Where lines leave a view cell: its faces, or the parts of them where viewpoints are.
//!
//! Viewpoints may be in a part of the cell alone. The part must hold every free segment in the cell that
//! begins in it, as a region bounded by walls does, or a box without the walls in its faces: then a line
//! from a viewpoint leaves the cell where viewpoints are, and the triangles seen from the part are those
//! that meet it and those that are seen from its parts of the faces.

use glam::Vec3;
use sightline_certificate::certificate::faces;
use sightline_numbers::Aabb;

use crate::arithmetic::random::Random;
use crate::geometry::Cell;
use crate::geometry::polygon::Polygon;

/// The part of space where viewpoints are. Within a cell, a free segment that begins in it must not leave it.
pub trait ExactViewRegion: Sync {
    /// Whether a point of the cell is a viewpoint.
    fn hold(&self, point: Vec3) -> bool;
    /// The parts of a cell's face through which free segments leave the cell.
    fn parts(&self, face: &Polygon) -> Vec<Polygon>;
    /// Whether a triangle has an area in common with the closed part within a closed box.
    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool;
}

/// A view cell with the parts of its faces through which lines leave.
pub struct Sources<'a> {
    cell: Cell,
    places: Option<&'a dyn ExactViewRegion>,
    /// In the order of [`faces`].
    faces: [Vec<Polygon>; 6],
}

impl<'a> Sources<'a> {
    /// The faces of a cell; with `places`, their parts there.
    pub fn new(cell: Cell, places: Option<&'a dyn ExactViewRegion>) -> Self {
        let mut all = faces().map(|(axis, up)| {
            let face = Polygon::face_of(cell.bounds(), axis, up);
            match places {
                None => vec![face],
                Some(places) => places.parts(&face),
            }
        });
        let faces = std::array::from_fn(|_| all.next().unwrap_or_default());
        Self {
            cell,
            places,
            faces,
        }
    }

    /// The cell.
    pub fn cell(&self) -> Cell {
        self.cell
    }

    /// Each face with its axis, whether it is the greater one, and its parts.
    pub fn faces(&self) -> impl Iterator<Item = ((usize, bool), &[Polygon])> {
        faces().zip(self.faces.iter().map(Vec::as_slice))
    }

    /// Whether a point of the cell is a viewpoint.
    pub fn holds(&self, point: Vec3) -> bool {
        self.places.is_none_or(|places| places.hold(point))
    }

    /// Whether a triangle that meets the cell meets it where viewpoints are.
    pub fn is_met_by(&self, triangle: [Vec3; 3]) -> bool {
        self.places
            .is_none_or(|places| places.touch(triangle, self.cell.bounds()))
    }

    /// A random viewpoint: anywhere in the cell, or on a part of its faces. `None` when there is none, or
    /// rounding has moved it away.
    pub fn viewpoint(&self, random: &mut Random) -> Option<Vec3> {
        let [min, max] = self.cell.corners();
        if self.places.is_none() {
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
        // A triangle of the part's fan, and a point of it.
        let fan = (random.unit() * (corners.len() - 2) as f64) as usize;
        let [a, b, c] = [0, fan + 1, fan + 2].map(|i| corners[i.min(corners.len() - 1)]);
        let (s, t) = (random.unit().sqrt(), random.unit());
        let p = a * (1.0 - s) + b * (s * (1.0 - t)) + c * (s * t);
        let p = p.as_vec3().clamp(min, max);
        self.holds(p).then_some(p)
    }
}
