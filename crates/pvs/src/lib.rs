//! The `.pvs` result: the kd-tree of view cells, the compressed visibility sets and the look-up at run time.
//!
//! A [`Builder`] takes the tree and then the cells' sets, one cell after another, and writes one file. A [`Pvs`]
//! maps such a file, checks every byte of it, finds the cell of a point and decodes the cell's set. This crate
//! computes no visibility, knows no scene format and depends on no other crate of the workspace, so that an
//! engine can take it alone.
//!
//! The file, all numbers little-endian (see [`layout`] for the bytes):
//!
//! - a header with the sizes, the file's length and a table of the sections with a CRC-32C each;
//! - `info` and `method`: text of whoever baked it, opaque here;
//! - `tree`: view box and nodes in depth-first order, lower child first; leaves numbered as met are the cells;
//! - `objects`: names and triangle ranges, tiling all triangles;
//! - `flags`: one word a cell;
//! - `visible`, `undecided`: for each tree node one coded set; a cell's set is the exclusive or of the sets on
//!   its path from the root (thesis appendix B.1; `hierarchy.rs` says how the inner sets are chosen);
//! - `columns`, only where there are any: what the baker counted in each cell, under a name each;
//! - `evidence`, only where there is any: the reasons for each cell's set, opaque here.
//!
//! ```
//! # use sightline_pvs::*;
//! let tree = CellTree::new([[0.0; 3], [2.0, 1.0, 1.0]], vec![Node::Split { axis: 0, at: 1.0 }, Node::Leaf, Node::Leaf])?;
//! let objects = vec![Object { name: "house".into(), first: 0, count: 5 }];
//! let mut builder =
//!     Builder::new(Header { triangles: 5, method: "aggressive".into(), tree, objects, info_json: "{}".into() })?;
//! builder.push_cell(&[0, 1, 2], &[], 0)?;
//! builder.push_cell(&[1, 2, 4], &[4], 0)?;
//! let mut file = Vec::new();
//! builder.finish(&mut file)?;
//!
//! let pvs = Pvs::from_bytes(file)?;
//! let cell = pvs.find_cell([1.5, 0.5, 0.5]).expect("inside the view box");
//! let mut ids = Vec::new();
//! pvs.visible(cell, &mut ids)?;
//! assert_eq!(ids, [1, 2, 4]);
//! # Ok::<(), PvsError>(())
//! ```

pub mod builder;
mod codec;
mod columns;
pub mod error;
mod evidence;
mod hierarchy;
pub mod layout;
mod parse;
pub mod reader;
mod runs;
pub mod tree;

pub use builder::{Builder, Cell, Header, Stats};
pub use columns::Column;
pub use error::PvsError;
pub use layout::VERSION;
pub use reader::{NodeBytes, Pvs};
pub use tree::{CellTree, MAX_DEPTH, Node};

/// Bit 0 of a cell's flags: the cell's job was set aside, and all triangles are shipped as visible.
pub const SET_ASIDE: u32 = 1;

/// What an engine draws: a named, contiguous range of triangles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// Its name in the scene file (glTF node and primitive, OBJ group). May be empty, need not be unique.
    pub name: String,
    /// Its first triangle.
    pub first: u32,
    /// How many triangles it has; may be 0.
    pub count: u32,
}
