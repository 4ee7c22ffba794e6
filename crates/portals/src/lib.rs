//! A scene divided along its walls: convex leaves, portals, and the leaves that a point reaches.
//!
//! A [`Tree`] is a binary space partition along planes of the scene's triangles (Teller 1992, chapters 5 and
//! 8). Its portals are the parts of its splitting planes that no triangle covers, so every free segment
//! between two leaves crosses portals. The crate has no types for cell grids or jobs. `docs/portals.md`
//! describes the use.
//!
//! # Modules
//!
//! - `planes`, `plane`, `plane_choice`, `face_cover`: the planes of the scene, their exact signs, the choice
//!   of the plane that splits a leaf, and the open rest of a plane.
//! - `tree`, `partition`, `solids`, `convex`: the [`Tree`], the [`Partition`] of a job's scene, and its
//!   leaves as convex solids.
//! - `enclosure`, `region`: [`enclose()`] refines a tree until walls enclose given points or a leak is found;
//!   [`region_of`] makes the region of a job.
//! - `sights`, `beam`, `outline`: [`sights()`] computes the conservative set of a cell, from bounds on the
//!   space that lines from the cell can reach through portals.
//! - `along_walls`, `open_box`, `open_faces`: cells along walls.
//! - `table`: the partition in a result, for queries at run time.
//!
//! # Invariants
//!
//! - The crate computes exactly on which side of a plane a point lies: no path through free space enters a
//!   leaf that the search does not reach.
//! - Bounds on the space that lines from a cell reach are in doubles with proved slacks. Rounding can only
//!   reduce the number of hidden triangles (`docs/decisions/0010-portal-bounds-in-doubles.md`).
//!
//! # Limits
//!
//! - The partition has no tolerance: a gap of one unit in the last place is an opening.
//! - Hidden triangles have no certificates.

pub mod along_walls;
pub mod beam;
pub mod convex;
pub mod enclosure;
pub mod face_cover;
pub mod open_box;
pub mod open_faces;
pub mod outline;
pub mod partition;
pub mod plane;
pub mod plane_choice;
pub mod planes;
pub mod region;
pub mod sights;
pub mod solids;
pub mod table;
pub mod tree;

pub use along_walls::along_walls;
pub use enclosure::{Enclosure, EnclosureLimits, enclose, reached};
pub use open_box::open_box;
pub use open_faces::OpenFaces;
pub use partition::{NoPartition, Partition};
pub use plane::{Face, Plane, PlaneId};
pub use planes::Planes;
pub use region::{ForeignRegion, RegionPlanes, region_of};
pub use sights::sights;
pub use solids::{Solid, solids};
pub use table::table;
pub use tree::{LeafId, OUTSIDE, PortalId, Tree};
