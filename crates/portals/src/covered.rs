//! The parts of faces in a plane that other faces in it cover, and the open rest (Teller 1992, section
//! 5.2.5).

use std::cmp::Ordering;

use sightline_exact::predicates;

use crate::plane::{Face, Plane};

/// Most pairs of an opening and a face in its plane that are compared at once.
const MOST_CUTS: u64 = 1 << 26;

/// The convex parts of faces in a plane that other faces in it do not cover, and those that they do. `work`
/// is counted on by the pairs that are compared.
pub fn divide_covered(
    mut open: Vec<Face>,
    mut covers: Vec<Face>,
    plane: &Plane,
    work: &mut u64,
) -> [Vec<Face>; 2] {
    // Large faces first: they leave less to be cut.
    covers.sort_by(|a, b| b.area().total_cmp(&a.area()));
    let mut covered = Vec::new();
    let begun = *work;
    for cover in covers {
        // What is not cut off any more stays open: an opening may be larger than the true one.
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
            // What only touches the cover is not cut.
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

/// Planes across a face along each of its edges, with the side on which the face is.
///
/// Each contains an edge and the direction of an axis that is not in the face's plane.
fn borders(face: &Face, plane: &Plane) -> Vec<(Plane, Ordering)> {
    let points = face.polygon().points();
    let exact: Vec<_> = points.iter().map(predicates::integers).collect();
    let n = points.len();
    (0..n)
        .map(|i| {
            let border = Plane::of(predicates::plane_along(
                [&exact[i], &exact[(i + 1) % n]],
                plane.axis(),
            ));
            let next = (i + 2) % n;
            let inner = border.side(&points[next], face.corners()[next]);
            (border, inner)
        })
        .collect()
}
