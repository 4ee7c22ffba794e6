//! Convex polygons in a plane of the input, whose vertices are planes' meets: how a plane splits one, and the
//! section of a tetrahedron.

use std::cmp::Ordering;

use glam::Vec3;
use sightline_geometry::predicates::orient3d_sign;

use super::local::Local;

/// A convex polygon. Its numbers are local ones.
#[derive(Clone, Debug)]
pub struct Polygon {
    /// The plane it lies in.
    pub plane: u32,
    /// Each vertex, and another plane that holds the edge from it to the next vertex.
    pub loops: Vec<(u32, u32)>,
}

/// The parts of a polygon on both sides of a plane.
pub enum Split {
    /// The plane is the polygon's own.
    On,
    /// The parts in front and behind that have area.
    Parts(Option<Polygon>, Option<Polygon>),
}

/// Splits a polygon by a plane.
pub fn split(local: &mut Local<'_>, polygon: Polygon, plane: u32) -> Split {
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
                    // The vertex is on the plane, and the edge goes on to one side.
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

/// The part of a polygon on one side (1 or −1) of a plane that it does not lie in, if it has area.
pub fn part(local: &mut Local<'_>, polygon: Polygon, plane: u32, side: i8) -> Option<Polygon> {
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

/// A tetrahedron with its four local planes.
#[derive(Clone, Copy)]
pub struct Corners {
    /// Points of the input.
    pub points: [u32; 4],
    /// The local plane of the face opposite each corner.
    pub faces: [u32; 4],
}

/// The section of a tetrahedron by a plane, counter-clockwise as seen from in front of the plane. `None`
/// where the plane does not pass through the inside.
pub fn section(local: &mut Local<'_>, tetrahedron: Corners, plane: u32) -> Option<Polygon> {
    let corners = tetrahedron.points.map(|p| local.point(p));
    let (mut front, mut on, mut back) = (Vec::new(), Vec::new(), Vec::new());
    for (k, v) in corners.into_iter().enumerate() {
        match local.side(v, plane) {
            1 => front.push(k),
            0 => on.push(k),
            _ => back.push(k),
        }
    }
    // The places of the loop: a corner (twice), or the ends of an edge. Then the corners that say whether it
    // turns counter-clockwise as seen from the last of them, and whether that one is in front.
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
        // The edge runs in a face that holds both places: one opposite a corner that neither names.
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

/// Turns a loop around, each edge's plane with its edge.
pub fn reverse(loops: &mut [(u32, u32)]) {
    let n = loops.len();
    let edges: Vec<u32> = loops.iter().map(|(_, edge)| *edge).collect();
    loops.reverse();
    // The vertex i was at n − 1 − i, and the edge to what follows now is the one that led to it then.
    for (i, item) in loops.iter_mut().enumerate() {
        item.1 = edges[(2 * n - 2 - i) % n];
    }
}
