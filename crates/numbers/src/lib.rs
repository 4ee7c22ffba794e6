//! Boxes, indices, pseudorandom numbers, integer encodings and disjoint sets that the other crates share.
//!
//! This crate depends on no other crate of the project. The types in `ids` are indices only: this crate does
//! not define triangles, cells or results.
//!
//! # Modules
//!
//! - `aabb`: [`Aabb`], an axis-aligned box in single precision.
//! - `ids`: index types of triangles, objects, cells, tiles and phases.
//! - `integer`: quotients of two integers of any size, in floating point.
//! - `memory`: the end of a computation that lacks memory.
//! - `random`: `SplitMix64`, a stream of pseudorandom numbers. A list of integers selects the stream.
//! - `union_find`: `UnionFind`, disjoint sets of the integers 0 … n−1.
//! - `varint`: variable-length integers (LEB128).
//!
//! # Invariants
//!
//! - All functions return the same values on every machine and in every version. The bytes of results depend
//!   on these values.
//! - Decoders check their input and return errors.
//!
//! # Example
//!
//! ```
//! use sightline_numbers::{random::SplitMix64, union_find::UnionFind, varint};
//!
//! // Join the sets of ten random pairs of numbers below 16, then encode the root of each number.
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
pub mod ids;
pub mod integer;
pub mod memory;
pub mod random;
pub mod union_find;
pub mod varint;

pub use aabb::Aabb;

/// The largest magnitude of a coordinate of scenes and view boxes, in units of the scene.
///
/// Ray tracers multiply three lengths of a scene in single precision. With this limit, the product is at most
/// (2·10⁹·√3)³ ≈ 4·10²⁸, far below the largest `f32`. Embree ends the process if its hierarchy contains an
/// infinity, and the tracer `cpu` scales scenes to coordinates of at most one.
pub const MAX_COORDINATE: f32 = 1e9;
