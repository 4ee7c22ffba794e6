//! Packets of sixteen sight lines, and the interface of their tracer.

use crate::cube::SKY;
use crate::error::TracerError;
use crate::lines::device::{DeviceBlock, Rounds};

/// The number of lines of a packet.
pub const LANES: usize = 16;

/// The overlap of the two halves of a line, as a fraction of the origin's largest coordinate: four units in
/// the last place.
pub(crate) const OVERLAP: f32 = 1.0 / (1 << 21) as f32;

/// Sixteen rays of roughly one direction, and the nearest triangle that each ray meets. Arrays are by axis,
/// then lane.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Packet {
    /// The origin of each ray, in world space.
    pub origin: [[f32; LANES]; 3],
    /// The direction of each ray, of any length except zero.
    pub direction: [[f32; LANES]; 3],
    /// The distance of each hit in lengths of the direction. Before a trace, the distance up to which the ray
    /// is traced. Filled by the tracer.
    pub distance: [f32; LANES],
    /// The triangle that each ray meets, or [`SKY`]. Filled by the tracer.
    pub triangle: [u32; LANES],
    /// The number of rays. Lanes `0..count` are rays; the other lanes are ignored.
    pub count: usize,
}

impl Default for Packet {
    fn default() -> Self {
        Self {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            distance: [f32::INFINITY; LANES],
            triangle: [SKY; LANES],
            count: 0,
        }
    }
}

impl Packet {
    /// Appends a ray. The packet must not be full.
    pub fn push(&mut self, origin: [f32; 3], direction: [f32; 3]) {
        for a in 0..3 {
            self.origin[a][self.count] = origin[a];
            self.direction[a][self.count] = direction[a];
        }
        self.count += 1;
    }

    /// Returns the origin and the direction of a lane.
    pub fn ray(&self, lane: usize) -> ([f32; 3], [f32; 3]) {
        (
            [0, 1, 2].map(|a| self.origin[a][lane]),
            [0, 1, 2].map(|a| self.direction[a][lane]),
        )
    }

    /// Returns the length of the direction of a lane.
    pub fn length(&self, lane: usize) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|a| self.direction[a][lane]);
        (x * x + y * y + z * z).sqrt()
    }

    /// Returns the same rays in the opposite directions.
    ///
    /// The reversed rays start ahead of the origins of the forward rays. The distance is a few units in the
    /// last place of the origins, and at least `step` (world units, along the longest component of the
    /// direction). A triangle that contains an origin is at distance 0, where no ray meets it. The backward
    /// ray starts ahead of such a triangle and meets it. [`Packet::free`] is then empty, so no line passes
    /// through the triangle.
    pub fn reversed(&self, step: f32) -> Self {
        let mut back = Self {
            direction: self.direction.map(|axis| axis.map(|x| -x)),
            ..self.clone()
        };
        for lane in 0..self.count {
            let ahead = self.advance(lane, step);
            for a in 0..3 {
                back.origin[a][lane] += self.direction[a][lane] * ahead;
            }
        }
        back
    }

    /// Returns the distance from the origin of a lane to the start of its reversed ray, in lengths of the
    /// direction.
    pub fn advance(&self, lane: usize, step: f32) -> f32 {
        let longest = (0..3)
            .map(|a| self.direction[a][lane].abs())
            .fold(0.0, f32::max);
        let largest = (0..3)
            .map(|a| self.origin[a][lane].abs())
            .fold(0.0, f32::max);
        if longest > 0.0 {
            step.max(largest * OVERLAP) / longest
        } else {
            0.0
        }
    }

    /// Returns the start and the end of the free part of a lane's line, in lengths of the direction.
    ///
    /// Both are positions along the line: 0 is the origin, and positions behind the origin are negative. The
    /// free part is empty if the start is not before the end. `back` is the traced packet
    /// [`Packet::reversed`] by `step`.
    pub fn free(&self, back: &Self, lane: usize, step: f32) -> (f32, f32) {
        (
            self.advance(lane, step) - back.distance[lane],
            self.distance[lane],
        )
    }
}

/// The relation between the packets of a call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Halves {
    /// Each packet has separate rays.
    Rays,
    /// The packets are pairs: lines, then the same lines [`Packet::reversed`] by a step. A tracer can trace
    /// both halves of a line at once, from the origin of the first packet.
    Lines {
        /// The step in world units.
        step: f32,
    },
}

/// A tracer that finds the nearest triangles along sight lines. The same packet has the same result to the
/// bit on every run and thread.
pub trait LineTracer: Send + Sync {
    /// Fills `distance` and `triangle` of every packet, up to the `distance` that each lane has on entry. A
    /// lane without a hit has the triangle [`SKY`]. Degenerate triangles are never met.
    ///
    /// A tracer may also find hits beyond the distance. Rays that are not `coherent` have different
    /// directions, and a tracer may trace each separately.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    fn trace(
        &self,
        packets: &mut [Packet],
        halves: Halves,
        coherent: bool,
    ) -> Result<(), TracerError>;

    /// Returns the number of packets per call that is fastest. The results of a numerics profile depend on
    /// the number, because samplers process hits after each call.
    fn batch(&self) -> usize {
        32
    }

    /// Creates a block on the tracer's device, which then casts whole rounds. Returns `None` if the tracer
    /// has no such device or the device cannot hold the block.
    ///
    /// # Errors
    /// The errors of [`LineTracer::trace`].
    fn rounds<'b>(
        &'b self,
        _block: &DeviceBlock<'_>,
    ) -> Result<Option<Box<dyn Rounds + 'b>>, TracerError> {
        Ok(None)
    }
}

/// A tracer that finds the ends of sight lines and the see-through triangles before them in one traversal.
pub trait PassingTracer: Send + Sync {
    /// Fills `distance` and `triangle` of every packet, up to the `distance` that each lane has on entry.
    ///
    /// Appends the triangles that each line passes before its end: line (packet · [`LANES`] + lane), triangle
    /// and distance. They ascend by packet, are in any order within a packet, and some may occur twice.
    /// `halves` and `coherent` are the parameters of [`LineTracer::trace`].
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    fn trace_passing(
        &self,
        packets: &mut [Packet],
        halves: Halves,
        coherent: bool,
        found: &mut Vec<(u32, u32, f32)>,
    ) -> Result<(), TracerError>;
}
