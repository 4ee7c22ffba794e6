//! Packets of sixteen sight lines, and the interface of their tracer.

use crate::cube::SKY;
use crate::error::BackendError;
use crate::lines::device::{DeviceBlock, Rounds};

/// Lines of a packet.
pub const LANES: usize = 16;

/// Overlap of the two halves of a line, as a part of the origin's greatest coordinate: four units in the last
/// place.
const OVERLAP: f32 = 1.0 / (1 << 21) as f32;

/// Sixteen rays of roughly one direction, and the nearest triangle each meets. Arrays by axis, then lane.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Packet {
    /// Where each ray begins, world space.
    pub origin: [[f32; LANES]; 3],
    /// Its direction, of any length but zero.
    pub direction: [[f32; LANES]; 3],
    /// Out: distance of the hit in lengths of the direction, infinite when nothing is met.
    pub distance: [f32; LANES],
    /// Out: the triangle met, or [`SKY`].
    pub triangle: [u32; LANES],
    /// Lanes `0..count` are rays; the others are ignored.
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
    /// Appends a ray; the packet must not be full.
    pub fn push(&mut self, origin: [f32; 3], direction: [f32; 3]) {
        for a in 0..3 {
            self.origin[a][self.count] = origin[a];
            self.direction[a][self.count] = direction[a];
        }
        self.count += 1;
    }

    /// Origin and direction of a lane.
    pub fn ray(&self, lane: usize) -> ([f32; 3], [f32; 3]) {
        (
            [0, 1, 2].map(|a| self.origin[a][lane]),
            [0, 1, 2].map(|a| self.direction[a][lane]),
        )
    }

    /// Length of the direction of a lane.
    pub fn length(&self, lane: usize) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|a| self.direction[a][lane]);
        (x * x + y * y + z * z).sqrt()
    }

    /// The same rays in the opposite directions. They start ahead of the origins of the forward rays: by a
    /// few units in the last place of the origins, and at least by `step` (world units, along the longest
    /// component of the direction). A triangle that contains an origin is at distance 0, where no ray meets
    /// it. The backward ray starts ahead of such a triangle and meets it, and [`Packet::free`] is then empty,
    /// so no line passes through the triangle.
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

    /// The free part of a lane's line, as distances from the origin in lengths of the direction. `back` is
    /// the traced packet [`Packet::reversed`] by `step`.
    pub fn free(&self, back: &Self, lane: usize, step: f32) -> (f32, f32) {
        (
            self.advance(lane, step) - back.distance[lane],
            self.distance[lane],
        )
    }
}

/// Finds the nearest triangles along sight lines. The same packet gives the same bits on every run and
/// thread.
pub trait LineTracer: Send + Sync {
    /// Fills `distance` and `triangle` of every packet. Degenerate triangles are never met.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    fn trace(&self, packets: &mut [Packet]) -> Result<(), BackendError>;

    /// The best number of packets per call. Results of a profile depend on it.
    fn batch(&self) -> usize {
        32
    }

    /// The same for rays of different directions, each traced by itself.
    ///
    /// # Errors
    /// As [`LineTracer::trace`].
    fn trace_each(&self, packets: &mut [Packet]) -> Result<(), BackendError> {
        self.trace(packets)
    }

    /// [`LineTracer::trace`] or, when the rays are not `coherent`, [`LineTracer::trace_each`] up to the
    /// `distance` that each lane has on entry. A tracer may find hits beyond that, too.
    ///
    /// # Errors
    /// As [`LineTracer::trace`].
    fn trace_within(&self, packets: &mut [Packet], coherent: bool) -> Result<(), BackendError> {
        if coherent {
            self.trace(packets)
        } else {
            self.trace_each(packets)
        }
    }

    /// Puts a block on the tracer's device, which then casts whole rounds by itself; `None` when it has no
    /// such device or the device cannot hold the block.
    ///
    /// # Errors
    /// As [`LineTracer::trace`].
    fn rounds<'b>(
        &'b self,
        _block: &DeviceBlock<'_>,
    ) -> Result<Option<Box<dyn Rounds + 'b>>, BackendError> {
        Ok(None)
    }
}

/// Finds the ends of sight lines and the see-through triangles before them in one traversal.
pub trait PassingTracer: Send + Sync {
    /// Fills `distance` and `triangle` of every packet, up to the `distance` that each lane has on entry, and
    /// appends the triangles that each line passes before its end: line (packet · [`LANES`] + lane), triangle
    /// and distance, ascending by packet, in any order within one, some perhaps twice. Rays that are not
    /// `coherent` are traced each by itself.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    fn trace_passing(
        &self,
        packets: &mut [Packet],
        coherent: bool,
        found: &mut Vec<(u32, u32, f32)>,
    ) -> Result<(), BackendError>;
}
