//! Triangle scenes: loading, checking, numbering, digesting and generating them.
//!
//! A [`Scene`] is a list of triangles in world space whose position in the list is their id, and the objects
//! they belong to. This crate knows nothing of view cells, sampling or the network.

pub mod error;
pub mod exact;
#[doc(hidden)]
pub mod fuzzing;
pub mod generate;
pub mod glb_out;
pub mod load;
pub mod overlap;
pub mod ply_out;
pub mod scene;
pub mod topology;

pub use error::SceneError;
pub use load::{load, load_bytes};
pub use ply_out::write_mesh_ply;
pub use scene::{Aabb, Object, Scene, SceneDigest, Triangle};
pub use sightline_numbers::random::mix;
