//! Errors of reading and writing result files.

use std::path::PathBuf;

/// The reason why a `.pvs` file is rejected or cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum PvsError {
    /// The file cannot be opened or mapped.
    #[error("cannot read {path}: {source}")]
    Open {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The result cannot be written.
    #[error("cannot write the result: {0}")]
    Write(#[source] std::io::Error),
    /// The first bytes are not the magic number of a result.
    #[error(
        "this is not a .pvs file: the file is empty or has other first bytes; name a file that \
         `sightline bake` wrote"
    )]
    NotPvs,
    /// The file has another version of the format.
    #[error(
        "this .pvs file has format version {found}, this program reads version {known}; bake it \
         again"
    )]
    Version {
        /// The format version of the file.
        found: u32,
        /// The format version that this crate supports.
        known: u32,
    },
    /// The length of the file differs from the length that its header states.
    #[error(
        "the .pvs file should have {expected} bytes and has {actual}; copy it again, or bake it \
         again"
    )]
    Length {
        /// The number of bytes that the header states, or the minimum size of a header.
        expected: u64,
        /// The number of bytes of the file.
        actual: u64,
    },
    /// A section or the header does not match its checksum.
    #[error(
        "the .pvs file is damaged: the bytes of its {section} do not match their checksum; copy it again, or \
         bake it again"
    )]
    Checksum {
        /// The name of the damaged part of the file.
        section: &'static str,
    },
    /// The checksums match, but the contents contradict each other.
    #[error("the .pvs file is malformed in its {section}: {reason}; bake the scene again")]
    Malformed {
        /// The name of the malformed part of the file.
        section: &'static str,
        /// A description of the fault.
        reason: String,
    },
    /// The nodes do not form a valid cell tree.
    #[error("the cell tree is not valid at node {node}: {reason}")]
    Tree {
        /// The index of the node in depth-first order.
        node: usize,
        /// A description of the fault.
        reason: String,
    },
    /// The objects do not tile the triangles.
    #[error(
        "object {object} starts at triangle {first}, but the objects before it end at {expected}; \
         objects must tile 0…N−1"
    )]
    Objects {
        /// The index of the object, or the number of objects if the last one does not end at N.
        object: usize,
        /// The first triangle of the object, or N.
        first: u64,
        /// The first triangle that the object must have.
        expected: u64,
    },
    /// The ids of a cell's set do not ascend strictly, an id is too large, or the set does not fit the cell.
    #[error("the {set} set of cell {cell} is not valid: {reason}")]
    Ids {
        /// The index of the cell.
        cell: u32,
        /// The name of the set: `visible` or `undecided`.
        set: &'static str,
        /// A description of the fault.
        reason: String,
    },
    /// The number of cells for which sets, contributions or certificates were pushed does not fit the tree.
    #[error("the tree has {expected} cells, but data for {pushed} was pushed")]
    CellCount {
        /// The number of leaves of the tree.
        expected: u32,
        /// The number of cells that were pushed.
        pushed: u64,
    },
    /// A column's name is not valid, or the column does not have one value for each cell.
    #[error("the column {name:?} is not valid: {reason}")]
    Column {
        /// The name that the caller passed.
        name: String,
        /// A description of the fault.
        reason: String,
    },
    /// A text or a count exceeds a limit of the format.
    #[error("{what} is too large for a .pvs file ({value}, at most {limit})")]
    TooLarge {
        /// The name of the text or count.
        what: &'static str,
        /// The size of the text or count.
        value: u64,
        /// The maximum size.
        limit: u64,
    },
    /// The file has no cell with this index.
    #[error("there is no cell {cell}; the file has {cells}, numbered from 0")]
    NoCell {
        /// The index that the caller passed.
        cell: u32,
        /// The number of cells in the file.
        cells: u32,
    },
    /// The file does not contain cell-to-cell relations.
    #[error(
        "the file contains no cell-to-cell visibility; bake it again with --cell-to-cell on, with \
         at most 32768 view cells and a method other than portals"
    )]
    NoPairs,
    /// The bit set that the caller passed has the wrong length.
    #[error("the bit set has {given} words of 64; the file's triangles need {needed}")]
    BitsLength {
        /// The number of 64-bit words that the caller passed.
        given: usize,
        /// The number of 64-bit words that the file's triangles need.
        needed: usize,
    },
    /// The process has not enough memory for a set of triangles or for a relation between cells.
    #[error("there is not enough memory for a table of {triangles} triangles or cells")]
    Memory {
        /// The number of triangles of a set, or of cells of a relation.
        triangles: u32,
    },
}
