//! Queries: what a point's hemisphere is free of (`visibilityQuery`, Algorithm 1), by descending into the partition
//! with parts of the hemisphere.

use glam::DVec3;

use crate::items::{Items, What};
use crate::lambert::{Cap, Covered, cosine_without};
use crate::partition::{Node, Partition, plane};
use crate::polygon::{Corner, Plane, Side, side, split};
use crate::receivers::{Receiver, Source, U};

/// What is known of a receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Openness {
    /// The free share of its hemisphere, weighted by the cosine: 0 to 1.
    pub open: f64,
    /// Bound on what rounding can have changed.
    pub bound: f64,
    /// The occluders (convex polygons of joined triangles) at which parts of the hemisphere end.
    pub occluders: u32,
    /// The parts into which the hemisphere was divided.
    pub parts: u32,
}

/// No cap.
const NONE: u32 = u32::MAX;
/// Caps whose borders are that near in radians are taken as one.
const SAME_CAP: f64 = 1e-12;

/// A part of the hemisphere that waits at a node.
struct Waiting {
    node: u32,
    /// Its corners: from here to the end of those that wait.
    start: usize,
    /// The last of its caps.
    caps: u32,
}

/// The memory of queries, which can be used again.
#[derive(Default)]
pub struct Scratch {
    corners: Vec<Corner>,
    waiting: Vec<Waiting>,
    current: Vec<Corner>,
    values: Vec<f64>,
    inside: Vec<Corner>,
    /// Caps, each with the one before it.
    caps: Vec<(Cap, u32)>,
    of_part: Vec<Cap>,
    cuts: Vec<f64>,
    /// By face, the last query in which it hid something.
    hid: Vec<u64>,
    query: u64,
}

/// A part of the hemisphere of a point.
struct Part<'a> {
    corners: &'a [Corner],
    x: DVec3,
    distance: f64,
}

impl Part<'_> {
    /// Whether an item may hide something of the part: not if all its corners lie beyond one of the borders, or its
    /// plane beyond the distance. What doubles cannot tell may.
    fn may_meet(&self, items: &Items<'_>, id: u32) -> bool {
        if let What::Face(face) = items.item(id).what {
            let face = items.face(face);
            let height = face.normal.dot(face.at - self.x).abs();
            if height > self.distance * face.normal.length() * (1.0 + 1e-9) {
                return false;
            }
        }
        let corners = items.corners(id);
        // A corner's direction and a border's plane are each off by a few roundings.
        let far = 32.0 * U * items.item(id).far;
        self.corners.iter().all(|v| {
            corners.iter().any(|c| v.border.dot(*c - self.x) > -far)
        })
    }
}

/// The quarters of the hemisphere over a unit vector.
pub fn quarters(n: DVec3) -> [[Corner; 3]; 4] {
    let (u, v) = n.any_orthonormal_pair();
    let v = if u.cross(v).dot(n) > 0.0 { v } else { -v };
    let around = [u, v, -u, -v];
    std::array::from_fn(|k| {
        let (a, b) = (around[k], around[(k + 1) % 4]);
        [(n, b), (a, n), (b, a)].map(|(at, border)| Corner { at, border })
    })
}

/// The openness of a receiver of the source.
pub fn open(
    tree: &mut Partition,
    items: &mut Items<'_>,
    source: &Source,
    receiver: &Receiver,
    distance: f64,
    scratch: &mut Scratch,
) -> Openness {
    let x = receiver.point - source.origin;
    let n = receiver.normal.normalize();
    let mut answer = Openness::default();
    scratch.query += 1;
    scratch.caps.clear();
    for quarter in quarters(n) {
        scratch.waiting.push(Waiting { node: 0, start: scratch.corners.len(), caps: NONE });
        scratch.corners.extend(quarter);
    }
    while let Some(Waiting { mut node, start, mut caps }) = scratch.waiting.pop() {
        scratch.current.clear();
        scratch.current.extend_from_slice(&scratch.corners[start..]);
        scratch.corners.truncate(start);
        loop {
            match tree.node(node) {
                Node::Undefined(_) | Node::UndefinedFrom(..) => {
                    let part = Part { corners: &scratch.current, x, distance };
                    let grown = tree.grow(node, items, source, &mut |items, id| part.may_meet(items, id));
                    scratch.hid.resize(items.faces(), 0);
                    if !grown {
                        answer.open += free(n, caps, scratch);
                        answer.parts += 1;
                        break;
                    }
                }
                Node::Free => {
                    answer.open += free(n, caps, scratch);
                    answer.parts += 1;
                    break;
                }
                Node::Hidden(face) => {
                    hide(*face, &mut answer, scratch);
                    break;
                }
                Node::Edge { a, b, inside, outside } => {
                    let plane = plane(items.point(*a), items.point(*b), x);
                    match side(&plane, &scratch.current, &mut scratch.values) {
                        Side::Inside(unsure) => {
                            node = *inside;
                            answer.bound += if unsure { plane.uncertain(&scratch.current) } else { 0.0 };
                        }
                        Side::Outside(unsure) => {
                            node = *outside;
                            answer.bound += if unsure { plane.uncertain(&scratch.current) } else { 0.0 };
                        }
                        Side::Both => {
                            answer.bound += plane.uncertain(&scratch.current);
                            divide(&plane, *outside, caps, scratch);
                            if scratch.current.len() < 3 {
                                break;
                            }
                            node = *inside;
                        }
                    }
                }
                Node::Start { face, from } => {
                    let f = items.face(*face);
                    let d = x - f.at;
                    let value = f.normal.dot(d);
                    let bound = f.error * d.length() + f.normal.length() * source.slack;
                    node = match value {
                        v if v > bound => from[2],
                        v if v < -bound => from[0],
                        _ => from[1],
                    };
                }
                Node::Near { face, beyond } => {
                    let (face, beyond) = (*face, *beyond);
                    let f = items.face(face);
                    // The plane's normal, away from the point.
                    let size = f.normal.length();
                    let height = f.normal.dot(f.at - x) / size;
                    let axis = f.normal * (height.signum() / size);
                    let cap = Cap { axis, cosine: height.abs() / distance };
                    let covered =
                        if cap.cosine >= 1.0 { Covered::None } else { cap.covers(&scratch.current) };
                    match covered {
                        Covered::None => node = beyond,
                        Covered::All => {
                            hide(face, &mut answer, scratch);
                            break;
                        }
                        Covered::Part => {
                            hide(face, &mut answer, scratch);
                            answer.bound += 4.0 * (f.error / size + 4.0 * U) + 4.0 * source.slack / distance;
                            caps = add(cap, caps, scratch, &mut answer.bound);
                            node = beyond;
                        }
                    }
                }
            }
        }
    }
    // Each part's area is a sum of a few angles.
    answer.bound += f64::from(answer.parts) * 16.0 * U;
    answer
}

/// Notes that a face hides a part.
fn hide(face: u32, answer: &mut Openness, scratch: &mut Scratch) {
    answer.parts += 1;
    if std::mem::replace(&mut scratch.hid[face as usize], scratch.query) != scratch.query {
        answer.occluders += 1;
    }
}

/// Leaves the inner part of the current polygon, and lets the outer one wait at a node.
fn divide(plane: &Plane, outside: u32, caps: u32, scratch: &mut Scratch) {
    let start = scratch.corners.len();
    scratch.inside.clear();
    split(plane, &scratch.current, &scratch.values, &mut scratch.inside, &mut scratch.corners);
    std::mem::swap(&mut scratch.current, &mut scratch.inside);
    if scratch.corners.len() - start < 3 {
        scratch.corners.truncate(start);
    } else {
        scratch.waiting.push(Waiting { node: outside, start, caps });
    }
}

/// The caps of a part with another one, which may hold some of them, or be held.
fn add(cap: Cap, caps: u32, scratch: &mut Scratch, bound: &mut f64) -> u32 {
    let (mut at, mut keep) = (caps, true);
    scratch.of_part.clear();
    while at != NONE {
        let (other, before) = scratch.caps[at as usize];
        if other.holds(&cap, SAME_CAP) {
            keep = false;
            if !other.holds(&cap, 0.0) {
                *bound += 2.0 * SAME_CAP;
            }
        }
        scratch.of_part.push(other);
        at = before;
    }
    if !keep {
        return caps;
    }
    let mut last = NONE;
    for k in (0..scratch.of_part.len()).rev() {
        let other = scratch.of_part[k];
        if !cap.holds(&other, 0.0) {
            scratch.caps.push((other, last));
            last = scratch.caps.len() as u32 - 1;
        }
    }
    scratch.caps.push((cap, last));
    scratch.caps.len() as u32 - 1
}

/// The area of the current polygon without the caps.
fn free(n: DVec3, caps: u32, scratch: &mut Scratch) -> f64 {
    scratch.of_part.clear();
    let mut at = caps;
    while at != NONE {
        let (cap, before) = scratch.caps[at as usize];
        scratch.of_part.push(cap);
        at = before;
    }
    cosine_without(n, &scratch.current, &scratch.of_part, &mut scratch.cuts)
}
