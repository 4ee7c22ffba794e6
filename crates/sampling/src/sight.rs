//! Sight lines among triangles of all kinds: the triangle at the end of a line, and those it passes.
//!
//! A line ends at the first triangle that blocks. The see-through triangles before that are found by tracing
//! among them alone, again from behind each one found. This module is all that the samplers know of kinds
//! while they trace; a scene of opaque triangles costs nothing here.

use sightline_scene::Kind;

use crate::backend::{Backend, LineSet};
use crate::cube::SKY;
use crate::error::BackendError;
use crate::packet::{LANES, LineTracer, Packet};
use crate::prepared::Traced;

/// The see-through triangles on the lines of the packets traced last.
#[derive(Clone, Debug, Default)]
pub struct Passed {
    /// Line (packet · 16 + lane) and triangle, ascending by line, then along the line.
    found: Vec<(u32, u32)>,
    /// For each line the place of its first triangle in `found`, and the end; empty when none was found.
    starts: Vec<u32>,
    /// The rays of the next step; kept to reuse its memory.
    probes: Vec<Packet>,
}

impl Passed {
    /// The see-through triangles that a line passes before its end.
    pub fn on(&self, packet: usize, lane: usize) -> impl Iterator<Item = u32> + Clone + use<'_> {
        let line = packet * LANES + lane;
        let range = match self.starts.get(line..line + 2) {
            Some([from, to]) => *from as usize..*to as usize,
            _ => 0..0,
        };
        self.found[range].iter().map(|f| f.1)
    }

    /// The same for both halves of a line.
    pub fn on_both(&self, [ahead, behind]: [usize; 2], lane: usize) -> impl Iterator<Item = u32> {
        let some = if self.starts.is_empty() { 0 } else { 2 };
        [ahead, behind].into_iter().take(some).flat_map(move |packet| self.on(packet, lane))
    }
}

/// Traces sight lines through a scene.
pub struct Sight<'a> {
    blocking: Box<dyn LineTracer + 'a>,
    see_through: Option<Box<dyn LineTracer + 'a>>,
    /// By triangle; empty when all are opaque.
    kinds: &'a [Kind],
}

impl<'a> Sight<'a> {
    /// Prepares the tracing with a backend.
    ///
    /// # Errors
    /// [`BackendError`] when the device cannot, or cannot hold the triangles.
    pub fn new(backend: &'a dyn Backend, scene: Traced<'a>) -> Result<Self, BackendError> {
        let blocking = backend.lines(LineSet::Blocking, scene.distinct)?;
        let see_through = match scene.see_through {
            [] => None,
            ids => Some(backend.lines(LineSet::SeeThrough, ids)?),
        };
        Ok(Self { blocking, see_through, kinds: scene.scene.kinds().by_triangle() })
    }

    /// A tracer of opaque triangles.
    pub fn opaque(blocking: Box<dyn LineTracer + 'a>) -> Self {
        Self { blocking, see_through: None, kinds: &[] }
    }

    /// The best number of packets per call.
    pub fn batch(&self) -> usize {
        self.blocking.batch()
    }

    /// Fills `distance` and `triangle` of every packet, and lists the see-through triangles before that. A
    /// line that ends at an occluder-only triangle has its distance, and [`SKY`] as its triangle.
    ///
    /// `step` is the least distance from a see-through triangle to the next search, in world units.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    pub fn trace(&self, packets: &mut [Packet], passed: &mut Passed, step: f32) -> Result<(), BackendError> {
        self.blocking.trace(packets)?;
        self.pass(packets, passed, step, true)
    }

    /// The same for rays of different directions, each traced by itself.
    ///
    /// # Errors
    /// As [`Sight::trace`].
    pub fn trace_each(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
    ) -> Result<(), BackendError> {
        self.blocking.trace_each(packets)?;
        self.pass(packets, passed, step, false)
    }

    fn pass(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
        coherent: bool,
    ) -> Result<(), BackendError> {
        passed.found.clear();
        passed.starts.clear();
        if self.kinds.is_empty() {
            return Ok(());
        }
        if let Some(tracer) = &self.see_through {
            passed.probes.clear();
            passed.probes.extend(packets.iter().cloned());
            tracer.trace_within(&mut passed.probes, coherent)?;
            // Lines that have found one, in the order of their probes, and how far along the line each probe
            // begins. Most lines find none.
            let hit = |probes: &[Packet], place: &(usize, usize)| probes[place.0].triangle[place.1] != SKY;
            let lanes = packets.iter().enumerate().flat_map(|(p, k)| (0..k.count).map(move |l| (p, l)));
            let mut places: Vec<(usize, usize)> = lanes.filter(|at| hit(&passed.probes, at)).collect();
            let mut open: Vec<(u32, f32)> =
                places.iter().map(|(p, l)| ((p * LANES + l) as u32, 0.0)).collect();
            while !open.is_empty() {
                let mut next = Vec::new();
                for ((line, start), (p, l)) in open.iter().zip(&places) {
                    let (packet, lane) = (&packets[*line as usize / LANES], *line as usize % LANES);
                    let probe = &passed.probes[*p];
                    let at = start + probe.distance[*l];
                    if probe.triangle[*l] == SKY || at > packet.distance[lane] {
                        continue;
                    }
                    passed.found.push((*line, probe.triangle[*l]));
                    let (origin, direction) = packet.ray(lane);
                    let mut hit = Packet::default();
                    hit.push([0, 1, 2].map(|a| origin[a] + direction[a] * at), direction);
                    // One unit in the last place at least, so that the search ends.
                    let after = (at + hit.advance(0, step)).max(at.next_up());
                    if after.is_finite() && after < packet.distance[lane] {
                        next.push((*line, after));
                    }
                }
                passed.probes.clear();
                places.clear();
                for (line, after) in &next {
                    let (origin, direction) = packets[*line as usize / LANES].ray(*line as usize % LANES);
                    if passed.probes.last().is_none_or(|p| p.count == LANES) {
                        passed.probes.push(Packet::default());
                    }
                    let place = passed.probes.len() - 1;
                    places.push((place, passed.probes[place].count));
                    let probe = &mut passed.probes[place];
                    // Up to the end of the line.
                    let end = packets[*line as usize / LANES].distance[*line as usize % LANES];
                    probe.distance[probe.count] = end - after;
                    probe.push([0, 1, 2].map(|a| origin[a] + direction[a] * after), direction);
                }
                open = next;
                tracer.trace_within(&mut passed.probes, false)?;
            }
            // Stable, so along each line the order stays.
            passed.found.sort_by_key(|f| f.0);
            if !passed.found.is_empty() {
                let mut at = 0;
                for line in 0..=(packets.len() * LANES) as u32 {
                    while passed.found.get(at).is_some_and(|f| f.0 < line) {
                        at += 1;
                    }
                    passed.starts.push(at as u32);
                }
            }
        }
        for packet in packets {
            for triangle in packet.triangle.iter_mut().filter(|t| **t != SKY) {
                if !self.kinds[*triangle as usize].shows() {
                    *triangle = SKY;
                }
            }
        }
        Ok(())
    }
}
