//! The bodies of the fuzz targets `calls` and `journal`. The tests run them, too.

pub use crate::services::fuzzing::{Interface, Method, calls};
pub use sightline_store::fuzzing::journal;
