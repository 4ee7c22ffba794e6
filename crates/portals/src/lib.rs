//! A scene divided along its walls: convex leaves, the portals between them, and what is reached from a point
//! (Teller 1992, chapters 5 and 8).
//!
//! A [`Tree`] is a binary space partition along planes of the scene's triangles. Its portals are the parts of
//! its splitting planes that no triangle covers, so every free segment between two leaves crosses portals.
//! [`enclose()`] refines a tree until walls enclose given points or a leak is found. All signs are exact:
//! what is not reached here, no walk reaches.
//!
//! The crate knows no view cells and no job.

pub mod along_walls;
pub mod beam;
pub mod choose;
pub mod convex;
pub mod covered;
pub mod enclose;
pub mod open_box;
pub mod open_faces;
pub mod outline;
pub mod partition;
pub mod plane;
pub mod planes;
pub mod region;
pub mod sights;
pub mod solids;
pub mod table;
pub mod tree;

pub use along_walls::along_walls;
pub use enclose::{Enclosure, Limits, enclose, reached};
pub use open_box::open_box;
pub use open_faces::OpenFaces;
pub use partition::{NoPartition, Partition};
pub use plane::{Face, Plane, PlaneId};
pub use planes::Planes;
pub use region::{ForeignRegion, Reached, region_of};
pub use sights::sights;
pub use solids::{Solid, solids};
pub use table::table;
pub use tree::{LeafId, OUTSIDE, PortalId, Tree};
