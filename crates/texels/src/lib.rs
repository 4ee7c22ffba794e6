//! Values of a surface into the user's own glTF file.
//!
//! [`Plan::new`] reads a file and lists the points whose values it wants ([`Plan::receivers`]). Whoever
//! knows the values gives them to [`Plan::write`], which returns a GLB: the file as it was, with an
//! occlusion texture or with values at its vertices. This crate knows nothing of what the values mean,
//! beyond that 0 is dark and 1 is bright.
//!
//! ```
//! use sightline_texels::{Plan, Settings, Value};
//!
//! let text = "o floor\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nf 1 2 3 4\n";
//! let scene = sightline_scene::load_bytes("floor.obj", text.as_bytes(), None)?;
//! let plan = Plan::new("floor.obj", text.as_bytes(), None, &scene, &Settings::default())?;
//! let values = vec![Value { open: 0.5, inside: false }; plan.receivers().len()];
//! let written = plan.write(&values)?;
//! let again = sightline_scene::load_bytes("out.glb", &written.glb, None)?;
//! assert_eq!(again.triangles(), scene.triangles());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod accessor;
mod added;
mod atlas;
mod copies;
mod error;
mod file;
mod fill;
mod fit;
pub mod fuzzing;
mod image;
mod instances;
mod kept;
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
mod written;

pub use error::TexelsError;
pub use plan::{Facts, Plan, Written};
pub use receivers::{Receiver, Value};
pub use settings::{Bits, Coordinates, Settings, Size, Target};
