//! Sight lines among triangles of all kinds: the triangle at the end of a line, and those it passes.
//!
//! A line ends at the first triangle that blocks. Masked triangles before that are found by tracing among
//! them alone, again from behind each one whose texel is open; where a texel blocks, the line ends there.
//! The see-through triangles before the end are found in the same way. The texel is looked up on the host,
//! so it is the same on every backend. This module is all that the samplers know of kinds while they trace;
//! a scene of opaque triangles costs nothing here. Triangles that are met from behind and have one side
//! ([`sightline_scene::Sides`]) are left out by the backends' tracers.

use sightline_scene::{Aabb, Kind, Scene};

use crate::backend::{Backend, LineSet};
use crate::cube::SKY;
use crate::error::BackendError;
use crate::lines::device::{DeviceBlock, Rounds};
use crate::packet::{LANES, LineTracer, Packet, PassingTracer};
use crate::prepared::Traced;

/// The triangles that the lines of the packets traced last show before their ends: see-through ones. At the
/// end of a line these can also be masked ones, beside the triangle at which the line ends and in its
/// plane.
#[derive(Clone, Debug, Default)]
pub struct Passed {
    /// Line (packet · 16 + lane), triangle and distance, ascending by line, then along the line.
    found: Vec<(u32, u32, f32)>,
    /// For each line the place of its first triangle in `found`, and the end; empty when none was found.
    starts: Vec<u32>,
    /// The rays of the next step; kept to reuse its memory.
    probes: Vec<Packet>,
}

impl Passed {
    /// The triangles that a line shows beside the one at its end.
    pub fn on(&self, packet: usize, lane: usize) -> impl Iterator<Item = u32> + Clone + use<'_> {
        self.on_at(packet, lane).map(|(triangle, _)| triangle)
    }

    /// The same with their distances from the line's origin, in lengths of its direction.
    pub fn on_at(
        &self,
        packet: usize,
        lane: usize,
    ) -> impl Iterator<Item = (u32, f32)> + Clone + use<'_> {
        let line = packet * LANES + lane;
        let range = match self.starts.get(line..line + 2) {
            Some([from, to]) => *from as usize..*to as usize,
            _ => 0..0,
        };
        self.found[range].iter().map(|f| (f.1, f.2))
    }

    /// Whether no line shows any.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// Calls `each` with those of both halves of a line.
    #[inline]
    pub fn each_on_both(&self, halves: [usize; 2], lane: usize, mut each: impl FnMut(u32)) {
        if !self.is_empty() {
            halves
                .into_iter()
                .flat_map(|packet| self.on(packet, lane))
                .for_each(&mut each);
        }
    }
}

/// The least distance from a see-through or masked triangle to the next search in a scene of this size, in
/// world units: single precision tells such places apart.
pub fn least_step(bounds: Aabb) -> f32 {
    (bounds.max - bounds.min).max_element() / (1 << 24) as f32
}

/// Traces sight lines through a scene.
pub struct SightLineTracer<'a> {
    blocking: Box<dyn LineTracer + 'a>,
    see_through: SeeThrough<'a>,
    masked: Option<Masked<'a>>,
    /// By triangle; empty when all are opaque.
    kinds: &'a [Kind],
    /// Whether some triangles have one side.
    one_way: bool,
    /// Lines end at this distance from their origin, in world units; infinite when they do not.
    far: f32,
}

/// How the see-through triangles of a scene are found.
enum SeeThrough<'a> {
    /// There are none.
    Absent,
    /// By themselves, when the ends of the lines are known.
    After(Box<dyn LineTracer + 'a>),
    /// Together with the ends.
    Together(Box<dyn PassingTracer + 'a>),
}

/// The masked triangles of a scene.
struct Masked<'a> {
    tracer: Box<dyn LineTracer + 'a>,
    scene: &'a Scene,
    coincident: &'a [Vec<u32>],
}

impl Masked<'_> {
    /// The masked triangles in the place of `triangle`, itself included.
    fn class<'b>(&'b self, triangle: &'b u32) -> &'b [u32] {
        match self
            .coincident
            .binary_search_by_key(triangle, |class| class[0])
        {
            Ok(at) => &self.coincident[at],
            Err(_) => std::slice::from_ref(triangle),
        }
    }
}

/// A triangle met along a line.
struct Met {
    /// The line: packet · 16 + lane.
    line: u32,
    triangle: u32,
    /// Its distance.
    at: f32,
    /// Where the search goes on behind it.
    after: f32,
}

impl<'a> SightLineTracer<'a> {
    /// Prepares the tracing with a backend.
    ///
    /// # Errors
    /// [`BackendError`] when the device cannot, or cannot hold the triangles.
    pub fn new(backend: &'a dyn Backend, scene: Traced<'a>) -> Result<Self, BackendError> {
        let blocking = backend.lines(LineSet::Blocking, scene.distinct)?;
        let see_through = match scene.see_through {
            [] => SeeThrough::Absent,
            ids => match backend.passing(scene.distinct, ids)? {
                Some(tracer) => SeeThrough::Together(tracer),
                None => SeeThrough::After(backend.lines(LineSet::SeeThrough, ids)?),
            },
        };
        let masked = match scene.masked {
            [] => None,
            ids => Some(Masked {
                tracer: backend.lines(LineSet::Masked, ids)?,
                scene: scene.scene,
                coincident: scene.coincident,
            }),
        };
        let one_way = !scene.scene.sides().are_both();
        let kinds = scene.scene.kinds().by_triangle();
        Ok(Self {
            blocking,
            see_through,
            masked,
            kinds,
            one_way,
            far: f32::INFINITY,
        })
    }

    /// A tracer of opaque triangles.
    pub fn opaque(blocking: Box<dyn LineTracer + 'a>) -> Self {
        Self {
            blocking,
            see_through: SeeThrough::Absent,
            masked: None,
            kinds: &[],
            one_way: false,
            far: f32::INFINITY,
        }
    }

    /// The same, with lines that end at a distance from their origin, in world units.
    #[must_use]
    pub fn up_to(self, far: Option<f64>) -> Self {
        Self {
            far: far.map_or(f32::INFINITY, |far| far as f32),
            ..self
        }
    }

    /// The distance at which lines end; infinite when they do not.
    pub fn far(&self) -> f32 {
        self.far
    }

    /// Whether a line can be free in one direction and not in the other, because some triangles have one
    /// side. What a ray shows holds then along the ray only, and not for the whole line.
    pub fn is_one_way(&self) -> bool {
        self.one_way
    }

    /// Puts a block on the backend's device, if it casts whole rounds by itself and all triangles are opaque.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    pub fn rounds(
        &self,
        block: &DeviceBlock<'_>,
    ) -> Result<Option<Box<dyn Rounds + '_>>, BackendError> {
        match &self.see_through {
            SeeThrough::Absent if self.masked.is_none() && self.kinds.is_empty() => {
                self.blocking.rounds(block)
            }
            _ => Ok(None),
        }
    }

    /// The best number of packets per call.
    pub fn batch(&self) -> usize {
        self.blocking.batch()
    }

    /// Fills `distance` and `triangle` of every packet, and lists what each line shows beside that. A line
    /// that ends at an occluder-only triangle has its distance, and [`SKY`] as its triangle.
    ///
    /// `step` is the least distance from a see-through or masked triangle to the next search, in world units.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    pub fn trace(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
    ) -> Result<(), BackendError> {
        self.block(packets, passed, true)?;
        self.pass(packets, passed, step, true)
    }

    /// Traces rays of different directions, each by itself, as [`Self::trace`] does for packets.
    ///
    /// # Errors
    /// As [`SightLineTracer::trace`].
    pub fn trace_each(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
    ) -> Result<(), BackendError> {
        self.block(packets, passed, false)?;
        self.pass(packets, passed, step, false)
    }

    /// Finds where each line ends, and the see-through triangles before that if both are found together.
    fn block(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        coherent: bool,
    ) -> Result<(), BackendError> {
        passed.found.clear();
        passed.starts.clear();
        let is_bounded = self.far < f32::INFINITY;
        for packet in packets.iter_mut().filter(|_| is_bounded) {
            for lane in 0..packet.count {
                packet.distance[lane] = self.far / packet.length(lane);
            }
        }
        match (&self.see_through, is_bounded) {
            (SeeThrough::Together(tracer), true) => {
                tracer.trace_passing(packets, coherent, &mut passed.found)?;
            }
            (SeeThrough::Together(tracer), false) => {
                packets
                    .iter_mut()
                    .for_each(|p| p.distance = [f32::INFINITY; LANES]);
                tracer.trace_passing(packets, coherent, &mut passed.found)?;
            }
            (_, true) => self.blocking.trace_within(packets, coherent)?,
            (_, false) if coherent => self.blocking.trace(packets)?,
            (_, false) => self.blocking.trace_each(packets)?,
        }
        if !is_bounded {
            return Ok(());
        }
        for packet in packets {
            for lane in 0..packet.count {
                let end = self.far / packet.length(lane);
                // Also where nothing was met, and the distance is infinite.
                if packet.distance[lane] > end || packet.triangle[lane] == SKY {
                    (packet.distance[lane], packet.triangle[lane]) = (end, SKY);
                }
            }
        }
        Ok(())
    }

    fn pass(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
        coherent: bool,
    ) -> Result<(), BackendError> {
        if self.kinds.is_empty() {
            return Ok(());
        }
        // Masked triangles that are shown at the end of a line, beside the one at which it ends.
        let mut beside: Vec<(u32, u32, f32)> = Vec::new();
        if let Some(masked) = &self.masked {
            search(
                &*masked.tracer,
                packets,
                &mut passed.probes,
                step,
                coherent,
                |packet, lane, met| {
                    let (origin, direction) = packet.ray(lane);
                    let class = masked.class(&met.triangle).iter().copied();
                    let mut closed =
                        class.filter(|t| masked.scene.mask_blocks(*t, origin, direction));
                    let Some(first) = closed.next() else {
                        return true;
                    };
                    if met.after >= packet.distance[lane] {
                        // In the plane of the triangle at the end, like a poster on a wall: both are shown.
                        beside.push((met.line, first, met.at));
                    } else {
                        packet.distance[lane] = met.at;
                        packet.triangle[lane] = first;
                    }
                    beside.extend(closed.map(|t| (met.line, t, met.at)));
                    false
                },
            )?;
        }
        let found = &mut passed.found;
        if let SeeThrough::After(tracer) = &self.see_through {
            search(
                &**tracer,
                packets,
                &mut passed.probes,
                step,
                coherent,
                |_, _, met| {
                    found.push((met.line, met.triangle, met.at));
                    true
                },
            )?;
        }
        if let SeeThrough::Together(_) = &self.see_through {
            if self.masked.is_some() {
                // Masked triangles can have ended the lines sooner.
                let end = |line: usize| packets[line / LANES].distance[line % LANES];
                found.retain(|f| f.2 <= end(f.0 as usize));
            }
            found.sort_unstable_by(|a, b| {
                a.0.cmp(&b.0).then(a.2.total_cmp(&b.2)).then(a.1.cmp(&b.1))
            });
            found.dedup_by_key(|f| (f.0, f.1));
        }
        let is_sorted = matches!(self.see_through, SeeThrough::Together(_)) && beside.is_empty();
        passed.found.append(&mut beside);
        if !is_sorted {
            // Stable, so along each line the order stays.
            passed.found.sort_by_key(|f| f.0);
        }
        if !passed.found.is_empty() {
            let mut at = 0;
            for line in 0..=(packets.len() * LANES) as u32 {
                while passed.found.get(at).is_some_and(|f| f.0 < line) {
                    at += 1;
                }
                passed.starts.push(at as u32);
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

/// Calls `meet` for each triangle of a tracer that the packets' lines meet up to their ends, along each
/// line, with the packet and the lane of the line. `meet` may let the line end sooner, and returns whether
/// the search goes on behind the triangle.
fn search(
    tracer: &dyn LineTracer,
    packets: &mut [Packet],
    probes: &mut Vec<Packet>,
    step: f32,
    coherent: bool,
    mut meet: impl FnMut(&mut Packet, usize, Met) -> bool,
) -> Result<(), BackendError> {
    probes.clear();
    probes.extend(packets.iter().cloned());
    tracer.trace_within(probes, coherent)?;
    // Lines that have found one, in the order of their probes, and how far along the line each probe begins.
    // Most lines find none.
    let hit = |probes: &[Packet], place: &(usize, usize)| probes[place.0].triangle[place.1] != SKY;
    let lanes = packets
        .iter()
        .enumerate()
        .flat_map(|(p, k)| (0..k.count).map(move |l| (p, l)));
    let mut places: Vec<(usize, usize)> = lanes.filter(|at| hit(probes, at)).collect();
    let mut open: Vec<(u32, f32)> = places
        .iter()
        .map(|(p, l)| ((p * LANES + l) as u32, 0.0))
        .collect();
    while !open.is_empty() {
        let mut next = Vec::new();
        for ((line, start), (p, l)) in open.iter().zip(&places) {
            let (packet, lane) = (&mut packets[*line as usize / LANES], *line as usize % LANES);
            let probe = &probes[*p];
            let (triangle, at) = (probe.triangle[*l], start + probe.distance[*l]);
            if triangle == SKY || at > packet.distance[lane] {
                continue;
            }
            let (origin, direction) = packet.ray(lane);
            let mut hit = Packet::default();
            hit.push([0, 1, 2].map(|a| origin[a] + direction[a] * at), direction);
            // One unit in the last place at least, so that the search ends.
            let after = (at + hit.advance(0, step)).max(at.next_up());
            let goes_on = meet(
                packet,
                lane,
                Met {
                    line: *line,
                    triangle,
                    at,
                    after,
                },
            );
            if goes_on && after.is_finite() && after < packet.distance[lane] {
                next.push((*line, after));
            }
        }
        probes.clear();
        places.clear();
        for (line, after) in &next {
            let (origin, direction) = packets[*line as usize / LANES].ray(*line as usize % LANES);
            if probes.last().is_none_or(|p| p.count == LANES) {
                probes.push(Packet::default());
            }
            let place = probes.len() - 1;
            places.push((place, probes[place].count));
            let probe = &mut probes[place];
            // Up to the end of the line.
            let end = packets[*line as usize / LANES].distance[*line as usize % LANES];
            probe.distance[probe.count] = end - after;
            probe.push(
                [0, 1, 2].map(|a| origin[a] + direction[a] * after),
                direction,
            );
        }
        open = next;
        tracer.trace_within(probes, false)?;
    }
    Ok(())
}
