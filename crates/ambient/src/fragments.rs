//! The first hits of a receiver, as fragments (section 4.2 of the paper): each has a triangle, the directions
//! in which the triangle is visible, and a fraction of the hemisphere. This module also applies the falloff.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::arcs::outline;
use crate::descent::{PartSink, PlaneAhead, RayPartition, Scratch};
use crate::falloff;
use crate::items::Face;
use crate::lambert::{Cap, CapCoverage, cosine, cosine_without};
use crate::openness::{Openness, SeenFaces, quarters};
use crate::polygon::Corner;
use crate::receivers::Receiver;

/// Maximum angle, in radians, between consecutive directions that approximate a circle: the directions in
/// which a plane is exactly at the distance of the settings.
const STEP: f64 = std::f64::consts::PI / 36.0;

/// A part of the hemisphere in which one polygon is the first hit within the distance.
#[derive(Clone, Debug)]
pub struct Fragment {
    /// The number of the polygon among the blockers. In results of the solver, the id of the triangle.
    pub polygon: u32,
    /// The directions of the fragment's corners: unit vectors, counter-clockwise as seen from outside the
    /// sphere. If the polygon reaches beyond the distance, directions at the distance approximate a circle by
    /// chords, so the area of these corners is slightly too small.
    pub directions: Vec<DVec3>,
    /// The fraction of the hemisphere that the fragment covers, weighted by the cosine, from 0 to 1. The
    /// fraction is computed with the exact circle, without chords.
    pub factor: f64,
}

/// The dependence of the openness of a direction on the distance of the face that the direction meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Falloff {
    /// A face nearer than the distance D hides its directions completely.
    #[default]
    None,
    /// A face at the distance d < D leaves the fraction √(d/D) of its directions open.
    Sqrt,
}

struct FragmentCollector<'a, F: Fn(u32) -> Face> {
    n: DVec3,
    x: DVec3,
    slack: f64,
    distance: f64,
    falloff: Falloff,
    answer: Openness,
    seen: &'a mut SeenFaces,
    cuts: &'a mut Vec<f64>,
    face: F,
    fragments: Option<Vec<Fragment>>,
}

impl<F: Fn(u32) -> Face> PartSink for FragmentCollector<'_, F> {
    fn free(&mut self, part: &[Corner], _: &[Cap]) {
        self.answer.open += cosine(self.n, part);
        self.answer.parts += 1;
    }

    fn met(&mut self, face: u32, part: &[Corner]) {
        self.answer.parts += 1;
        let f = (self.face)(face);
        let (cap, unsure) = PlaneAhead::new(&f, self.x, self.slack).cap(self.distance);
        let whole = cosine(self.n, part);
        let covered = cap.map_or(CapCoverage::None, |cap| cap.covers(part));
        let (Some(cap), CapCoverage::Part | CapCoverage::All) = (cap, covered) else {
            self.answer.open += whole;
            return;
        };
        let beyond = match covered {
            CapCoverage::Part => {
                self.answer.bound += unsure;
                cosine_without(self.n, part, &[cap], self.cuts)
            }
            _ => 0.0,
        };
        self.answer.open += beyond;
        if self.falloff == Falloff::Sqrt {
            let (counts, error) = falloff::counts(self.n, part, &cap);
            self.answer.open += counts;
            // The error of the plane's height also changes the factor √(height / distance).
            self.answer.bound += error + unsure;
        }
        self.answer.occluders += u32::from(self.seen.is_new(face));
        if let Some(fragments) = &mut self.fragments {
            let directions = match covered {
                CapCoverage::All => part.iter().map(|c| c.at).collect(),
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

/// Computes the openness of a receiver of a source, by the partition of first hits.
///
/// Computes the fragments, too, if `wants_fragments` is true. The partition may have divided the visible part
/// of a polygon, so a polygon may have several fragments. Returns `None` if the descent exceeded
/// [`RayPartition::most_told`].
pub fn first(
    rays: &mut RayPartition<'_, '_>,
    receiver: &Receiver,
    distance: f64,
    falloff: Falloff,
    wants_fragments: bool,
    scratch: &mut Scratch,
    seen: &mut SeenFaces,
    cuts: &mut Vec<f64>,
) -> Option<(Openness, Vec<Fragment>)> {
    let x = receiver.point - rays.source.origin;
    let n = receiver.normal.normalize();
    seen.begin();
    rays.begin();
    let mut pieces = CollectedFragments::default();
    let mut bound = 0.0;
    for quarter in quarters(n) {
        bound += rays.descend(x, &quarter, scratch, &mut pieces)?;
    }
    let mut collect = FragmentCollector {
        n,
        x,
        slack: rays.source.slack,
        distance,
        falloff,
        answer: Openness::default(),
        seen,
        cuts,
        face: |face| *rays.items.face(face),
        fragments: wants_fragments.then(Vec::new),
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

/// The parts of the hemisphere in the order in which they reached leaves, each with the number of its face
/// and the range of its corners in `corners`. A part that meets no face has the number `None`.
#[derive(Default)]
struct CollectedFragments {
    corners: Vec<Corner>,
    parts: Vec<(Option<u32>, std::ops::Range<usize>)>,
}

impl CollectedFragments {
    fn push(&mut self, face: Option<u32>, part: &[Corner]) {
        let start = self.corners.len();
        self.corners.extend_from_slice(part);
        self.parts.push((face, start..self.corners.len()));
    }
}

impl PartSink for CollectedFragments {
    fn free(&mut self, part: &[Corner], _: &[Cap]) {
        self.push(None, part);
    }

    fn met(&mut self, face: u32, part: &[Corner]) {
        self.push(Some(face), part);
    }
}
