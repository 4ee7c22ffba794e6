//! Stanford PLY: its header, and the numbers behind it as text or as bytes of either order.
//!
//! The header announces elements, their counts and the types of their properties; the body holds the numbers
//! one after another. Nothing here trusts a count.

mod header;
mod value;

pub use header::{Element, Format, Header, HeaderFault, NumberKind, Property, read};
pub use value::{Ascii, Binary, Values};
