//! Errors of reading and writing result files.

use std::path::PathBuf;

/// Why a `.pvs` file is refused or cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum PvsError {
    /// The file cannot be opened or mapped.
    #[error("cannot read {path}: {source}")]
    Open {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The result cannot be written.
    #[error("cannot write the result: {0}")]
    Write(#[source] std::io::Error),
    /// The first bytes are not those of a result.
    #[error(
        "this is not a .pvs file (it is empty or begins otherwise); name a file that `sightline bake` wrote"
    )]
    NotPvs,
    /// The file has another version of the format.
    #[error(
        "this .pvs file has format version {found}, this program reads version {known}; bake it again"
    )]
    Version {
        /// The version of the file.
        found: u32,
        /// The version of this crate.
        known: u32,
    },
    /// The file is shorter or longer than its header says.
    #[error(
        "the .pvs file should have {expected} bytes and has {actual}; copy it again, or bake it again"
    )]
    Length {
        /// Bytes according to the header, or the least that a header needs.
        expected: u64,
        /// Bytes of the file.
        actual: u64,
    },
    /// Some bytes were altered.
    #[error(
        "the .pvs file is damaged: the bytes of its {section} do not match their checksum; copy it again, or \
         bake it again"
    )]
    Checksum {
        /// The part of the file.
        section: &'static str,
    },
    /// The checksums match, but the contents contradict each other.
    #[error("the {section} of the .pvs file is malformed: {reason}; bake it again")]
    Malformed {
        /// The part of the file.
        section: &'static str,
        /// The fault.
        reason: String,
    },
    /// The nodes do not form a valid cell tree.
    #[error("the cell tree is not valid at node {node}: {reason}")]
    Tree {
        /// Index in depth-first order.
        node: usize,
        /// The fault.
        reason: String,
    },
    /// The objects do not tile the triangles.
    #[error(
        "object {object} starts at triangle {first}, but the objects before it end at {expected}; \
         objects must tile 0…N−1"
    )]
    Objects {
        /// Index of the object (or the number of objects, when the last one does not end at N).
        object: usize,
        /// Its first triangle (or N).
        first: u64,
        /// The first triangle it must have.
        expected: u64,
    },
    /// A cell's ids do not ascend or reach N, or `undecided` is not a subset of `visible`.
    #[error("the {set} set of cell {cell} is not valid: {reason}")]
    Ids {
        /// The cell.
        cell: u32,
        /// `visible` or `undecided`.
        set: &'static str,
        /// The fault.
        reason: String,
    },
    /// The number of pushed cells is not the number of leaves of the tree.
    #[error("the tree has {expected} cells, and {pushed} were given")]
    CellCount {
        /// Leaves of the tree.
        expected: u32,
        /// Cells that were pushed.
        pushed: u64,
    },
    /// A column's name is not valid, or the column does not have one value for each cell.
    #[error("the column {name:?} is not valid: {reason}")]
    Column {
        /// The name as it was given.
        name: String,
        /// The fault.
        reason: String,
    },
    /// A text or a count is beyond the limits of the format.
    #[error("{what} is too large for a .pvs file ({value}, at most {limit})")]
    TooLarge {
        /// Its name.
        what: &'static str,
        /// Its size.
        value: u64,
        /// The largest size allowed.
        limit: u64,
    },
    /// There is no such cell.
    #[error("there is no cell {cell}; the file has {cells}, numbered from 0")]
    NoCell {
        /// The cell that was asked for.
        cell: u32,
        /// The number of cells in the file.
        cells: u32,
    },
    /// The file does not say which cells see which.
    #[error(
        "the file does not say which cells see which; bake it again with --cell-to-cell on, with at most \
         32768 view cells and a method other than portals"
    )]
    NoPairs,
    /// The bit set passed in has the wrong length.
    #[error("the bit set has {given} words of 64; the file's triangles need {needed}")]
    BitsLength {
        /// Words passed in.
        given: usize,
        /// Words needed.
        needed: usize,
    },
    /// There is not enough memory for a set.
    #[error("there is not enough memory for a set over {triangles} triangles")]
    Memory {
        /// The number of triangles, N.
        triangles: u32,
    },
}
