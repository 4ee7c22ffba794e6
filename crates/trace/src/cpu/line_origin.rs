//! The origin of lines in a hierarchy, in scaled units, and the nodes that contain the origin.

use bytemuck::Zeroable;
use fearless_simd::{Simd, SimdBase, SimdMask, f32x8};

use super::hierarchy::{LEAF, WIDTH, WideHierarchy};

/// Maximum number of listed nodes, and of listed leaves, that contain an origin. A traversal finds further
/// ones from their parents.
pub(super) const LISTED: usize = 40;
/// The largest coordinate of an origin in scaled units. Products of three such numbers are finite.
const FARTHEST: f32 = (1u64 << 40) as f32;

/// Returns the distance by which boxes are widened for rays from a scaled origin (module `cpu`).
#[inline(always)]
pub(super) fn widening(origin: [f32; 3]) -> f32 {
    let largest = origin[0].abs().max(origin[1].abs()).max(origin[2].abs());
    (1.0 + largest) * (1.0 / (1 << 19) as f32)
}

/// Returns the origin in scaled units, or `None` if a coordinate is too large or not finite.
#[inline(always)]
pub(super) fn scaled_origin(origin: [f32; 3], scene: &WideHierarchy) -> Option<[f32; 3]> {
    let scaled = scene.units.convert(origin.into()).to_array();
    scaled.iter().all(|o| o.abs() <= FARTHEST).then_some(scaled)
}

/// The listed nodes and leaves whose boxes contain an origin.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct OriginNodes {
    /// The numbers of the nodes.
    pub(super) nodes: [u32; LISTED],
    /// For each node, the bits of the children that are not listed.
    pub(super) others: [u32; LISTED],
    /// For each node and child, minus infinity if the child is not listed, otherwise infinity.
    pub(super) bounds: [[f32; WIDTH]; LISTED],
    /// The number of nodes.
    pub(super) count: usize,
    /// The numbers of the leaves.
    pub(super) leaves: [u32; LISTED],
    /// The number of leaves.
    pub(super) leaf_count: usize,
}

impl OriginNodes {
    /// Lists the nodes and leaves whose boxes, widened twice, contain a scaled origin.
    #[inline(always)]
    pub(super) fn find<S: Simd>(
        &mut self,
        simd: S,
        scene: &WideHierarchy,
        origin: [f32; 3],
        widening: f32,
    ) {
        self.count = 1;
        self.leaf_count = 0;
        self.nodes[0] = 0;
        let low = origin.map(|o| f32x8::splat(simd, o + 2.0 * widening));
        let high = origin.map(|o| f32x8::splat(simd, o - 2.0 * widening));
        let mut i = 0;
        while i < self.count {
            let node = &scene.nodes[self.nodes[i] as usize];
            let row = |r: usize| f32x8::from_slice(simd, node.row(r));
            let inside = row(0).simd_le(low[0])
                & high[0].simd_le(row(1))
                & row(2).simd_le(low[1])
                & high[1].simd_le(row(3))
                & row(4).simd_le(low[2])
                & high[2].simd_le(row(5));
            let mut bits = inside.to_bitmask() as u32;
            let mut others = !bits & 255;
            while bits != 0 {
                let slot = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let child = node.child(slot);
                if child & LEAF != 0 && self.leaf_count < LISTED {
                    self.leaves[self.leaf_count] = child & !LEAF;
                    self.leaf_count += 1;
                } else if child & LEAF == 0 && self.count < LISTED {
                    self.nodes[self.count] = child;
                    self.count += 1;
                } else {
                    others |= 1 << slot;
                }
            }
            for slot in 0..WIDTH {
                self.bounds[i][slot] = if others >> slot & 1 == 1 {
                    f32::NEG_INFINITY
                } else {
                    f32::INFINITY
                };
            }
            self.others[i] = others;
            i += 1;
        }
    }
}
