//! The openness of a receiver (equation 1 of the paper): the sum of Lambert's formula over the parts of the
//! hemisphere that meet no triangle within the distance.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::descent::{PartSink, RayPartition, Scratch};
use crate::lambert::{Cap, cosine_without};
use crate::polygon::Corner;
use crate::receivers::Receiver;

/// The openness of a receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Openness {
    /// The free fraction of the receiver's hemisphere, weighted by the cosine, from 0 to 1.
    pub open: f64,
    /// A bound on the effect of rounding errors on `open`.
    pub bound: f64,
    /// The number of occluders (convex polygons of joined triangles) that hide a part of the hemisphere.
    pub occluders: u32,
    /// The number of parts into which the hemisphere was divided.
    pub parts: u32,
}

/// The faces that hid a part of a hemisphere: for each face, the number of the last query in which the face
/// hid a part.
#[derive(Default)]
pub struct SeenFaces {
    last: Vec<u64>,
    query: u64,
}

impl SeenFaces {
    /// Begins the next query. All faces are new in this query.
    pub fn begin(&mut self) {
        self.query += 1;
    }

    /// Removes all faces. Call this before the face numbers of other [`Items`](crate::items::Items).
    pub fn clear(&mut self) {
        self.last.clear();
    }

    /// Returns true if the face is new in this query, and marks the face.
    pub fn is_new(&mut self, face: u32) -> bool {
        if self.last.len() <= face as usize {
            self.last.resize(face as usize + 1, 0);
        }
        std::mem::replace(&mut self.last[face as usize], self.query) != self.query
    }
}

/// Returns the quarters of the hemisphere over a unit vector, as spherical triangles.
pub fn quarters(n: DVec3) -> [[Corner; 3]; 4] {
    let (u, v) = n.any_orthonormal_pair();
    let v = if u.cross(v).dot(n) > 0.0 { v } else { -v };
    let around = [u, v, -u, -v];
    std::array::from_fn(|k| {
        let (a, b) = (around[k], around[(k + 1) % 4]);
        [(n, b), (a, n), (b, a)].map(|(at, border)| Corner { at, border })
    })
}

/// The sum over the free parts of a receiver's hemisphere.
struct OpennessSum<'a> {
    n: DVec3,
    answer: Openness,
    seen: &'a mut SeenFaces,
    cuts: &'a mut Vec<f64>,
}

impl PartSink for OpennessSum<'_> {
    fn free(&mut self, part: &[Corner], caps: &[Cap]) {
        self.answer.open += cosine_without(self.n, part, caps, self.cuts);
        self.answer.parts += 1;
    }

    fn met(&mut self, face: u32, _: &[Corner]) {
        self.answer.parts += 1;
        self.answer.occluders += u32::from(self.seen.is_new(face));
    }
}

/// Computes the openness of a receiver of a source, by the partition of a union. Returns `None` if the
/// descent exceeded [`RayPartition::most_told`].
pub fn open(
    rays: &mut RayPartition<'_, '_>,
    receiver: &Receiver,
    scratch: &mut Scratch,
    seen: &mut SeenFaces,
    cuts: &mut Vec<f64>,
) -> Option<Openness> {
    let x = receiver.point - rays.source.origin;
    let n = receiver.normal.normalize();
    seen.begin();
    rays.begin();
    let mut sum = OpennessSum {
        n,
        answer: Openness::default(),
        seen,
        cuts,
    };
    let mut bound = 0.0;
    for quarter in quarters(n) {
        bound += rays.descend(x, &quarter, scratch, &mut sum)?;
    }
    let mut answer = sum.answer;
    // The area of each part is a sum of a few angles with rounding errors.
    answer.bound = bound + f64::from(answer.parts) * 16.0 * U;
    answer.open = answer.open.clamp(0.0, 1.0);
    Some(answer)
}
