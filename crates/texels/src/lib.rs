//! A writer of surface values into an existing glTF file.
//!
//! [`Plan::new`] reads a file and lists the points whose values are needed ([`Plan::receivers`]). The caller
//! computes the values and passes them to [`Plan::write`], which returns a GLB: the original file with an
//! added occlusion texture, or with values at its vertices. A file in another format becomes a new glTF file.
//!
//! # Modules
//!
//! - `plan`, `settings`, `receivers`: the [`Plan`], its [`Settings`], and its points and values.
//! - `pieces`, `vertices`, `fit`, `solver`: the points of texels and vertices, and the fit of values at
//!   vertices.
//! - `kept_coordinates`, `unwrap`, `atlas`, `pack`, `overlap`: texture coordinates of the file, or new ones.
//! - `image`, `fill`, `seams`: the texels, the values of texels without a receiver, and equal values on both
//!   sides of a seam.
//! - `file`, `plain`, `parts`, `primitives`, `materials`, `instances`, `copies`, `accessor`,
//!   `added_accessors`, `written_file`: the glTF file and the changes of its elements.
//!
//! # Invariants
//!
//! - This crate does not interpret the values, except that 0 is dark and 1 is bright.
//! - The written file has the same triangles as the read file.
//! - The fit of values at vertices sums in a fixed order, so equal inputs give equal bytes.
//!
//! # Example
//!
//! ```
//! use sightline_texels::{Plan, ReceiverValue, Settings};
//!
//! let text = "o floor\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nf 1 2 3 4\n";
//! let scene = sightline_scene::load_bytes("floor.obj", text.as_bytes(), None)?;
//! let plan = Plan::new("floor.obj", text.as_bytes(), None, &scene, &Settings::default())?;
//! let values = vec![ReceiverValue { open: 0.5, inside: false }; plan.receivers().len()];
//! let written = plan.write(&values)?;
//! let again = sightline_scene::load_bytes("out.glb", &written.glb, None)?;
//! assert_eq!(again.triangles(), scene.triangles());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod accessor;
mod added_accessors;
mod atlas;
mod copies;
mod error;
mod file;
mod fill;
mod fit;
pub mod fuzzing;
mod image;
mod instances;
mod kept_coordinates;
mod materials;
mod overlap;
mod pack;
mod parts;
mod pieces;
mod plain;
mod plan;
mod primitives;
mod receivers;
mod seams;
mod settings;
mod solver;
mod unwrap;
mod vertices;
mod welds;
mod written_file;

pub use error::TexelsError;
pub use plan::{Plan, WriteSummary, WrittenFile};
pub use receivers::{Receiver, ReceiverValue};
pub use settings::{BitDepth, Settings, TexCoordSource, TextureSize, ValueTarget};
