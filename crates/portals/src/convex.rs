//! A convex part of a box, represented by the faces that bound the part.

use std::cmp::Ordering;

use sightline_exact::Polygon;
use sightline_numbers::Aabb;

use crate::plane::{Face, Plane};

/// Returns the faces of a box: the convex part that is the whole box.
pub fn whole(bounds: Aabb) -> Vec<Face> {
    Polygon::faces_of(bounds).map(Face::new).into()
}

/// Divides a convex part of a box into the parts on the lower and upper side of a plane.
///
/// A part that does not exist has no faces.
pub fn divide(faces: Vec<Face>, plane: &Plane, bounds: Aabb) -> [Vec<Face>; 2] {
    // If a corner of a convex part is strictly on a side of the plane, the part has a volume on that side.
    let sides: Vec<Vec<Ordering>> = faces.iter().map(|face| face.sides(plane)).collect();
    let on = |side: Ordering| sides.iter().flatten().any(|s| *s == side);
    match (on(Ordering::Less), on(Ordering::Greater)) {
        (true, true) => {
            let cap = section(plane, &faces, bounds);
            [Ordering::Less, Ordering::Greater].map(|keep| {
                let parts = faces
                    .iter()
                    .zip(&sides)
                    .filter_map(|(face, sides)| face.part(plane, sides, keep));
                parts.chain(cap.clone()).collect()
            })
        }
        (true, false) => [faces, Vec::new()],
        (false, true) => [Vec::new(), faces],
        (false, false) => [Vec::new(), Vec::new()],
    }
}

/// Computes the section of a plane with a convex part of a box.
fn section(plane: &Plane, faces: &[Face], bounds: Aabb) -> Option<Face> {
    let mut cap = Face::new(Polygon::section(plane.coefficients(), bounds)?);
    for face in faces {
        let wall = Plane::from_coefficients(face.polygon().plane());
        // The part is on the side of any of its corners that is not in the wall.
        let sides = faces.iter().flat_map(|other| other.sides(&wall));
        let inner = sides.into_iter().find(|side| *side != Ordering::Equal)?;
        let sides = cap.sides(&wall);
        cap = cap.part(&wall, &sides, inner)?;
    }
    Some(cap)
}
