//! Triangle scenes: loading, checking, numbering, digesting and generating them.
//!
//! A [`Scene`] is a list of triangles in world space and the objects they belong to. The index of a triangle
//! in the list is its id. This crate knows nothing of view cells, sampling or the network.
//!
//! ```
//! use sightline_scene::{load_bytes, topology::Solids};
//!
//! // Two triangles that share an edge, as the text of an OBJ file.
//! let text = "o roof\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 3 2 4\n";
//! let scene = load_bytes("roof.obj", text.as_bytes(), None)?;
//! assert_eq!((scene.triangles().len(), scene.objects()[0].name.as_str()), (2, "roof"));
//! // They enclose no volume.
//! assert_eq!(Solids::of(&scene)?.outward(0), None);
//! # Ok::<(), sightline_scene::SceneError>(())
//! ```

pub mod clusters;
pub mod error;
#[doc(hidden)]
pub mod fuzzing;
pub mod generate;
pub mod glb_out;
pub mod kinds;
pub mod load;
pub mod masks;
pub mod overlap;
pub mod ply_out;
pub mod scene;
pub mod sides;
pub mod sources;
pub mod topology;
mod turn;

pub use error::SceneError;
pub use kinds::{Kind, Kinds, Rule};
pub use load::{load, load_bytes, load_with};
pub use ply_out::write_mesh_ply;
pub use scene::{Object, Scene, SceneDigest, Triangle};
pub use sides::{Side, Sides};
pub use sightline_numbers::{Aabb, MAX_COORDINATE};
pub use sources::Source;
