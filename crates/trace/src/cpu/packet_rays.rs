//! The rays of a packet in scaled units (module `cpu`), computed for all lanes at once.

use bytemuck::Zeroable;
use fearless_simd::{Simd, SimdBase, SimdFloat as _, SimdMask as _, f32x16, u32x16};

use super::hierarchy::WideHierarchy;
use super::lines::Lines;
use crate::packet::{LANES, OVERLAP};

/// The bits of all lanes.
const ALL: u32 = (1 << LANES) - 1;

/// Sixteen values, aligned for vectors.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Lanes(pub(super) [f32; LANES]);

impl Lanes {
    #[inline(always)]
    pub(super) fn load<S: Simd>(&self, simd: S) -> f32x16<S> {
        f32x16::from_slice(simd, &self.0)
    }

    #[inline(always)]
    pub(super) fn store<S: Simd>(&mut self, values: f32x16<S>) {
        values.store_slice(&mut self.0);
    }
}

/// The rays of a packet. Lanes without a ray repeat the last ray.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct PacketRays {
    /// The components of the scaled directions. The largest is one to two, or two to four if the direction is
    /// near the largest number.
    pub(super) direction: [Lanes; 3],
    /// The distances between which hits count, ahead and behind, in lengths of the scaled direction. For
    /// separate rays, the distances behind are undefined.
    pub(super) limits: [[Lanes; 2]; 2],
    /// The factors from scaled distances to given ones.
    pub(super) outwards: Lanes,
    /// The distances from the origin to the starts of the reversed rays, in lengths of the direction. For
    /// separate rays, the distances are undefined.
    pub(super) advance: Lanes,
    /// The bits of the lanes whose directions can be scaled. The other rays meet nothing.
    pub(super) scaled: u32,
    /// The number of rays.
    pub(super) count: usize,
}

impl PacketRays {
    /// Sets the rays to a packet, the first of a pair if the packets are pairs. The packet must not be empty.
    ///
    /// A direction can be scaled if its largest component is a normal number, all are finite, and the factors
    /// of distances are normal numbers.
    #[inline(always)]
    pub(super) fn set<S: Simd>(
        &mut self,
        simd: S,
        lines: &Lines<'_>,
        number: usize,
        scene: &WideHierarchy,
    ) {
        let packet = &lines.packets[number];
        let count = packet.count;
        let splat = |x: f32| f32x16::splat(simd, x);
        let word = |x: u32| u32x16::splat(simd, x);
        let [x, y, z] = &packet.direction;
        let (x, y, z) = (
            filled(simd, x, count),
            filled(simd, y, count),
            filled(simd, z, count),
        );
        // As numbers, the bits of nonnegative numbers have the same order. NaN comes after infinity.
        let bits = x.abs().to_bits().max(y.abs().to_bits());
        let bits = bits.max(z.abs().to_bits());
        let exponents = bits >> 23u32;
        let may_scale = exponents.simd_ge(word(1)) & exponents.simd_lt(word(255));
        let exponents = exponents.min(word(253));
        let shorten = f32x16::from_bits((word(254) - exponents) << 23u32);
        let lengthen = f32x16::from_bits(exponents << 23u32);
        let inwards = lengthen * splat(scene.units.scale);
        let outwards = shorten * splat(scene.units.unscale);
        let is_scaled = may_scale & inwards.is_normal() & outwards.is_normal();
        self.scaled = is_scaled.to_bitmask() as u32;
        self.direction[0].store(x * shorten);
        self.direction[1].store(y * shorten);
        self.direction[2].store(z * shorten);
        let near = splat(lines.near);
        self.limits[0][0].store(near * inwards);
        self.limits[0][1].store(filled(simd, &packet.distance, count) * inwards);
        if let Some(step) = lines.step {
            let [x, y, z] = &packet.origin;
            let largest = filled(simd, x, count)
                .abs()
                .max(filled(simd, y, count).abs())
                .max(filled(simd, z, count).abs());
            let world = (largest * splat(OVERLAP)).max(splat(step));
            let advance = world / f32x16::from_bits(bits);
            let behind = filled(simd, &lines.packets[number + 1].distance, count);
            self.limits[1][0].store((near - advance) * inwards);
            self.limits[1][1].store((behind - advance) * inwards);
            self.advance.store(advance);
        }
        self.outwards.store(outwards);
        self.count = count;
    }

    /// Returns the scaled direction of a lane.
    #[inline(always)]
    pub(super) fn direction(&self, lane: usize) -> [f32; 3] {
        let [x, y, z] = &self.direction;
        [x.0[lane], y.0[lane], z.0[lane]]
    }

    /// Returns true if the rays, which [`Self::set`] read from packet `number`, have one origin and the main
    /// axis `main` with one sign, and can be scaled.
    #[inline(always)]
    pub(super) fn are_similar<S: Simd>(
        &self,
        simd: S,
        lines: &Lines<'_>,
        number: usize,
        main: usize,
    ) -> bool {
        let length = self.direction[main].load(simd).abs();
        let mut similar = self.scaled;
        for (axis, origins) in lines.packets[number].origin.iter().enumerate() {
            let origin = filled(simd, origins, self.count);
            let first = f32x16::splat(simd, origins[0]);
            similar &= origin.simd_eq(first).to_bitmask() as u32;
            let other = self.direction[axis].load(simd).abs();
            // Of equal components, the first is the main one.
            similar &= match axis < main {
                true => other.simd_lt(length).to_bitmask() as u32,
                false => other.simd_le(length).to_bitmask() as u32,
            };
        }
        let zero = f32x16::splat(simd, 0.0);
        let down = self.direction[main].load(simd).simd_lt(zero).to_bitmask() as u32;
        similar == ALL && (down == 0 || down == ALL)
    }
}

/// Returns the values of the first `count` lanes. The other lanes repeat the last value.
#[inline(always)]
fn filled<S: Simd>(simd: S, values: &[f32; LANES], count: usize) -> f32x16<S> {
    if count == LANES {
        return f32x16::from_slice(simd, values);
    }
    let mut all = *values;
    all[count..].fill(values[count - 1]);
    f32x16::from_slice(simd, &all)
}
