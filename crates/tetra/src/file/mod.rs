//! The file format `.tets`: surfaces and their cells in flat arrays, under checksums.

mod error;
mod layout;
mod read;
mod write;

pub use error::TetsError;
pub use layout::{Layout, Section, VERSION};
pub use read::Contents;
pub use write::write;
