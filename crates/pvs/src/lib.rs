//! The `.pvs` result: the kd-tree of view cells, the compressed visibility sets and the look-up at run time.
//!
//! A [`Builder`] receives the tree and then the sets of the cells in order, and writes one file. A [`Pvs`]
//! opens a file, checks every byte of it, finds the cell of a point and decodes the cell's set. This crate
//! does not compute visibility and does not read scene formats.
//!
//! # Modules
//!
//! - `builder`, `hierarchy`, `codec`, `runs`: the writer, the choice of sets at inner nodes, and the coded
//!   sets.
//! - `reader`, `parse`, `tree`: the reader, and the [`CellTree`] that finds the cell of a point.
//! - `looker`, `portals`: queries from a point through portals ([`Looker`]).
//! - `pairs`, `items`, `columns`, `contributions`, `certificates`: the optional sections.
//! - `layout`: the header, the section table and the checksums. `docs/formats/pvs.md` defines every byte.
//!
//! # The file
//!
//! All numbers are little-endian. The file has the following parts:
//!
//! - a header with the sizes, the file's length and a table of the sections with a CRC-32C each;
//! - `info` and `method`: text about the bake, which this crate does not parse;
//! - `tree`: view box and nodes in depth-first order, lower child first; the leaves in this order are the
//!   cells;
//! - `objects`: names and triangle ranges, which tile all triangles;
//! - `flags`: one word per cell;
//! - `visible`, `undecided`: one coded set per tree node; a cell's set is the exclusive or of the sets on its
//!   path from the root (Nirenstein 2003, appendix B.1; `hierarchy.rs` chooses the inner sets);
//! - `columns`, optional: named statistics of the bake, one value per cell;
//! - `certificates`, optional: one certificate per cell's set, which this crate does not parse;
//! - `pairs`, optional: the relation of cells that see each other ([`Pvs::sees`]);
//! - `items`, optional: the clusters or objects that the sets name instead of triangles ([`Granularity`]);
//! - `contributions`, optional: the contribution of each item to the view, per cell ([`Contribution`]);
//! - `sources`, optional: the node, mesh and primitive of each object in its glTF file ([`Source`]);
//! - `region`, optional: the region that contains all viewpoints, which this crate does not parse;
//! - `portals`, optional: the scene divided along its walls ([`Portals`]), for [`Looker`].
//!
//! # Invariants
//!
//! - The crate depends on no other crate of the workspace, so that an engine needs only this crate.
//! - [`Pvs::open`] rejects an altered or truncated file. A file with right checksums and wrong contents
//!   returns an error and does not panic.
//! - Threads can share a [`Pvs`], and look-ups acquire no lock.
//!
//! # Example
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
pub mod looker;
pub mod pairs;
mod parse;
pub mod portals;
pub mod reader;
pub mod runs;
pub mod scene_parts;
pub mod tree;

pub use builder::{Builder, Cell, Header, Stats};
pub use codec::coded_bytes;
pub use columns::Column;
pub use contributions::Contribution;
pub use error::PvsError;
pub use items::{Granularity, Items};
pub use layout::VERSION;
pub use looker::{LookError, Looker, View, ViewError};
pub use pairs::{CellPairs, MOST_PAIR_CELLS, Relation};
pub use portals::{Portal, Portals};
pub use reader::{MAPPED_FROM, NodeBytes, Pvs};
pub use scene_parts::SceneParts;
pub use tree::{CellTree, MAX_DEPTH, Node};

/// The flag (bit 0) of a cell whose tile was set aside after failures or has no output. The cell's set was
/// not computed: all of its items are undecided, or the set contains all items.
pub const SET_ASIDE: u32 = 1;

/// The flag of a cell (bit 1) without viewpoints. The cell was not sampled, and its sets are empty.
pub const NOT_REACHED: u32 = 2;

/// A named, contiguous range of triangles that an engine draws at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// The name of the object in the scene file (glTF node and primitive, OBJ group). The name may be empty
    /// and need not be unique.
    pub name: String,
    /// The first triangle of the object.
    pub first: u32,
    /// The number of triangles of the object; may be 0.
    pub count: u32,
    /// The indices of the object in its glTF file. `None` for other file formats, and for results without
    /// this section.
    pub source: Option<Source>,
}

/// The source of an object: indices in the arrays of its glTF file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// The index of the node.
    pub node: u32,
    /// The index of the mesh.
    pub mesh: u32,
    /// The index of the primitive in its mesh.
    pub primitive: u32,
    /// The index of the instance, for a node with `EXT_mesh_gpu_instancing`.
    pub instance: Option<u32>,
}
