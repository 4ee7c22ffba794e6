//! Everything that can be wrong with a result file, or with what is put into one.

use std::path::PathBuf;

/// Why a `.pvs` file is refused, or cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum PvsError {
    /// The file cannot be opened or mapped.
    #[error("cannot read {path}: {source}")]
    Open {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The result cannot be written.
    #[error("cannot write the result: {0}")]
    Write(#[source] std::io::Error),
    /// The first bytes are not those of a result.
    #[error(
        "this is not a .pvs file (it is empty, or its first bytes are others); name a file that `sightline bake` wrote"
    )]
    NotPvs,
    /// Another version of the format.
    #[error("this .pvs file has format version {found}, this program reads version {known}; bake it again")]
    Version {
        /// In the file.
        found: u32,
        /// Of this crate.
        known: u32,
    },
    /// Shorter or longer than it says.
    #[error("the .pvs file should have {expected} bytes and has {actual}; copy it again, or bake it again")]
    Length {
        /// What its header says, or the least that a header needs.
        expected: u64,
        /// What is there.
        actual: u64,
    },
    /// Altered bytes.
    #[error(
        "the .pvs file is damaged: what it has of the {section} does not fit its checksum; copy it again, or bake it again"
    )]
    Checksum {
        /// Which part.
        section: &'static str,
    },
    /// Consistent checksums around inconsistent contents.
    #[error("the {section} of the .pvs file is malformed: {reason}; bake it again")]
    Malformed {
        /// Which part.
        section: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The cell tree cannot be one.
    #[error("the cell tree is not valid at node {node}: {reason}")]
    Tree {
        /// Index in depth-first order.
        node: usize,
        /// What is wrong.
        reason: String,
    },
    /// The objects do not tile the triangles.
    #[error(
        "object {object} starts at triangle {first}, but the objects before it end at {expected}; objects must tile 0…N−1"
    )]
    Objects {
        /// Index of the object (or the number of objects, when the last one does not end at N).
        object: usize,
        /// Where it starts (or N).
        first: u64,
        /// Where it should.
        expected: u64,
    },
    /// A cell's ids are not ascending, not below N, or `undecided` is not part of `visible`.
    #[error("the {set} set of cell {cell} is not valid: {reason}")]
    Ids {
        /// The cell.
        cell: u32,
        /// `visible` or `undecided`.
        set: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// More or fewer cells pushed than the tree has leaves.
    #[error("the tree has {expected} cells, and {pushed} were given")]
    CellCount {
        /// Leaves of the tree.
        expected: u32,
        /// Given.
        pushed: u64,
    },
    /// A column's name is not fit, or it does not have one value a cell.
    #[error("the column {name:?} is not valid: {reason}")]
    Column {
        /// As it was given.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// A text or a count beyond what the format can hold.
    #[error("{what} is too large for a .pvs file ({value}, at most {limit})")]
    TooLarge {
        /// What.
        what: &'static str,
        /// How large.
        value: u64,
        /// How large it may be.
        limit: u64,
    },
    /// There is no such cell.
    #[error("there is no cell {cell}; the file has {cells}, numbered from 0")]
    NoCell {
        /// Asked for.
        cell: u32,
        /// In the file.
        cells: u32,
    },
    /// A bit set of the wrong length was handed in.
    #[error("the bit set has {given} words of 64; the file's triangles need {needed}")]
    BitsLength {
        /// Words handed in.
        given: usize,
        /// Words needed.
        needed: usize,
    },
    /// No memory for a set.
    #[error("no memory for a set over {triangles} triangles")]
    Memory {
        /// N.
        triangles: u32,
    },
}
