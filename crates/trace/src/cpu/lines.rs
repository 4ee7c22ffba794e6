//! The lines of one call of the tracer, and the hits that are not at their ends.

use super::hierarchy::WideHierarchy;
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
    /// Returns the distance of a hit from the origin of its ray, in lengths of the direction, which can be
    /// scaled ([`PacketRays`](super::packet_rays::PacketRays)).
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
        let direction = self.packets[first].ray(lane).1;
        let exponents = direction.map(|d| d.to_bits() >> 23 & 0xff);
        let exponent = exponents.into_iter().fold(0, u32::max).min(253);
        let distance = scaled * (f32::from_bits((254 - exponent) << 23) * scene.units.unscale);
        match self.step {
            Some(step) if packet != first => distance + self.packets[first].advance(lane, step),
            _ => distance,
        }
    }
}
