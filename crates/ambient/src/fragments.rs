//! What a point sees first, in fragments: for each of them a triangle and the directions in which it is seen
//! (section 4.2 of the paper), what it takes of the hemisphere, and the falloff.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::arcs::outline;
use crate::descend::{Ahead, Ends, Rays, Scratch};
use crate::falloff;
use crate::items::Face;
use crate::lambert::{Cap, Covered, cosine, cosine_without};
use crate::openness::{Openness, Seen, quarters};
use crate::polygon::Corner;
use crate::receivers::Receiver;

/// The circle of the distance is given by directions at most this many radians apart.
const STEP: f64 = std::f64::consts::PI / 36.0;

/// A part of the hemisphere in which one polygon is seen first, within the distance.
#[derive(Clone, Debug)]
pub struct Fragment {
    /// The polygon's number among the blockers; of answers, the triangle.
    pub polygon: u32,
    /// The directions of its corners, unit vectors in the order in which they turn to the left as seen from
    /// outside of the sphere. The circle of the distance is given by points, so that it is cut short a
    /// little.
    pub directions: Vec<DVec3>,
    /// Its share of the hemisphere, weighted by the cosine; the circle of the distance counts as it is.
    pub factor: f64,
}

/// How far things darken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Falloff {
    /// What is nearer than the distance hides.
    #[default]
    None,
    /// What is met at the distance d leaves √(d/D).
    Sqrt,
}

struct Collect<'a, F: Fn(u32) -> Face> {
    n: DVec3,
    x: DVec3,
    slack: f64,
    distance: f64,
    falloff: Falloff,
    answer: Openness,
    seen: &'a mut Seen,
    cuts: &'a mut Vec<f64>,
    face: F,
    fragments: Option<Vec<Fragment>>,
}

impl<F: Fn(u32) -> Face> Ends for Collect<'_, F> {
    fn free(&mut self, part: &[Corner], _: &[Cap]) {
        self.answer.open += cosine(self.n, part);
        self.answer.parts += 1;
    }

    fn met(&mut self, face: u32, part: &[Corner]) {
        self.answer.parts += 1;
        let f = (self.face)(face);
        let (cap, unsure) = Ahead::of(&f, self.x, self.slack).cap(self.distance);
        let whole = cosine(self.n, part);
        let covered = cap.map_or(Covered::None, |cap| cap.covers(part));
        let (Some(cap), Covered::Part | Covered::All) = (cap, covered) else {
            self.answer.open += whole;
            return;
        };
        let beyond = match covered {
            Covered::Part => {
                self.answer.bound += unsure;
                cosine_without(self.n, part, &[cap], self.cuts)
            }
            _ => 0.0,
        };
        self.answer.open += beyond;
        if self.falloff == Falloff::Sqrt {
            let (counts, error) = falloff::counts(self.n, part, &cap);
            self.answer.open += counts;
            // The root of the height by the distance changes by half as much again.
            self.answer.bound += error + unsure;
        }
        self.answer.occluders += u32::from(self.seen.is_new(face));
        if let Some(fragments) = &mut self.fragments {
            let directions = match covered {
                Covered::All => part.iter().map(|c| c.at).collect(),
                _ => outline(part, &cap, STEP),
            };
            fragments.push(Fragment {
                polygon: f.polygon,
                directions,
                factor: whole - beyond,
            });
        }
    }
}

/// The openness of a receiver of a source, by the partition of first hits, and its fragments if they are
/// wanted. They are as the partition divided them: one polygon may have several. None when the descent was
/// given up.
pub fn first(
    rays: &mut Rays<'_, '_>,
    receiver: &Receiver,
    (distance, falloff, wanted): (f64, Falloff, bool),
    scratch: &mut Scratch,
    (seen, cuts): (&mut Seen, &mut Vec<f64>),
) -> Option<(Openness, Vec<Fragment>)> {
    let x = receiver.point - rays.source.origin;
    let n = receiver.normal.normalize();
    seen.begin();
    rays.begin();
    let mut pieces = Pieces::default();
    let mut bound = 0.0;
    for quarter in quarters(n) {
        bound += rays.descend(x, &quarter, scratch, &mut pieces)?;
    }
    let mut collect = Collect {
        n,
        x,
        slack: rays.source.slack,
        distance,
        falloff,
        answer: Openness::default(),
        seen,
        cuts,
        face: |face| *rays.items.face(face),
        fragments: wanted.then(Vec::new),
    };
    for (face, range) in &pieces.parts {
        let part = &pieces.corners[range.clone()];
        match face {
            Some(face) => collect.met(*face, part),
            None => collect.free(part, &[]),
        }
    }
    let (mut answer, fragments) = (collect.answer, collect.fragments);
    answer.bound += bound + f64::from(answer.parts) * 32.0 * U;
    answer.open = answer.open.clamp(0.0, 1.0);
    Some((answer, fragments.unwrap_or_default()))
}

/// The parts in the order in which they ended, with their faces.
#[derive(Default)]
struct Pieces {
    corners: Vec<Corner>,
    parts: Vec<(Option<u32>, std::ops::Range<usize>)>,
}

impl Pieces {
    fn push(&mut self, face: Option<u32>, part: &[Corner]) {
        let start = self.corners.len();
        self.corners.extend_from_slice(part);
        self.parts.push((face, start..self.corners.len()));
    }
}

impl Ends for Pieces {
    fn free(&mut self, part: &[Corner], _: &[Cap]) {
        self.push(None, part);
    }

    fn met(&mut self, face: u32, part: &[Corner]) {
        self.push(Some(face), part);
    }
}
