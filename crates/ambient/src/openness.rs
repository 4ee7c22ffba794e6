//! The free share of a point's hemisphere (equation 1 of the paper): the sum of Lambert's formula over what
//! meets nothing within the distance.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::descend::{Ends, Rays, Scratch};
use crate::lambert::{Cap, cosine_without};
use crate::polygon::Corner;
use crate::receivers::Receiver;

/// What is known of a receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Openness {
    /// The free share of its hemisphere, weighted by the cosine: 0 to 1.
    pub open: f64,
    /// Bound on what rounding can have changed.
    pub bound: f64,
    /// The occluders (convex polygons of joined triangles) that hide a part of the hemisphere.
    pub occluders: u32,
    /// The parts into which the hemisphere was divided.
    pub parts: u32,
}

/// The faces that hid something, by query.
#[derive(Default)]
pub struct Seen {
    last: Vec<u64>,
    query: u64,
}

impl Seen {
    /// Begins another query.
    pub fn begin(&mut self) {
        self.query += 1;
    }

    /// Forgets all; the faces are others now.
    pub fn clear(&mut self) {
        self.last.clear();
    }

    /// Whether a face is new in this query.
    pub fn is_new(&mut self, face: u32) -> bool {
        if self.last.len() <= face as usize {
            self.last.resize(face as usize + 1, 0);
        }
        std::mem::replace(&mut self.last[face as usize], self.query) != self.query
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

/// Adds up what is free.
struct OpennessSum<'a> {
    n: DVec3,
    answer: Openness,
    seen: &'a mut Seen,
    cuts: &'a mut Vec<f64>,
}

impl Ends for OpennessSum<'_> {
    fn free(&mut self, part: &[Corner], caps: &[Cap]) {
        self.answer.open += cosine_without(self.n, part, caps, self.cuts);
        self.answer.parts += 1;
    }

    fn met(&mut self, face: u32, _: &[Corner]) {
        self.answer.parts += 1;
        self.answer.occluders += u32::from(self.seen.is_new(face));
    }
}

/// The openness of a receiver of a source, by the partition of a union; none when the descent was given up.
pub fn open(
    rays: &mut Rays<'_, '_>,
    receiver: &Receiver,
    scratch: &mut Scratch,
    (seen, cuts): (&mut Seen, &mut Vec<f64>),
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
    // Each part's area is a sum of a few angles.
    answer.bound = bound + f64::from(answer.parts) * 16.0 * U;
    answer.open = answer.open.clamp(0.0, 1.0);
    Some(answer)
}
