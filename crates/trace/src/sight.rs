//! Sight lines among triangles of all kinds: the triangle at the end of a line, and the triangles that the
//! line passes.
//!
//! A line ends at the first triangle that blocks. Masked triangles before this end are found by tracing only
//! among masked triangles, and again from behind each triangle whose texel is open. If a texel blocks, the
//! line ends there. The see-through triangles before the end are found in the same way. The host reads the
//! texel, so the result is the same on every backend.
//!
//! Samplers access kinds only through this module while they trace. A scene of opaque triangles has no
//! additional cost. The backends' tracers omit triangles that are met from behind and have one side
//! ([`sightline_scene::Sides`]).

use sightline_scene::{Aabb, Scene, SurfaceKind, TriangleId};

use crate::cube::SKY;
use crate::error::TracerError;
use crate::lines::device::{DeviceBlock, Rounds};
use crate::packet::{Halves, LANES, LineTracer, Packet, PassingTracer};
use crate::prepared::Traced;
use crate::tracer::{LineSet, Tracer};

/// The triangles that the last traced lines show before their ends. These triangles are see-through. At the
/// end of a line they can also be masked triangles in the plane of the triangle at which the line ends.
#[derive(Clone, Debug, Default)]
pub struct Passed {
    /// Line (packet · 16 + lane), triangle and distance, ascending by line, then along the line.
    found: Vec<(u32, u32, f32)>,
    /// The index in `found` of each line's first triangle, and the end; empty if no triangle was found.
    starts: Vec<u32>,
    /// The rays of the next step, stored to reuse their memory.
    probes: Vec<Packet>,
}

impl Passed {
    /// Returns the triangles that a line shows in addition to the triangle at its end.
    pub fn on(&self, packet: usize, lane: usize) -> impl Iterator<Item = u32> + Clone + use<'_> {
        self.on_at(packet, lane).map(|(triangle, _)| triangle)
    }

    /// Returns the triangles of [`Self::on`] with their distances from the line's origin, in lengths of its
    /// direction.
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

    /// Returns true if no line shows such triangles.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// Calls `each` with the triangles of both halves of a line.
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

/// Returns the minimum distance from a see-through or masked triangle to the next search in a scene of this
/// size, in world units. Single precision distinguishes points at this distance.
pub fn least_step(bounds: Aabb) -> f32 {
    (bounds.max - bounds.min).max_element() / (1 << 24) as f32
}

/// A tracer of sight lines through a scene of all kinds.
pub struct SightLineTracer<'a> {
    blocking: Box<dyn LineTracer + 'a>,
    see_through: SeeThrough<'a>,
    masked: Option<Masked<'a>>,
    /// The kind of each triangle; empty if all triangles are opaque.
    kinds: &'a [SurfaceKind],
    /// True if some triangles have one side.
    one_way: bool,
    /// The distance from their origin at which lines end, in world units; infinite for unlimited sight.
    far: f32,
}

/// The method that finds the see-through triangles of a scene.
enum SeeThrough<'a> {
    /// The scene has no see-through triangles.
    Absent,
    /// The triangles are found separately, after the ends of the lines.
    After(Box<dyn LineTracer + 'a>),
    /// The triangles are found together with the ends.
    Together(Box<dyn PassingTracer + 'a>),
}

/// The masked triangles of a scene.
struct Masked<'a> {
    tracer: Box<dyn LineTracer + 'a>,
    scene: &'a Scene,
    coincident: &'a [Vec<u32>],
}

impl Masked<'_> {
    /// Returns the masked triangles that coincide with `triangle`, including `triangle`.
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

/// A triangle that a line meets.
struct PassedTriangle {
    /// The line: packet · 16 + lane.
    line: u32,
    triangle: TriangleId,
    /// The distance of the triangle along the line.
    at: f32,
    /// The distance behind the triangle at which the search continues.
    after: f32,
}

impl<'a> SightLineTracer<'a> {
    /// Creates a tracer that uses a backend.
    ///
    /// # Errors
    /// [`TracerError`] if the device does not support tracing, or cannot hold the triangles.
    pub fn new(backend: &'a dyn Tracer, scene: Traced<'a>) -> Result<Self, TracerError> {
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

    /// Creates a tracer of opaque triangles.
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

    /// Returns the tracer with lines that end at a distance from their origin, in world units.
    #[must_use]
    pub fn up_to(self, far: Option<f64>) -> Self {
        Self {
            far: far.map_or(f32::INFINITY, |far| far as f32),
            ..self
        }
    }

    /// Returns the distance at which lines end, in world units; infinite for unlimited sight.
    pub fn far(&self) -> f32 {
        self.far
    }

    /// Returns true if a line can be free in one direction and not in the other, because some triangles have
    /// one side. The triangles that a ray shows are then seen only along the ray, and not along the whole
    /// line.
    pub fn is_one_way(&self) -> bool {
        self.one_way
    }

    /// Creates a block on the backend's device, if it casts whole rounds and all triangles are opaque.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    pub fn rounds(
        &self,
        block: &DeviceBlock<'_>,
    ) -> Result<Option<Box<dyn Rounds + '_>>, TracerError> {
        match &self.see_through {
            SeeThrough::Absent if self.masked.is_none() && self.kinds.is_empty() => {
                self.blocking.rounds(block)
            }
            _ => Ok(None),
        }
    }

    /// Returns the best number of packets per call.
    pub fn batch(&self) -> usize {
        self.blocking.batch()
    }

    /// Fills `distance` and `triangle` of every packet, and lists the other triangles that each line shows.
    ///
    /// A line that ends at an occluder-only triangle has the triangle's distance, and [`SKY`] as its
    /// triangle.
    ///
    /// `step` is the minimum distance from a see-through or masked triangle to the next search, in world
    /// units.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    pub fn trace(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
    ) -> Result<(), TracerError> {
        self.find(packets, passed, step, Halves::Rays, true)
    }

    /// Traces rays of different directions, each separately, as [`Self::trace`] does for packets.
    ///
    /// # Errors
    /// The errors of [`SightLineTracer::trace`].
    pub fn trace_each(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
    ) -> Result<(), TracerError> {
        self.find(packets, passed, step, Halves::Rays, false)
    }

    /// Traces both halves of lines, as [`Self::trace`] does for rays.
    ///
    /// The packets are pairs: lines, then the same lines [`Packet::reversed`] by `step`. Lines that are not
    /// `coherent` have different directions.
    ///
    /// # Errors
    /// The errors of [`SightLineTracer::trace`].
    pub fn trace_lines(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
        coherent: bool,
    ) -> Result<(), TracerError> {
        self.find(packets, passed, step, Halves::Lines { step }, coherent)
    }

    fn find(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        step: f32,
        halves: Halves,
        coherent: bool,
    ) -> Result<(), TracerError> {
        self.block(packets, passed, halves, coherent)?;
        self.pass(packets, passed, step, halves, coherent)
    }

    /// Finds the end of each line, and the see-through triangles before the end if both are found together.
    fn block(
        &self,
        packets: &mut [Packet],
        passed: &mut Passed,
        halves: Halves,
        coherent: bool,
    ) -> Result<(), TracerError> {
        passed.found.clear();
        passed.starts.clear();
        let is_bounded = self.far < f32::INFINITY;
        for packet in packets.iter_mut() {
            packet.distance = [f32::INFINITY; LANES];
            for lane in (0..packet.count).filter(|_| is_bounded) {
                packet.distance[lane] = self.far / packet.length(lane);
            }
        }
        match &self.see_through {
            SeeThrough::Together(tracer) => {
                tracer.trace_passing(packets, halves, coherent, &mut passed.found)?;
            }
            SeeThrough::Absent | SeeThrough::After(_) => {
                self.blocking.trace(packets, halves, coherent)?;
            }
        }
        if !is_bounded {
            return Ok(());
        }
        for packet in packets {
            for lane in 0..packet.count {
                let end = self.far / packet.length(lane);
                // This also holds for lines without a hit, whose distance can be infinite.
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
        halves: Halves,
        coherent: bool,
    ) -> Result<(), TracerError> {
        if self.kinds.is_empty() {
            return Ok(());
        }
        // The masked triangles that are shown at the end of a line, in addition to the triangle at which the
        // line ends.
        let mut beside: Vec<(u32, u32, f32)> = Vec::new();
        if let Some(masked) = &self.masked {
            search(
                &*masked.tracer,
                packets,
                &mut passed.probes,
                step,
                halves,
                coherent,
                |packet, lane, met| {
                    let (origin, direction) = packet.ray(lane);
                    let class = masked.class(&met.triangle.0).iter().copied();
                    let mut closed = class
                        .filter(|t| masked.scene.mask_blocks(TriangleId(*t), origin, direction));
                    let Some(first) = closed.next() else {
                        return true;
                    };
                    if met.after >= packet.distance[lane] {
                        // The triangle is in the plane of the triangle at the end, like a poster on a wall:
                        // both are shown.
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
                halves,
                coherent,
                |_, _, met| {
                    found.push((met.line, met.triangle.0, met.at));
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
            // The sort is stable, so the order along each line does not change.
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

/// Calls `meet` for each triangle of a tracer that the packets' lines meet up to their ends, in order along
/// each line.
///
/// `meet` receives the packet and the lane of the line. It may shorten the line, and returns true if the
/// search continues behind the triangle.
fn search(
    tracer: &dyn LineTracer,
    packets: &mut [Packet],
    probes: &mut Vec<Packet>,
    step: f32,
    halves: Halves,
    coherent: bool,
    mut meet: impl FnMut(&mut Packet, usize, PassedTriangle) -> bool,
) -> Result<(), TracerError> {
    probes.clear();
    probes.extend(packets.iter().cloned());
    tracer.trace(probes, halves, coherent)?;
    // The lines with a hit, in the order of their probes, and the distance along the line at which each probe
    // begins. Most lines have no hit.
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
            // The step is at least one unit in the last place, so that the search ends.
            let after = (at + hit.advance(0, step)).max(at.next_up());
            let goes_on = meet(
                packet,
                lane,
                PassedTriangle {
                    line: *line,
                    triangle: TriangleId(triangle),
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
            // The probe extends to the end of the line.
            let end = packets[*line as usize / LANES].distance[*line as usize % LANES];
            probe.distance[probe.count] = end - after;
            probe.push(
                [0, 1, 2].map(|a| origin[a] + direction[a] * after),
                direction,
            );
        }
        open = next;
        tracer.trace(probes, Halves::Rays, false)?;
    }
    Ok(())
}
