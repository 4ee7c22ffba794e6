//! Exact from-region visibility: queries in line space, witnesses, certificates and a checker of its own.
//!
//! A query asks whether one convex polygon sees another among the triangles of a scene. The answer is a witness (a segment
//! that meets nothing), a proof (which [`checker`] accepts or refuses by exact arithmetic alone), or that neither was
//! found. No tolerance decides anything: doubles with error bounds come first, integers where those cannot tell.

pub mod bvh;
pub mod cell;
pub mod checker;
pub mod cone;
pub mod double;
pub mod frame;
pub mod klein;
pub mod number;
pub mod occluder;
pub mod polygon;
pub mod predicates;
pub mod prism;
pub mod proof;
pub mod query;
pub mod trace;
pub mod vector;

pub use occluder::Occluders;
pub use polygon::{Polygon, PolygonError};
pub use proof::Proof;
pub use query::{Cost, Limits, Reason, Verdict, sightlines};
