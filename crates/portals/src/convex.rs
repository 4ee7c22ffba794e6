//! A convex part of a box, by the faces that bound it.

use std::cmp::Ordering;

use sightline_exact::Polygon;
use sightline_numbers::Aabb;

use crate::plane::{Face, Plane};

/// The faces of a box, as a convex part that is the whole box.
pub fn whole(of: Aabb) -> Vec<Face> {
    Polygon::faces_of(of).map(Face::new).into()
}

/// The parts of a convex part of a box on the lesser and on the greater side of a plane; without faces where
/// there is none.
pub fn divide(faces: Vec<Face>, plane: &Plane, of: Aabb) -> [Vec<Face>; 2] {
    // A convex part has a volume on each side on which one of its corners is.
    let sides: Vec<Vec<Ordering>> = faces.iter().map(|face| face.sides(plane)).collect();
    let on = |side: Ordering| sides.iter().flatten().any(|s| *s == side);
    match (on(Ordering::Less), on(Ordering::Greater)) {
        (true, true) => {
            let cap = section(plane, &faces, of);
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

/// The section of a plane with a convex part of a box.
fn section(plane: &Plane, faces: &[Face], of: Aabb) -> Option<Face> {
    let mut cap = Face::new(Polygon::section(plane.coefficients(), of)?);
    for face in faces {
        let wall = Plane::of(face.polygon().plane());
        // The part is on the side of any corner that is not in the wall.
        let sides = faces.iter().flat_map(|other| other.sides(&wall));
        let inner = sides.into_iter().find(|side| *side != Ordering::Equal)?;
        let sides = cap.sides(&wall);
        cap = cap.part(&wall, &sides, inner)?;
    }
    Some(cap)
}
