//! Numbers, streams of numbers and sets of numbers that the other crates share.
//!
//! This crate depends on no other crate of the project and knows nothing of triangles, cells or results.
//! Everything here gives the same values on every machine.
//!
//! ```
//! use sightline_numbers::{random::SplitMix64, union_find::UnionFind, varint};
//!
//! // Join ten random pairs of numbers, then write the root of each number.
//! let (mut stream, mut sets) = (SplitMix64::named(&[7, 1]), UnionFind::new(16));
//! for _ in 0..10 {
//!     sets.join((stream.bits() >> 60) as u32, (stream.bits() >> 60) as u32);
//! }
//! let mut bytes = Vec::new();
//! (0..16).for_each(|x| varint::write(&mut bytes, u64::from(sets.root(x))));
//! let mut rest = bytes.as_slice();
//! assert_eq!(varint::read(&mut rest, varint::MOST_BYTES), Ok(0));
//! ```

mod aabb;
pub mod integer;
pub mod random;
pub mod union_find;
pub mod varint;

pub use aabb::Aabb;

/// Largest absolute coordinate of scenes and view boxes.
///
/// Tracers multiply three lengths of a scene in single precision: at most (2·10⁹·√3)³ ≈ 4·10²⁸, far below the
/// largest `f32`. Embree ends the process where its hierarchy meets an infinity.
pub const MAX_COORDINATE: f32 = 1e9;
