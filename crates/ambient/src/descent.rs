//! The descent of a part of the sphere of directions through a partition (`visibilityQuery`, Algorithm 1).
//! Hyperplanes that pass through the part divide it, and each piece ends in a class.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::hyperplane::plane;
use crate::items::{Face, HidingRange, ItemKind, Items};
use crate::lambert::{Cap, CapCoverage};
use crate::partition::{ClassGrowth, Partition, PartitionNode};
use crate::polygon::{Corner, Plane, Side, side, split};
use crate::receivers::ReceiverHull;

/// The index that stands for an empty list of caps.
const NONE: u32 = u32::MAX;
/// Maximum distance, in radians, between the borders of two caps that count as one cap.
const SAME_CAP: f64 = 1e-12;

/// A consumer of the parts of the sphere of directions that reach a leaf of the partition.
pub trait PartSink {
    /// Receives a part whose directions outside the caps meet no face within the hiding range.
    fn free(&mut self, part: &[Corner], caps: &[Cap]);
    /// Receives a part whose directions meet the face with the number `face`.
    fn met(&mut self, face: u32, part: &[Corner]);
}

/// A part of the sphere of directions that waits for its descent.
struct WaitingPart {
    /// The number of the node at which the descent continues.
    node: u32,
    /// The index of the part's first corner in `Scratch::corners`. The last waiting part has all corners
    /// from this index on.
    start: usize,
    /// The index of the part's last cap in `Scratch::caps`, or [`NONE`].
    caps: u32,
}

/// The reusable memory of descents.
#[derive(Default)]
pub struct Scratch {
    corners: Vec<Corner>,
    waiting: Vec<WaitingPart>,
    current: Vec<Corner>,
    values: Vec<f64>,
    inside: Vec<Corner>,
    /// The caps of all parts. Each cap has the index of the previous cap of the same part, or [`NONE`].
    caps: Vec<(Cap, u32)>,
    of_part: Vec<Cap>,
}

/// A part of the sphere of directions about the point `x`, and the distance within which faces hide.
struct SpherePart<'a> {
    corners: &'a [Corner],
    x: DVec3,
    distance: f64,
}

impl SpherePart<'_> {
    /// Returns true if an item may hide some directions of the part.
    ///
    /// Returns false if all corners of the item lie beyond one of the part's borders, or if the item's plane
    /// lies beyond the distance. If doubles cannot decide, the result is true.
    fn may_meet(&self, items: &Items<'_>, id: u32) -> bool {
        if let ItemKind::Face(face) = items.item(id).what {
            let face = items.face(face);
            let height = face.normal.dot(face.at - self.x).abs();
            if height > self.distance * face.normal.length() * (1.0 + 1e-9) {
                return false;
            }
        }
        let hull = items.hull(id);
        // The direction of a corner and the plane of a border each have a few rounding errors.
        let far = 32.0 * U * items.item(id).far;
        self.corners
            .iter()
            .all(|v| hull.extent(v.border).1 - v.border.dot(self.x) > -far)
    }
}

/// A ray partition with its items and its source.
pub struct RayPartition<'a, 'b> {
    /// The tree of the partition.
    pub tree: &'a mut Partition,
    /// The items of the tree.
    pub items: &'a mut Items<'b>,
    /// The convex set that contains the origins of rays.
    pub source: &'a ReceiverHull,
    /// Maximum memory of the tree and its items, in bytes.
    ///
    /// If the tree and its items need more memory, the tree is cleared, and unfinished parts start again at
    /// the root. The items of a query remain until the query ends: see [`Self::begin`].
    pub bytes: usize,
    /// Maximum number of list entries that the classes of the tree may receive. A descent that exceeds this
    /// number ends without a result.
    pub most_told: usize,
}

impl RayPartition<'_, '_> {
    /// Prepares the query of a receiver. Face numbers that earlier queries passed to a [`PartSink`] become
    /// invalid.
    ///
    /// If the items use more than half of [`Self::bytes`], this function clears the tree and the items that
    /// earlier queries opened.
    pub fn begin(&mut self) {
        if self.items.bytes() > self.bytes / 2 {
            self.items.forget();
            self.tree.clear();
        }
    }

    /// Returns the maximum memory of the tree, in bytes. The tree gets at least a quarter of [`Self::bytes`],
    /// regardless of the items; otherwise every part would clear the tree.
    fn most(&self) -> usize {
        self.bytes
            .saturating_sub(self.items.bytes())
            .max(self.bytes / 4)
    }

    /// Divides a part of the directions from `x` until every piece reaches a leaf, and passes the pieces to
    /// `ends`.
    ///
    /// `x` is a point of the source, relative to the source's origin. Returns a bound on the cosine-weighted
    /// area, divided by π, that may have reached a wrong leaf. Returns `None` if the classes received more
    /// than [`Self::most_told`] list entries; some pieces then did not reach a leaf.
    pub fn descend(
        &mut self,
        x: DVec3,
        part: &[Corner],
        scratch: &mut Scratch,
        ends: &mut impl PartSink,
    ) -> Option<f64> {
        let reach = *self.items.reach();
        let mut bound = 0.0;
        scratch.caps.clear();
        scratch.corners.clear();
        scratch.corners.extend_from_slice(part);
        scratch.waiting.clear();
        scratch.waiting.push(WaitingPart {
            node: 0,
            start: 0,
            caps: NONE,
        });
        while let Some(WaitingPart {
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
                    PartitionNode::Undefined(_) => {
                        let part = SpherePart {
                            corners: &scratch.current,
                            x,
                            distance: reach.distance(),
                        };
                        let mut may = |items: &Items<'_>, id| part.may_meet(items, id);
                        match self.tree.grow(node, self.items, self.source, &mut may) {
                            ClassGrowth::Defined => {}
                            ClassGrowth::Nothing(None) => {
                                free(caps, scratch, ends);
                                break;
                            }
                            ClassGrowth::Nothing(Some(face)) => {
                                ends.met(face, &scratch.current);
                                break;
                            }
                        }
                    }
                    PartitionNode::Free => {
                        free(caps, scratch, ends);
                        break;
                    }
                    PartitionNode::Met(face) => {
                        ends.met(*face, &scratch.current);
                        break;
                    }
                    PartitionNode::Edge {
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
                    PartitionNode::Start { face, from } => {
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
                    PartitionNode::Order { faces, first } => {
                        let [one, two] = faces.map(|f| self.ahead(f, x));
                        let plane = before(one, two);
                        let unsure;
                        (node, unsure) = sort(&plane, *first, caps, scratch);
                        bound += unsure;
                    }
                    PartitionNode::Near { face, beyond } => {
                        let (face, beyond) = (*face, *beyond);
                        let ahead = self.ahead(face, x);
                        match reach {
                            HidingRange::Distance(distance) => {
                                let (cap, unsure) = ahead.cap(distance);
                                let covered = cap
                                    .map_or(CapCoverage::None, |cap| cap.covers(&scratch.current));
                                if covered != CapCoverage::None {
                                    ends.met(face, &scratch.current);
                                }
                                if covered == CapCoverage::All {
                                    break;
                                }
                                if let (CapCoverage::Part, Some(cap)) = (covered, cap) {
                                    bound += unsure;
                                    caps = add(cap, caps, scratch, &mut bound);
                                }
                                node = beyond;
                            }
                            HidingRange::Light { normal, at, .. } => {
                                let height = normal.dot(at - x);
                                let normal = normal * height.signum();
                                let d = (at - x).length();
                                let error = [8.0 * U, 8.0 * U * d + self.source.slack];
                                let light = PlaneAhead {
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

    fn ahead(&self, face: u32, x: DVec3) -> PlaneAhead {
        PlaneAhead::new(self.items.face(face), x, self.source.slack)
    }
}

/// A plane ahead of a point, relative to that point.
#[derive(Clone, Copy)]
pub struct PlaneAhead {
    /// The unit normal of the plane, which points away from the point.
    pub normal: DVec3,
    /// The distance of the plane from the point, in units of the scene.
    pub height: f64,
    /// The bounds on the errors of the normal and of the distance.
    error: [f64; 2],
}

impl PlaneAhead {
    /// Computes a face's plane as seen from the point `x`, whose position has an error of at most `slack`.
    pub fn new(face: &Face, x: DVec3, slack: f64) -> Self {
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

    /// Computes the cap of the directions in which the plane is nearer than `distance`. The cap is `None` if
    /// no such direction exists. The second value bounds the change of the cap's cosine-weighted area,
    /// divided by π, that the errors cause.
    pub fn cap(&self, distance: f64) -> (Option<Cap>, f64) {
        let cap = Cap {
            axis: self.normal,
            cosine: self.height / distance,
        };
        // A circle is at most 2π long. Its radius changes by less than the error of its cosine divided by its
        // sine, and a small circle is short.
        (
            (cap.cosine < 1.0).then_some(cap),
            4.0 * (self.error[0] + self.error[1] / distance),
        )
    }
}

/// Computes the plane through the point that bounds the directions in which rays meet the plane `one` before
/// the plane `other`. These are the directions with m·ω > 0, because the distance to a plane along ω is
/// height / (normal·ω).
fn before(one: PlaneAhead, other: PlaneAhead) -> Plane {
    let m = one.normal * other.height - other.normal * one.height;
    let of_normals = one.error[0] * other.height + other.error[0] * one.height;
    let of_heights = one.error[1] + other.error[1];
    Plane {
        m,
        error: of_normals + of_heights + 8.0 * U * (one.height + other.height),
    }
}

/// Moves the current part to the node `to[0]` if the part is inside a plane, or to `to[1]` if it is outside.
///
/// Divides a part on both sides: the inner part becomes the current part, and the outer part waits. Returns
/// the number of the current part's next node, and a bound on the area that may be on the wrong side.
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
                scratch.waiting.push(WaitingPart {
                    node: outside,
                    start,
                    caps,
                });
            }
            (inside, unsure)
        }
    }
}

/// Adds a cap to the caps of a part, and returns the index of the part's last cap in `Scratch::caps`. Drops
/// a cap that another cap contains. Adds the area that this moves, divided by π, to `bound`.
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

/// Passes the current part with its caps to `ends` as free.
fn free(caps: u32, scratch: &mut Scratch, ends: &mut impl PartSink) {
    scratch.of_part.clear();
    let mut at = caps;
    while at != NONE {
        let (cap, before) = scratch.caps[at as usize];
        scratch.of_part.push(cap);
        at = before;
    }
    ends.free(&scratch.current, &scratch.of_part);
}
