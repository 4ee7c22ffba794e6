//! What a query between two polygons takes and gives: limits, verdict and cost.

use crate::geometry::Source;
use crate::line_space::Decisions;
use crate::proof::Proof;

/// When a query gives up.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Regions looked at, over all divisions; so many as by default take some seconds.
    pub regions: u32,
    /// Vectors and points held at a time; about 200 bytes each, and more where integers were needed.
    pub vectors: u32,
    /// How often the regions of a pair may be split for the sake of the Klein form alone.
    pub splits: u32,
    /// How often a polygon may be halved; so deep does the search recurse.
    pub divisions: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { regions: 200_000, vectors: 200_000, splits: 64, divisions: 12 }
    }
}

/// What is known of two polygons.
#[derive(Clone, Debug)]
pub enum Verdict {
    /// Seen, along the segment between these points: inside A, inside B, and clear of all triangles in between.
    Visible(Box<[Source; 2]>),
    /// Not seen, with the proof.
    Hidden(Proof),
    /// Neither, and why.
    Undecided(Reason),
}

/// Why a query ended without a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// More regions than [`Limits::regions`].
    #[error("more regions of line space than the limit")]
    Regions,
    /// More vectors than [`Limits::vectors`].
    #[error("more memory than the limit")]
    Memory,
    /// Polygons halved as often as [`Limits::divisions`] and still neither.
    #[error("halved to the limit and still undecided")]
    Divisions,
    /// It was told to stop.
    #[error("stopped before it was done")]
    Stopped,
}

/// What a query cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// How signs were decided.
    pub decisions: Decisions,
    /// Regions looked at.
    pub regions: u64,
    /// Lines followed.
    pub lines: u64,
    /// Occluders subtracted.
    pub occluders: u64,
    /// Times a region was split for the sake of the Klein form alone.
    pub splits: u64,
    /// Times a polygon was halved.
    pub divisions: u64,
    /// Most vectors held.
    pub vectors: u64,
}

impl std::ops::AddAssign for Cost {
    fn add_assign(&mut self, o: Self) {
        self.decisions += o.decisions;
        self.regions += o.regions;
        self.lines += o.lines;
        self.occluders += o.occluders;
        self.splits += o.splits;
        self.divisions += o.divisions;
        self.vectors = self.vectors.max(o.vectors);
    }
}
