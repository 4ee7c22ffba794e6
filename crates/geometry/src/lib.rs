//! Exact predicates, vectors, convex polygons and a hierarchy of boxes for the other crates.
//!
//! This crate has no types for scenes, cells or results. The coordinates of triangles and boxes have single
//! precision.
//!
//! # Modules
//!
//! - `predicates`: exact orientation signs of points, and exact crossings of segments and triangles.
//! - `convex`: `Convex`, a flat convex polygon, for example an area light.
//! - `bvh`: [`Bvh`], a hierarchy of boxes that returns every triangle that a segment may meet, and possibly
//!   more.
//! - `vector`: products of vectors in doubles, with a fixed order of operations.
//! - `rounding`: the rounding unit u = 2⁻⁵³ in the error bounds of all filters.
//!
//! # Invariants
//!
//! - A predicate never depends on a tolerance: a filter in `f64` with a proved error bound decides most
//!   cases, and exact arithmetic decides the other cases. Predicates with `f64` arguments return
//!   `None` if they cannot decide.
//! - All functions return the same values on every machine.
//!
//! # Example
//!
//! ```
//! use std::cmp::Ordering;
//!
//! use glam::Vec3;
//! use sightline_geometry::predicates::orient3d_sign;
//!
//! // The side of the plane through three points on which a fourth point lies, without a tolerance.
//! let above = orient3d_sign(Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z);
//! let inside = orient3d_sign(Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::new(1e30, -1e-30, 0.0));
//! assert_ne!(above, Ordering::Equal);
//! assert_eq!(inside, Ordering::Equal);
//! ```

pub mod bvh;
pub mod convex;
pub mod predicates;
pub mod rounding;
pub mod vector;

pub use bvh::{Below, Bvh};
