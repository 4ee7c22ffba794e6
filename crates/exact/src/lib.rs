//! Exact from-region visibility: queries in line space, witnesses, certificates and a checker of its own.
//!
//! A query asks whether one convex polygon sees another among the triangles of a scene. The answer is a witness (a segment
//! that meets nothing), a proof (which [`checker`] accepts or refuses by exact arithmetic alone), or that neither was
//! found. No tolerance decides anything: doubles with error bounds come first, integers where those cannot tell.

mod bvh;
pub mod cell;
mod cone;
pub mod decide;
mod double;
mod edges;
mod effort;
mod forms;
mod frame;
#[doc(hidden)]
pub mod fuzzing;
mod grow;
mod klein;
mod local;
mod maps;
mod number;
pub mod occluder;
mod polar;
pub mod polygon;
pub mod predicates;
mod prism;
pub mod query;
mod rays;
mod rims;
mod rows;
mod segment;
pub mod surface;
mod trace;
mod vector;

pub use decide::{Decided, Task, Together, decide, together};
pub use effort::Effort;
pub use frame::Source;
pub use occluder::Occluders;
pub use polygon::{Polygon, PolygonError};
pub use query::{Cost, Limits, Reason, Verdict, sightlines, sightlines_until};
pub use sightline_certificate::{CellCertificate as Evidence, Proof, checker, proof};
pub use vector::Decisions;

/// The former names of the certificate's types.
pub mod evidence {
    pub use sightline_certificate::certificate::{faces, few_odd_edges};
    pub use sightline_certificate::{
        CellCertificate as Evidence, GroupCertificate as Shared, HiddenGroup as Hidden, Reason, Target,
        Witness, codec,
    };
}
