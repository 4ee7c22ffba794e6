//! The division of faces in a plane into the parts that other faces in this plane cover, and the open rest
//! (Teller 1992, section 5.2.5).

use std::cmp::Ordering;

use sightline_exact::predicates;

use crate::plane::{Face, Plane};

/// The maximum number of pairs of an opening and a face in its plane that one call compares.
const MOST_CUTS: u64 = 1 << 26;

/// Divides the faces `open` into convex parts, and returns the parts that no face of `covers` covers, and
/// then the covered parts.
///
/// All faces must be in `plane`.
///
/// The function adds the number of compared pairs to `work`.
pub fn divide_covered(
    mut open: Vec<Face>,
    mut covers: Vec<Face>,
    plane: &Plane,
    work: &mut u64,
) -> [Vec<Face>; 2] {
    // Large faces come first, because they leave fewer parts to cut.
    covers.sort_by(|a, b| b.area().total_cmp(&a.area()));
    let mut covered = Vec::new();
    let begun = *work;
    for cover in covers {
        // After the limit, the remaining parts stay open: an opening may be larger than the true opening.
        if *work - begun > MOST_CUTS {
            break;
        }
        let borders = borders(&cover, plane);
        let mut next = Vec::with_capacity(open.len());
        for part in open {
            *work += 1;
            if part.apart(&cover) {
                next.push(part);
                continue;
            }
            // Do not cut a part that only touches the cover.
            let is_out = |(border, inner): &(Plane, Ordering)| !part.sides(border).contains(inner);
            if borders.iter().any(is_out) {
                next.push(part);
                continue;
            }
            let mut left = Some(part);
            for (border, inner) in &borders {
                let Some(part) = left else { break };
                let sides = part.sides(border);
                next.extend(part.part(border, &sides, inner.reverse()));
                left = part.part(border, &sides, *inner);
            }
            covered.extend(left);
        }
        open = next;
    }
    [open, covered]
}

/// Computes, for each edge of a face, a plane through the edge that is not the face's plane, and the side of
/// this plane that contains the face.
///
/// Each plane contains an edge and the direction of an axis that is not in the face's plane.
fn borders(face: &Face, plane: &Plane) -> Vec<(Plane, Ordering)> {
    let points = face.polygon().points();
    let exact: Vec<_> = points.iter().map(predicates::integers).collect();
    let n = points.len();
    (0..n)
        .map(|i| {
            let border = Plane::from_coefficients(predicates::plane_along(
                [&exact[i], &exact[(i + 1) % n]],
                plane.axis(),
            ));
            let next = (i + 2) % n;
            let inner = border.side(&points[next], face.corners()[next]);
            (border, inner)
        })
        .collect()
}
