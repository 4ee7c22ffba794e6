//! Limits, verdict and cost of a query between two polygons.

use sightline_certificate::proof::Proof;

use crate::geometry::Source;
use crate::line_space::Decisions;

/// The limits at which a query ends undecided.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Regions processed, over all divisions; the default takes some seconds.
    pub regions: u32,
    /// Vectors and points stored at a time; about 200 bytes each, and more with exact integers.
    pub vectors: u32,
    /// Polar splits of the regions of a pair.
    pub splits: u32,
    /// How often a polygon may be halved, which is also the depth of the recursion.
    pub divisions: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            regions: 200_000,
            vectors: 200_000,
            splits: 64,
            divisions: 12,
        }
    }
}

/// The answer to a query.
#[derive(Clone, Debug)]
pub enum Verdict {
    /// Visible along the segment between these points: the first inside A, the second inside B, and no
    /// triangle in between.
    Visible(Box<[Source; 2]>),
    /// Hidden, with the proof.
    Hidden(Proof),
    /// Undecided, with the reason.
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
    /// Polygons halved as often as [`Limits::divisions`] allows and still undecided.
    #[error("halved to the limit and still undecided")]
    Divisions,
    /// The caller stopped the query.
    #[error("stopped before it was done")]
    Stopped,
}

/// The work of a query, in counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// How signs were decided.
    pub decisions: Decisions,
    /// Regions processed.
    pub regions: u64,
    /// Sight lines traced.
    pub lines: u64,
    /// Occluders subtracted.
    pub occluders: u64,
    /// Polar splits.
    pub splits: u64,
    /// Times a polygon was halved.
    pub divisions: u64,
    /// Greatest number of vectors stored at a time.
    pub vectors: u64,
}

impl Cost {
    /// Counts a region; with the number of vectors stored, the reason to end at the limits or when `stop`
    /// says so.
    pub(super) fn region(
        &mut self,
        vectors: usize,
        limits: &Limits,
        stop: &dyn Fn() -> bool,
    ) -> Option<Reason> {
        self.regions += 1;
        self.vectors = self.vectors.max(vectors as u64);
        if self.regions > u64::from(limits.regions) {
            Some(Reason::Regions)
        } else if vectors as u64 > u64::from(limits.vectors) {
            Some(Reason::Memory)
        } else {
            stop().then_some(Reason::Stopped)
        }
    }
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
