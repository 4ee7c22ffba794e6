//! The faces of a view cell along walls; a wall in a face blocks.
//!
//! Lines from the inside of such a cell leave through the parts of its faces that no wall covers. Exact
//! queries start only from these parts.

use std::cmp::Ordering;

use glam::Vec3;
use sightline_exact::{ExactViewRegion, Polygon};
use sightline_geometry::predicates::orient2d_sign;
use sightline_numbers::Aabb;
use sightline_scene::Scene;

use crate::face_cover::divide_covered;
use crate::open_box::walls_in_faces;
use crate::plane::{Face, Plane};

/// The faces of a cell without the walls in them, restricted to the part of space with viewpoints.
pub struct OpenFaces<'a> {
    /// Each wall in a face of the cell: the axis that the wall is perpendicular to, the wall's coordinate on
    /// that axis, and its corners.
    walls: Vec<(usize, f32, [Vec3; 3])>,
    within: Option<&'a dyn ExactViewRegion>,
}

impl<'a> OpenFaces<'a> {
    /// Creates the open faces of a box of a scene.
    ///
    /// Viewpoints are in the part of space `within`, or everywhere if `within` is `None`.
    pub fn new(scene: &Scene, cell: Aabb, within: Option<&'a dyn ExactViewRegion>) -> Self {
        let walls = walls_in_faces(scene, cell);
        let with_corners = |(id, axis): (u32, usize)| {
            let v = scene.triangles()[id as usize].v;
            (axis, v[0][axis], v)
        };
        Self {
            walls: walls.into_iter().map(with_corners).collect(),
            within,
        }
    }
}

impl ExactViewRegion for OpenFaces<'_> {
    fn hold(&self, point: Vec3) -> bool {
        let is_on = |(axis, level, v): &(usize, f32, [Vec3; 3])| {
            let flat = |p: Vec3| [p[(axis + 1) % 3], p[(axis + 2) % 3]];
            let [a, b, c, p] = [v[0], v[1], v[2], point].map(flat);
            let sides = [(a, b), (b, c), (c, a)].map(|(a, b)| orient2d_sign(a, b, p));
            point[*axis] == *level
                && !(sides.contains(&Ordering::Less) && sides.contains(&Ordering::Greater))
        };
        self.within.is_none_or(|within| within.hold(point)) && !self.walls.iter().any(is_on)
    }

    fn parts(&self, face: &Polygon) -> Vec<Polygon> {
        let parts = match self.within {
            Some(within) => within.parts(face),
            None => vec![face.clone()],
        };
        let plane = Plane::from_coefficients(face.plane());
        let covers = self.walls.iter().filter(|(axis, level, _)| {
            plane.axis() == *axis && plane.across() == Some(f64::from(*level))
        });
        let covers: Vec<Face> = covers
            .filter_map(|(_, _, v)| Polygon::triangle(v.map(|p| p.as_dvec3())))
            .map(Face::new)
            .collect();
        let parts = parts.into_iter().map(Face::new).collect();
        let [open, _] = divide_covered(parts, covers, &plane, &mut 0);
        open.into_iter()
            .flat_map(|part| part.into_polygon().pieces())
            .collect()
    }

    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool {
        shares_area(triangle, within)
            && self
                .within
                .is_none_or(|region| region.touch(triangle, within))
    }
}

/// Returns true if a triangle shares an area with a closed box.
///
/// A triangle that touches the box only in an edge or a corner does not count, because it may be behind a
/// wall.
fn shares_area(triangle: [Vec3; 3], bounds: Aabb) -> bool {
    let Some(mut face) = Polygon::triangle(triangle.map(|v| v.as_dvec3())).map(Face::new) else {
        return false;
    };
    for wall in Polygon::faces_of(bounds) {
        let plane = Plane::from_coefficients(wall.plane());
        let inner = [bounds.min, bounds.max].map(|p| plane.side_of(p));
        let inner = if inner[0] == Ordering::Equal {
            inner[1]
        } else {
            inner[0]
        };
        let sides = face.sides(&plane);
        // Do not cut a triangle in the plane of a face.
        if sides.iter().any(|side| *side != Ordering::Equal) {
            match face.part(&plane, &sides, inner) {
                Some(part) => face = part,
                None => return false,
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use sightline_scene::{Object, Triangle};

    /// Uses a wall in the face x = 0 of the unit cube, and a shelf that touches the wall from behind.
    ///
    /// The wall leaves the upper half of the face open.
    #[test]
    fn open_faces_exclude_walls_and_shelf_behind() {
        let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        let triangles = vec![
            Triangle {
                v: [at(0.0, 0.0, 0.0), at(0.0, 1.0, 0.0), at(0.0, 1.0, 0.5)],
            },
            Triangle {
                v: [at(0.0, 0.0, 0.0), at(0.0, 0.0, 0.5), at(0.0, 1.0, 0.5)],
            },
            Triangle {
                v: [at(0.0, 0.0, 0.25), at(0.0, 1.0, 0.25), at(-1.0, 1.0, 0.25)],
            },
        ];
        let object = Object {
            name: "wall".to_owned(),
            first: 0,
            count: 3,
        };
        let scene = Scene::new("wall", triangles.clone(), vec![object]).unwrap();
        let cube = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let faces = OpenFaces::new(&scene, cube, None);
        let area = |axis: usize, up: bool| -> f64 {
            let parts = faces.parts(&Polygon::face_of(cube, axis, up));
            parts
                .into_iter()
                .map(|part| Face::new(part).area() / 2.0)
                .sum()
        };
        assert!((area(0, false) - 0.5).abs() < 1e-12);
        assert!((area(0, true) - 1.0).abs() < 1e-12);
        assert!(faces.hold(at(0.0, 0.5, 0.75)) && !faces.hold(at(0.0, 0.5, 0.25)));
        assert!(
            !faces.hold(at(0.0, 0.5, 0.5)),
            "the edge of the wall is the wall's"
        );
        assert!(faces.hold(at(0.1, 0.5, 0.25)));
        assert!(faces.touch(triangles[0].v, cube) && !faces.touch(triangles[2].v, cube));
    }
}
