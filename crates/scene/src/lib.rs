//! Triangle scenes: loading, checking, numbering, digesting and generating them.
//!
//! A [`Scene`] is a list of triangles in world space and the objects to which they belong. The index of a
//! triangle in the list is its id. This crate does not depend on view cells, sampling or the network.
//!
//! # Modules
//!
//! - `load`: readers of OBJ, PLY, glTF and GLB files. A format is a row in `load/mod.rs` and a parser.
//! - `scene`: [`Scene`], [`Object`], [`Triangle`], and the canonical bytes with their [`SceneDigest`].
//! - `kinds`, `sides`, `masks`: the effect of a triangle on sight lines ([`Kinds`]), the sides from which
//!   lines meet a triangle ([`Sides`]), and the alpha masks of triangles.
//! - `topology`, `clusters`, `overlap`: closed solids and duplicates; clusters of neighbouring triangles;
//!   exact overlap tests with boxes.
//! - `generate`: test scenes of any size.
//! - `glb_out`, `ply_out`, `sources`: writers of scenes, and the location of each object in its glTF file.
//!
//! # Invariants
//!
//! - Triangle ids follow the order of the file, and do not depend on options or threads.
//! - The digest of a scene covers its canonical bytes: triangles, objects, kinds, masks, sides and the
//!   locations of objects in a glTF file. Every scene with the same digest has the same results.
//! - Files are not trusted: limits on sizes apply before memory is allocated, and errors name the element.
//! - The same arguments generate the same bytes on every machine.
//!
//! # Limits
//!
//! - Alpha textures are not filtered: `--alpha-textures` reads the nearest texel of the image. Without the
//!   option, masked geometry is see-through as a whole, so that no visible triangle is missed.
//!
//! # Example
//!
//! ```
//! use sightline_scene::{TriangleId, load_bytes, topology::Solids};
//!
//! // Two triangles that share an edge, as the text of an OBJ file.
//! let text = "o roof\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 3 2 4\n";
//! let scene = load_bytes("roof.obj", text.as_bytes(), None)?;
//! assert_eq!((scene.triangles().len(), scene.objects()[0].name.as_str()), (2, "roof"));
//! // The triangles do not enclose a volume.
//! assert_eq!(Solids::find(&scene)?.outward(TriangleId(0)), None);
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
pub use kinds::{KindRule, Kinds, SurfaceKind};
pub use load::{load, load_bytes, load_with};
pub use ply_out::write_mesh_ply;
pub use scene::{Object, Scene, SceneDigest, Triangle};
pub use sides::{Side, Sides};
pub use sightline_numbers::ids::{ObjectId, TriangleId};
pub use sightline_numbers::{Aabb, MAX_COORDINATE};
pub use sources::GltfLocation;
