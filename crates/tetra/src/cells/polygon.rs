//! Convex polygons in a plane of the input, their splits by planes, and sections of tetrahedra.
//!
//! The vertices of a polygon are intersections of planes.

use std::cmp::Ordering;

use glam::Vec3;
use sightline_geometry::predicates::orient3d_sign;

use super::local::LocalGeometry;

/// A convex polygon. Its plane and vertex numbers refer to a [`LocalGeometry`].
#[derive(Clone, Debug)]
pub struct Polygon {
    /// The local number of the plane that contains the polygon.
    pub plane: u32,
    /// Each vertex, as its local number, and the local number of another plane that contains the edge from
    /// this vertex to the next vertex.
    pub loops: Vec<(u32, u32)>,
}

/// The parts of a polygon on both sides of a plane.
pub enum Split {
    /// The polygon lies in the plane.
    On,
    /// The parts in front of the plane and behind the plane; `None` for a part without area.
    Parts(Option<Polygon>, Option<Polygon>),
}

/// Splits a polygon by the plane with the local number `plane`.
pub fn split(local: &mut LocalGeometry<'_>, polygon: Polygon, plane: u32) -> Split {
    if polygon.plane == plane {
        return Split::On;
    }
    let sides: Vec<i8> = polygon
        .loops
        .iter()
        .map(|(v, _)| local.side(*v, plane))
        .collect();
    let (has_front, has_back) = (sides.contains(&1), sides.contains(&-1));
    match (has_front, has_back) {
        (false, false) => Split::On,
        (true, false) => Split::Parts(Some(polygon), None),
        (false, true) => Split::Parts(None, Some(polygon)),
        (true, true) => {
            let n = polygon.loops.len();
            let (mut front, mut back) = (Vec::with_capacity(n + 1), Vec::with_capacity(n + 1));
            for i in 0..n {
                let (v, edge) = polygon.loops[i];
                match (sides[i], sides[(i + 1) % n]) {
                    (1, -1) => {
                        let new = local.meet(polygon.plane, edge, plane);
                        front.extend([(v, edge), (new, plane)]);
                        back.push((new, edge));
                    }
                    (-1, 1) => {
                        let new = local.meet(polygon.plane, edge, plane);
                        back.extend([(v, edge), (new, plane)]);
                        front.push((new, edge));
                    }
                    (1, _) => front.push((v, edge)),
                    (-1, _) => back.push((v, edge)),
                    // The vertex is on the plane, and the edge continues on one side of the plane.
                    (_, 1) => {
                        front.push((v, edge));
                        back.push((v, plane));
                    }
                    _ => {
                        front.push((v, plane));
                        back.push((v, edge));
                    }
                }
            }
            let part = |loops| {
                Some(Polygon {
                    plane: polygon.plane,
                    loops,
                })
            };
            Split::Parts(part(front), part(back))
        }
    }
}

/// Returns the part of a polygon on one side of a plane: in front if `side` is 1, behind if `side` is −1.
///
/// Returns `None` if the part has no area, or if the polygon lies in the plane.
pub fn part(
    local: &mut LocalGeometry<'_>,
    polygon: Polygon,
    plane: u32,
    side: i8,
) -> Option<Polygon> {
    match split(local, polygon, plane) {
        Split::On => None,
        Split::Parts(front, back) => {
            if side > 0 {
                front
            } else {
                back
            }
        }
    }
}

/// A tetrahedron with the planes of its four faces.
#[derive(Clone, Copy)]
pub struct Corners {
    /// The corners, as numbers of points of the input.
    pub points: [u32; 4],
    /// The local number of the plane of the face opposite each corner.
    pub faces: [u32; 4],
}

/// Computes the section of a tetrahedron by the plane with the local number `plane`.
///
/// The section turns counter-clockwise as seen from in front of the plane. Returns `None` if the plane does
/// not pass through the inside of the tetrahedron.
pub fn section(local: &mut LocalGeometry<'_>, tetrahedron: Corners, plane: u32) -> Option<Polygon> {
    let corners = tetrahedron.points.map(|p| local.point(p));
    let (mut front, mut on, mut back) = (Vec::new(), Vec::new(), Vec::new());
    for (k, v) in corners.into_iter().enumerate() {
        match local.side(v, plane) {
            1 => front.push(k),
            0 => on.push(k),
            _ => back.push(k),
        }
    }
    // `places` is the loop of the section. Each entry is a corner (listed twice), or the two ends of the edge
    // that contains the vertex. The orientation of the corners in `turn` shows if the loop turns
    // counter-clockwise as seen from the last corner in `turn`. `is_front` is true if this last corner is in
    // front of the plane.
    let (places, turn, is_front) = match (&front[..], &on[..], &back[..]) {
        (&[p], &[], &[a, b, c]) => (vec![(p, a), (p, b), (p, c)], [a, b, c, p], true),
        (&[p, q, r], &[], &[a]) => (vec![(p, a), (q, a), (r, a)], [p, q, r, a], false),
        (&[p, q], &[], &[a, b]) => (vec![(p, a), (p, b), (q, b), (q, a)], [p, q, a, b], false),
        (&[p], &[z], &[a, b]) => (vec![(z, z), (p, a), (p, b)], [z, a, b, p], true),
        (&[p, q], &[z], &[a]) => (vec![(z, z), (p, a), (q, a)], [z, p, q, a], false),
        (&[p], &[z, w], &[a]) => (vec![(z, z), (w, w), (p, a)], [z, w, a, p], true),
        _ => return None,
    };
    let n = places.len();
    let mut loops = Vec::with_capacity(n);
    for i in 0..n {
        let (at, next) = (places[i], places[(i + 1) % n]);
        let vertex = if at.0 == at.1 {
            corners[at.0]
        } else {
            let mut through = (0..4)
                .filter(|k| *k != at.0 && *k != at.1)
                .map(|k| tetrahedron.faces[k]);
            let (a, b) = (through.next()?, through.next()?);
            local.meet(plane, a, b)
        };
        // The edge of the section lies in a face that contains both of its vertices. This face is opposite a
        // corner that neither entry of `places` contains.
        let apart = (0..4).find(|k| ![at.0, at.1, next.0, next.1].contains(k))?;
        loops.push((vertex, tetrahedron.faces[apart]));
    }
    let places = turn.map(|k| Vec3::from(local.world.points[tetrahedron.points[k] as usize]));
    let is_left = orient3d_sign(places[0], places[1], places[2], places[3]) == Ordering::Greater;
    if is_left != is_front {
        reverse(&mut loops);
    }
    Some(Polygon { plane, loops })
}

/// Reverses a loop of [`Polygon::loops`]. Each edge keeps its plane.
pub fn reverse(loops: &mut [(u32, u32)]) {
    let n = loops.len();
    let edges: Vec<u32> = loops.iter().map(|(_, edge)| *edge).collect();
    loops.reverse();
    // Vertex i was at index n − 1 − i. Its edge to the next vertex was the edge from the previous vertex.
    for (i, item) in loops.iter_mut().enumerate() {
        item.1 = edges[(2 * n - 2 - i) % n];
    }
}
