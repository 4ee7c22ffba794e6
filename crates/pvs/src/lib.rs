//! The `.pvs` result: the kd-tree of view cells, the compressed visibility sets and the look-up at run time.
//!
//! A [`Builder`] takes the tree and then the sets of the cells in order, and writes one file. A [`Pvs`] opens
//! a file, checks every byte of it, finds the cell of a point and decodes the cell's set. This
//! crate computes no visibility, reads no scene format and depends on no other crate of the workspace, so
//! that an engine needs no other one.
//!
//! The file has these parts; all numbers are little-endian, and [`layout`] gives the bytes:
//!
//! - a header with the sizes, the file's length and a table of the sections with a CRC-32C each;
//! - `info` and `method`: text about the bake, opaque to this crate;
//! - `tree`: view box and nodes in depth-first order, lower child first; the leaves in this order are the
//!   cells;
//! - `objects`: names and triangle ranges, which tile all triangles;
//! - `flags`: a word for each cell;
//! - `visible`, `undecided`: a coded set for each tree node; a cell's set is the exclusive or of the sets on
//!   its path from the root (Nirenstein 2003, appendix B.1; `hierarchy.rs` chooses the inner sets);
//! - `columns`, optional: named statistics of the bake, one value for each cell;
//! - `certificates`, optional: a certificate for each cell's set, opaque to this crate;
//! - `pairs`, optional: which cells see which ([`Pvs::sees`]);
//! - `items`, optional: the clusters or objects that the sets name instead of triangles ([`Granularity`]);
//! - `contributions`, optional: how much of the view each item takes, for each cell ([`Contribution`]);
//! - `sources`, optional: where each object is in its glTF file ([`Source`]);
//! - `region`, optional: the region that holds all viewpoints, opaque to this crate;
//! - `portals`, optional: the scene divided along its walls ([`Portals`]), for [`Looker`].
//!
//! ```
//! use sightline_pvs::{Builder, CellTree, Header, Node, Object, Pvs};
//!
//! // Two cells, below and above the plane x = 1.
//! let nodes = vec![Node::Split { axis: 0, at: 1.0 }, Node::Leaf, Node::Leaf];
//! let tree = CellTree::new([[0.0; 3], [2.0, 1.0, 1.0]], nodes)?;
//! let objects = vec![Object { name: "house".into(), first: 0, count: 5, source: None }];
//! let (method, info_json) = ("aggressive".into(), "{}".into());
//! let mut builder = Builder::new(Header { triangles: 5, method, tree, objects, info_json })?;
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
//! # Ok::<(), sightline_pvs::PvsError>(())
//! ```

pub mod builder;
mod certificates;
mod codec;
mod columns;
mod contributions;
pub mod error;
#[doc(hidden)]
pub mod fuzzing;
mod hierarchy;
pub mod items;
pub mod layout;
pub mod look;
pub mod pairs;
mod parse;
pub mod portals;
pub mod reader;
pub mod runs;
pub mod tree;

pub use builder::{Builder, Cell, Header, Stats};
pub use columns::Column;
pub use contributions::Contribution;
pub use error::PvsError;
pub use items::{Granularity, Items};
pub use layout::VERSION;
pub use look::{LookError, Looker, View, ViewError};
pub use pairs::{CellPairs, MOST_PAIR_CELLS, Relation};
pub use portals::{Portal, Portals};
pub use reader::{MAPPED_FROM, NodeBytes, Pvs};
pub use tree::{CellTree, MAX_DEPTH, Node};

/// Bit 0 of a cell's flags: the cell's tile was set aside after failures, and all triangles count as visible.
pub const SET_ASIDE: u32 = 1;

/// Bit 1 of a cell's flags: no viewpoint is in the cell, so it was not sampled and its sets are empty.
pub const NOT_REACHED: u32 = 2;

/// A named, contiguous range of triangles that an engine draws at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// Its name in the scene file (glTF node and primitive, OBJ group). It may be empty and need not be
    /// unique.
    pub name: String,
    /// Its first triangle.
    pub first: u32,
    /// The number of its triangles; may be 0.
    pub count: u32,
    /// Where it is in its glTF file; `None` for other files, and in results that do not say.
    pub source: Option<Source>,
}

/// The place of an object in its glTF file, as indices of the file's arrays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// Of the node.
    pub node: u32,
    /// Of the mesh.
    pub mesh: u32,
    /// Of the primitive in its mesh.
    pub primitive: u32,
    /// Of the instance, for a node with `EXT_mesh_gpu_instancing`.
    pub instance: Option<u32>,
}
