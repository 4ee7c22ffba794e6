//! The lines of one call of the tracer, and the hits that are not at their ends.

use super::hierarchy::WideHierarchy;
use super::line_origin::RayScale;
use crate::packet::Packet;

/// The triangles that lines pass, in scaled units: line (packet · 16 + lane), triangle and distance. Some lie
/// behind the end of their line, which was not known when they were met.
#[derive(Default)]
pub(super) struct Hits {
    pub(super) passed: Vec<(u32, u32, f32)>,
    /// The end of each line, in scaled units.
    pub(super) ends: Vec<f32>,
}

/// The lines of one trace.
pub(super) struct Lines<'a> {
    pub(super) packets: &'a mut [Packet],
    /// The packets to trace, or the first packets of the pairs to trace.
    pub(super) chosen: &'a [u32],
    /// The step of [`Packet::reversed`] if the packets are pairs.
    pub(super) step: Option<f32>,
    /// The distance beyond which hits count, in lengths of the direction.
    pub(super) near: f32,
}

impl Lines<'_> {
    /// Returns the intervals in which hits of the line ahead and of the line behind count, in lengths of the
    /// direction from the origin of the line. Separate rays have no line behind.
    #[inline(always)]
    pub(super) fn limits(&self, packet: usize, lane: usize) -> [(f32, f32); 2] {
        let ahead = (self.near, self.packets[packet].distance[lane]);
        let Some(step) = self.step else {
            return [ahead; 2];
        };
        let advance = self.packets[packet].advance(lane, step);
        let behind = self.packets[packet + 1].distance[lane];
        [ahead, (self.near - advance, behind - advance)]
    }

    /// Returns the distance of a hit from the origin of its ray, in lengths of the direction.
    #[inline(always)]
    pub(super) fn distance(
        &self,
        scene: &WideHierarchy,
        packet: usize,
        lane: usize,
        scaled: f32,
    ) -> f32 {
        let first = match self.step {
            Some(_) => packet & !1,
            None => packet,
        };
        let scale = RayScale::new(self.packets[first].ray(lane).1, scene);
        let distance = scaled * scale.map_or(1.0, |s| s.outwards);
        match self.step {
            Some(step) if packet != first => distance + self.packets[first].advance(lane, step),
            _ => distance,
        }
    }

    /// Writes the nearest hit of a ray.
    #[inline(always)]
    pub(super) fn meet(
        &mut self,
        scene: &WideHierarchy,
        packet: usize,
        lane: usize,
        scaled: f32,
        triangle: u32,
    ) {
        let distance = self.distance(scene, packet, lane, scaled);
        self.packets[packet].distance[lane] = distance;
        self.packets[packet].triangle[lane] = triangle;
    }
}
