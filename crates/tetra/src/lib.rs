//! Exact visibility from a point at run time.
//!
//! The crate divides the space between the surfaces of a scene into convex cells, stores the cells in a
//! `.tets` file, and computes the exact set of triangles visible from a point. The method is from Miszka,
//! Ryan, Gain and Hultquist, "An Application of Tetrahedrisation to From-point Visibility", 2004. This crate
//! uses the tetrahedra that these authors designed: the tetrahedra conform to the surfaces. `docs/look.md`
//! describes the commands, and `docs/decisions/0017-beams-from-a-point.md` the method.
//!
//! # Modules
//!
//! - `delaunay`: Delaunay tetrahedra of points, with exact decisions and consistent ties.
//! - `surfaces`, `cells`, `windings`: triangles with shared points; convex cells that conform to the
//!   triangles; the number of closed solids around each cell.
//! - `build`: [`build()`], which makes the contents of a file from a scene.
//! - `file`: [`Tets`], an opened `.tets` file. `docs/formats/tets.md` has the layout.
//! - `point_query`: queries from a point by beams, through cells or through a hierarchy of boxes
//!   ([`Engine`]), in three [`Mode`]s.
//! - `check`: a checker of cells that uses only integers and no code of the construction.
//! - `division`: cells divided into tetrahedra, for programs that support only tetrahedra.
//!
//! # Invariants
//!
//! - Signs are decided exactly; no query depends on a tolerance or on pixels. In the exact mode both engines
//!   return the same set.
//! - Sets of the aggressive mode are subsets of the exact sets. Exact sets are subsets of the sets of the
//!   conservative mode.
//! - Opening a file checks all its checksums and indices. Queries read the lists of the file in place.
//! - The crate does not depend on a tracer.

mod build;
pub mod cells;
pub mod check;
pub mod delaunay;
pub mod division;
pub mod file;
#[doc(hidden)]
pub mod fuzzing;
pub mod point_query;
pub mod surfaces;
mod watch;
pub mod windings;

pub use build::{BuildError, Built, build};
pub use file::{Tets, TetsError};
pub use point_query::{Engine, LookError, Mode, Scratch, Target, View, VisibleTriangles};
pub use watch::{BuildObserver, BuildStage, Quiet};
