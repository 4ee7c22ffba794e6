//! The file format `.tets`: surfaces, the cells between them and boxes over them, in flat arrays under
//! checksums that are read in place.

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
