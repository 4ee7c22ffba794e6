//! What is seen from a point, at run time and exactly.
//!
//! The method is that of Miszka, Ryan, Gain and Hultquist, "An Application of Tetrahedrisation to From-point
//! Visibility", 2004, with the tetrahedra that its authors designed: they conform to the surfaces.

mod build;
pub mod cells;
pub mod check;
pub mod delaunay;
pub mod divide;
pub mod file;
#[doc(hidden)]
pub mod fuzzing;
pub mod look;
pub mod surfaces;
mod watch;
pub mod windings;

pub use build::{BuildError, Built, build};
pub use file::{Tets, TetsError};
pub use look::{Engine, LookError, Mode, Scratch, Seen, Target, View};
pub use watch::{Quiet, Stage, Watch};
