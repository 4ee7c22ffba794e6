//! The receivers of a job of ambient occlusion, by their digest and their numbers.
//!
//! Such a job has no cells. Its tiles are runs of receivers, and where a job counts cells it counts
//! receivers. All workers give the same bytes, so it needs no backend. `ambient_spec.rs` has its
//! specification.

use crate::receivers::{TILE, tiles};

/// The receivers that a job names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ambient {
    /// BLAKE3 digest of the receivers.
    pub receivers: [u8; 32],
    /// Their length in bytes.
    pub bytes: u64,
    /// Their number.
    pub points: u32,
    /// Number of the lights.
    pub lights: u32,
}

impl Ambient {
    /// Numbers of a receiver's answer: its openness, then the form factor of each light.
    pub fn numbers(self) -> u32 {
        1 + self.lights
    }

    /// The receivers of each tile, about: a tile has whole blocks, so that it may have some more or less. The
    /// sum is that of all.
    pub(crate) fn counts(self) -> impl Iterator<Item = u64> {
        (0..tiles(self.points)).map(move |tile| u64::from((self.points - tile * TILE).min(TILE)))
    }
}
