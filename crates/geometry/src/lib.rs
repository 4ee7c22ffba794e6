//! Exact predicates, vectors, convex polygons and a hierarchy of boxes that the other crates share.
//!
//! This crate knows points and boxes, and nothing of scenes, cells or results. Everything here gives the same
//! values on every machine.
//!
//! ```
//! use std::cmp::Ordering;
//!
//! use glam::Vec3;
//! use sightline_geometry::predicates::orient3d_sign;
//!
//! // The side of the plane through three points on which a fourth one lies, without a tolerance.
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
