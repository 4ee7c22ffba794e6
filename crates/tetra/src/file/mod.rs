//! The file format `.tets`: flat arrays with checksums. Queries read the arrays without a copy.
//!
//! The arrays contain the surfaces, the cells between the surfaces, and the hierarchy of boxes over the
//! triangles.

mod contents;
mod error;
pub(crate) mod layout;
mod tets;
mod write;

pub use contents::Contents;
pub use error::TetsError;
pub use layout::{Layout, Section, VERSION};
pub use tets::{MAPPED_FROM, Tets};
pub use write::write;
