//! Stanford PLY: the header, and the numbers after the header as text or as bytes of either order.
//!
//! The header announces elements, their counts and the types of their properties. The body contains the
//! numbers one after another. No code in this module trusts a count.

mod header;
mod value;

pub use header::{Element, Format, Header, HeaderFault, NumberKind, Property, read};
pub use value::{Ascii, Binary, Values};
