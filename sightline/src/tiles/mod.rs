//! Bakes without a coordinator.
//!
//! `plan` writes a job, its scene and its plan to a folder, `run_tile` computes one tile in the folder, and
//! `assemble` joins the tiles. Every process with access to the folder can compute tiles, in any order that
//! their dependencies permit. Two processes that compute the same tile write the same file.
//!
//! ```no_run
//! use sightline::{JobOptions, LoadOptions, SceneSource, Silent, tiles};
//!
//! let source = SceneSource::File("level.glb".into());
//! let scene = sightline::read_scene(&source, &LoadOptions::default(), &Silent)?;
//! let job = JobOptions::default().resolve(&scene, &Silent)?;
//! let planned = tiles::plan(&scene, &job, "plan", &Silent)?;
//! // The tiles of grids and boxes need no other tiles, so that any order serves.
//! for number in 0..planned.tiles {
//!     tiles::run_tile("plan", tiles::TileIndex(number), &Silent)?;
//! }
//! tiles::assemble("plan", "level.pvs".as_ref())?;
//! # Ok::<(), sightline::Error>(())
//! ```

mod assemble;
mod place;
mod plan;
mod planned;
mod run;
mod tile_file;

pub use self::assemble::{Assembled, assemble};
pub use self::plan::{Planned, plan};
pub use self::planned::{PlanFile, PlanTile};
pub use self::run::{TileReport, run_tile};
pub use sightline_viewcells::TileIndex;
