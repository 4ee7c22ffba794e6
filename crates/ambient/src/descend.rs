//! The way of a part of the sphere of directions down a partition (`visibilityQuery`, Algorithm 1): it is
//! divided where hyperplanes pass through it, and ends in classes.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::hyperplane::plane;
use crate::items::{Face, Items, Reach, What};
use crate::lambert::{Cap, Covered};
use crate::partition::{Grown, Node, Partition};
use crate::polygon::{Corner, Plane, Side, side, split};
use crate::receivers::Source;

/// No cap.
const NONE: u32 = u32::MAX;
/// Caps whose borders are that near in radians are taken as one.
const SAME_CAP: f64 = 1e-12;

/// What becomes of the parts.
pub trait Ends {
    /// A part without some caps meets nothing within reach.
    fn free(&mut self, part: &[Corner], caps: &[Cap]);
    /// A part meets a face.
    fn met(&mut self, face: u32, part: &[Corner]);
}

/// A part that waits at a node.
struct Waiting {
    node: u32,
    /// Its corners: from here to the end of those that wait.
    start: usize,
    /// The last of its caps.
    caps: u32,
}

/// The memory of descents, which can be used again.
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
}

/// A part of the sphere of directions about a point.
struct Part<'a> {
    corners: &'a [Corner],
    x: DVec3,
    distance: f64,
}

impl Part<'_> {
    /// Whether an item may hide something of the part: not if all its corners lie beyond one of the borders,
    /// or its plane beyond the distance. What doubles cannot tell may.
    fn may_meet(&self, items: &Items<'_>, id: u32) -> bool {
        if let What::Face(face) = items.item(id).what {
            let face = items.face(face);
            let height = face.normal.dot(face.at - self.x).abs();
            if height > self.distance * face.normal.length() * (1.0 + 1e-9) {
                return false;
            }
        }
        let hull = items.hull(id);
        // A corner's direction and a border's plane are each off by a few roundings.
        let far = 32.0 * U * items.item(id).far;
        self.corners
            .iter()
            .all(|v| hull.extent(v.border).1 - v.border.dot(self.x) > -far)
    }
}

/// A partition, and what it is of.
pub struct Rays<'a, 'b> {
    /// The tree.
    pub tree: &'a mut Partition,
    /// Its items.
    pub items: &'a mut Items<'b>,
    /// The set that rays start from.
    pub source: &'a Source,
    /// Most bytes of the tree and its items. A tree with which they take more is begun anew, and what is not
    /// at its end yet starts again at the root. The items of one query are kept until its end: see
    /// [`Self::begin`].
    pub bytes: usize,
    /// Items that classes may be told of before a descent is given up.
    pub most_told: usize,
}

impl Rays<'_, '_> {
    /// To be called before each query, whose ends name faces: begins tree and items anew where the items that
    /// earlier queries opened leave the tree less than half of the bytes.
    pub fn begin(&mut self) {
        if self.items.bytes() > self.bytes / 2 {
            self.items.forget();
            self.tree.clear();
        }
    }

    /// Bytes that the tree may take. A quarter is left to it whatever one query opens, so that it is not
    /// begun anew at every part.
    fn most(&self) -> usize {
        self.bytes
            .saturating_sub(self.items.bytes())
            .max(self.bytes / 4)
    }

    /// Takes a part of the directions from `x`, a point of the source from its origin, to its ends. Returns
    /// the bound on the cosine-weighted area, divided by π, that may be at a wrong end; none when classes
    /// were told of too many items, and the descent was given up.
    pub fn descend(
        &mut self,
        x: DVec3,
        part: &[Corner],
        scratch: &mut Scratch,
        ends: &mut impl Ends,
    ) -> Option<f64> {
        let reach = *self.items.reach();
        let mut bound = 0.0;
        scratch.caps.clear();
        scratch.corners.clear();
        scratch.corners.extend_from_slice(part);
        scratch.waiting.clear();
        scratch.waiting.push(Waiting {
            node: 0,
            start: 0,
            caps: NONE,
        });
        while let Some(Waiting {
            mut node,
            start,
            mut caps,
        }) = scratch.waiting.pop()
        {
            scratch.current.clear();
            scratch.current.extend_from_slice(&scratch.corners[start..]);
            scratch.corners.truncate(start);
            if self.tree.told() > self.most_told {
                return None;
            }
            if self.tree.bytes() > self.most() {
                self.tree.clear();
                node = 0;
                scratch.waiting.iter_mut().for_each(|w| w.node = 0);
            }
            while scratch.current.len() > 2 {
                match self.tree.node(node) {
                    Node::Undefined(_) => {
                        let part = Part {
                            corners: &scratch.current,
                            x,
                            distance: reach.distance(),
                        };
                        let mut may = |items: &Items<'_>, id| part.may_meet(items, id);
                        match self.tree.grow(node, self.items, self.source, &mut may) {
                            Grown::Defined => {}
                            Grown::Nothing(None) => {
                                free(caps, scratch, ends);
                                break;
                            }
                            Grown::Nothing(Some(face)) => {
                                ends.met(face, &scratch.current);
                                break;
                            }
                        }
                    }
                    Node::Free => {
                        free(caps, scratch, ends);
                        break;
                    }
                    Node::Met(face) => {
                        ends.met(*face, &scratch.current);
                        break;
                    }
                    Node::Edge {
                        a,
                        b,
                        inside,
                        outside,
                    } => {
                        let plane = plane(self.items.point(*a), self.items.point(*b), x);
                        let unsure;
                        (node, unsure) = sort(&plane, [*inside, *outside], caps, scratch);
                        bound += unsure;
                    }
                    Node::Start { face, from } => {
                        let f = self.items.face(*face);
                        let d = x - f.at;
                        let value = f.normal.dot(d);
                        let error = f.error * d.length() + f.normal.length() * self.source.slack;
                        node = match value {
                            v if v > error => from[2],
                            v if v < -error => from[0],
                            _ => from[1],
                        };
                    }
                    Node::Order { faces, first } => {
                        let [one, two] = faces.map(|f| self.ahead(f, x));
                        let plane = before(one, two);
                        let unsure;
                        (node, unsure) = sort(&plane, *first, caps, scratch);
                        bound += unsure;
                    }
                    Node::Near { face, beyond } => {
                        let (face, beyond) = (*face, *beyond);
                        let ahead = self.ahead(face, x);
                        match reach {
                            Reach::Distance(distance) => {
                                let (cap, unsure) = ahead.cap(distance);
                                let covered =
                                    cap.map_or(Covered::None, |cap| cap.covers(&scratch.current));
                                if covered != Covered::None {
                                    ends.met(face, &scratch.current);
                                }
                                if covered == Covered::All {
                                    break;
                                }
                                if let (Covered::Part, Some(cap)) = (covered, cap) {
                                    bound += unsure;
                                    caps = add(cap, caps, scratch, &mut bound);
                                }
                                node = beyond;
                            }
                            Reach::Light { normal, at, .. } => {
                                let height = normal.dot(at - x);
                                let normal = normal * height.signum();
                                let d = (at - x).length();
                                let error = [8.0 * U, 8.0 * U * d + self.source.slack];
                                let light = Ahead {
                                    normal,
                                    height: height.abs(),
                                    error,
                                };
                                let plane = before(ahead, light);
                                match side(&plane, &scratch.current, &mut scratch.values) {
                                    Side::Inside(unsure) => {
                                        bound += if unsure {
                                            plane.uncertain(&scratch.current)
                                        } else {
                                            0.0
                                        };
                                        ends.met(face, &scratch.current);
                                        break;
                                    }
                                    Side::Outside(unsure) => {
                                        bound += if unsure {
                                            plane.uncertain(&scratch.current)
                                        } else {
                                            0.0
                                        };
                                    }
                                    Side::Both => {
                                        scratch.inside.clear();
                                        let mut met = std::mem::take(&mut scratch.inside);
                                        let start = scratch.corners.len();
                                        let (current, values) = (&scratch.current, &scratch.values);
                                        split(
                                            &plane,
                                            current,
                                            values,
                                            &mut met,
                                            &mut scratch.corners,
                                        );
                                        bound += plane.uncertain(&scratch.current);
                                        ends.met(face, &met);
                                        scratch.inside = met;
                                        scratch.current.clear();
                                        scratch
                                            .current
                                            .extend_from_slice(&scratch.corners[start..]);
                                        scratch.corners.truncate(start);
                                    }
                                }
                                node = beyond;
                            }
                        }
                    }
                }
            }
        }
        Some(bound)
    }

    fn ahead(&self, face: u32, x: DVec3) -> Ahead {
        Ahead::of(self.items.face(face), x, self.source.slack)
    }
}

/// A plane ahead of a point.
#[derive(Clone, Copy)]
pub struct Ahead {
    /// Its unit normal, away from the point.
    pub normal: DVec3,
    /// Its distance.
    pub height: f64,
    /// Bounds on the errors of the normal and of the distance.
    error: [f64; 2],
}

impl Ahead {
    /// A face's plane as seen from a point that is off by at most a slack.
    pub fn of(face: &Face, x: DVec3, slack: f64) -> Self {
        let (size, d) = (face.normal.length(), face.at - x);
        let height = face.normal.dot(d) / size;
        let of_normal = face.error / size + 4.0 * U;
        let error = [of_normal, of_normal * d.length() + slack];
        Self {
            normal: face.normal * (height.signum() / size),
            height: height.abs(),
            error,
        }
    }

    /// The directions in which it is nearer than a distance, unless there is none, and the bound on the
    /// cosine-weighted area, divided by π, that the errors can add or take.
    pub fn cap(&self, distance: f64) -> (Option<Cap>, f64) {
        let cap = Cap {
            axis: self.normal,
            cosine: self.height / distance,
        };
        // A circle is at most 2π long; its radius changes by less than the error of its cosine by its sine,
        // and a circle that is small is short.
        (
            (cap.cosine < 1.0).then_some(cap),
            4.0 * (self.error[0] + self.error[1] / distance),
        )
    }
}

/// The directions in which one plane is met before another: those with m·ω > 0, as the distances to the
/// planes along ω are height / (normal·ω).
fn before(one: Ahead, other: Ahead) -> Plane {
    let m = one.normal * other.height - other.normal * one.height;
    let of_normals = one.error[0] * other.height + other.error[0] * one.height;
    let of_heights = one.error[1] + other.error[1];
    Plane {
        m,
        error: of_normals + of_heights + 8.0 * U * (one.height + other.height),
    }
}

/// Takes the current part on by a plane: to the first node inside of it, to the second one outside. A part
/// that lies on both sides is divided, and its outer part waits. Returns where the current part goes, and
/// what may be on the wrong side.
fn sort(plane: &Plane, to: [u32; 2], caps: u32, scratch: &mut Scratch) -> (u32, f64) {
    let [inside, outside] = to;
    match side(plane, &scratch.current, &mut scratch.values) {
        Side::Inside(false) => (inside, 0.0),
        Side::Outside(false) => (outside, 0.0),
        Side::Inside(true) => (inside, plane.uncertain(&scratch.current)),
        Side::Outside(true) => (outside, plane.uncertain(&scratch.current)),
        Side::Both => {
            let unsure = plane.uncertain(&scratch.current);
            let start = scratch.corners.len();
            scratch.inside.clear();
            split(
                plane,
                &scratch.current,
                &scratch.values,
                &mut scratch.inside,
                &mut scratch.corners,
            );
            std::mem::swap(&mut scratch.current, &mut scratch.inside);
            if scratch.corners.len() - start < 3 {
                scratch.corners.truncate(start);
            } else {
                scratch.waiting.push(Waiting {
                    node: outside,
                    start,
                    caps,
                });
            }
            (inside, unsure)
        }
    }
}

/// The caps of a part with another one, which may hold some of them, or be held.
fn add(cap: Cap, caps: u32, scratch: &mut Scratch, bound: &mut f64) -> u32 {
    let mut at = caps;
    scratch.of_part.clear();
    while at != NONE {
        let (other, before) = scratch.caps[at as usize];
        if other.holds(&cap, SAME_CAP) {
            if !other.holds(&cap, 0.0) {
                *bound += 2.0 * SAME_CAP;
            }
            return caps;
        }
        scratch.of_part.push(other);
        at = before;
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

/// Ends the current part as free of what is within reach.
fn free(caps: u32, scratch: &mut Scratch, ends: &mut impl Ends) {
    scratch.of_part.clear();
    let mut at = caps;
    while at != NONE {
        let (cap, before) = scratch.caps[at as usize];
        scratch.of_part.push(cap);
        at = before;
    }
    ends.free(&scratch.current, &scratch.of_part);
}
