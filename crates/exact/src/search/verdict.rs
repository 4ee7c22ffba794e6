//! The limits, the verdict and the cost of a query between two polygons.

use sightline_certificate::proof::Proof;

use crate::geometry::PointOrigin;
use crate::line_space::Decisions;

/// The limits at which a query ends undecided.
#[derive(Clone, Copy, Debug)]
pub struct QueryLimits {
    /// The maximum number of regions of line space that the query processes, over all halvings of the
    /// polygons. Default: 200,000, which need a few seconds.
    pub regions: u32,
    /// The maximum number of vectors and points of line space stored at a time. Default: 200,000.
    ///
    /// Each needs about 200 bytes, and more with exact integers.
    pub vectors: u32,
    /// The maximum number of polar splits of one initial region of a pair of polygons. Default: 64.
    pub splits: u32,
    /// The maximum number of nested halvings of the polygons. Default: 12.
    pub divisions: u32,
}

impl Default for QueryLimits {
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
    /// B is visible from A along the segment between these points.
    ///
    /// The first point is inside A, the second inside B, and no triangle is in between.
    Visible(Box<[PointOrigin; 2]>),
    /// B is hidden from A, with this proof.
    Hidden(Proof),
    /// The query is undecided, for this reason.
    Undecided(UndecidedReason),
}

/// The reason why a query ended without a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UndecidedReason {
    /// The query processed more regions than [`QueryLimits::regions`].
    #[error("the query processed more regions of line space than its limit")]
    Regions,
    /// The query stored more vectors than [`QueryLimits::vectors`].
    #[error("the query stored more vectors of line space than its limit")]
    Memory,
    /// The query halved the polygons as often as [`QueryLimits::divisions`] allows, and is still undecided.
    #[error("the query halved the polygons as often as its limit allows")]
    Divisions,
    /// The caller stopped the query.
    #[error("the caller stopped the query")]
    Stopped,
}

/// The work of a query, as counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QueryCost {
    /// The number of signs that each stage decided.
    pub decisions: Decisions,
    /// The number of processed regions of line space.
    pub regions: u64,
    /// The number of traced sight lines.
    pub lines: u64,
    /// The number of subtracted occluders.
    pub occluders: u64,
    /// The number of polar splits.
    pub splits: u64,
    /// The number of times that the query halved a polygon.
    pub divisions: u64,
    /// The largest number of vectors and points of line space stored at a time.
    pub vectors: u64,
}

impl QueryCost {
    /// Counts a region, and returns the reason to end the query, or `None` to continue.
    ///
    /// The reason is a limit or that `stop` returned true. `vectors` is the number of vectors stored now.
    pub(super) fn region(
        &mut self,
        vectors: usize,
        limits: &QueryLimits,
        stop: &dyn Fn() -> bool,
    ) -> Option<UndecidedReason> {
        self.regions += 1;
        self.vectors = self.vectors.max(vectors as u64);
        if self.regions > u64::from(limits.regions) {
            Some(UndecidedReason::Regions)
        } else if vectors as u64 > u64::from(limits.vectors) {
            Some(UndecidedReason::Memory)
        } else {
            stop().then_some(UndecidedReason::Stopped)
        }
    }
}

impl std::ops::AddAssign for QueryCost {
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
