//! The output of a tile: rendered samples, or a subtree of view cells and their sets.

use std::sync::Arc;

use sightline_viewcells::{LatticePoint, Split};

use crate::pairs::TilePairs;
use crate::statistics::{COLUMNS, CellStats, DecisionStats};

/// The output of one tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TileOutput {
    /// The samples of a face tile or a separator tile.
    Pack(Pack),
    /// The cells of a leaf tile.
    Cells(CellSets),
}

/// The samples that a tile rendered and that other tiles share.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pack {
    /// The samples with their lattice positions, in ascending order of position.
    pub samples: Vec<(LatticePoint, Arc<VisibilitySample>)>,
}

/// The view cells of a leaf tile.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellSets {
    /// The tile's subtree of the kd-tree, in preorder.
    pub nodes: Vec<SubtreeNode>,
    /// The tile's cells, in the order of their nodes.
    pub cells: Vec<CellSet>,
    /// The pairs of cells of the whole division that the tile's lines join; `None` if the job does not
    /// request pairs.
    pub pairs: Option<TilePairs>,
    /// The scene's division along its walls, in the form of the result. Empty for all tiles except the first
    /// tile of a job with portals.
    pub portals: Vec<u8>,
}

/// A node of a leaf tile's subtree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SubtreeNode {
    /// An inner node. Two children follow: first the child below the plane.
    Split(Split),
    /// A view cell.
    Cell,
}

/// The visibility set of one view cell.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellSet {
    /// The items seen from the cell, meeting the cell, or undecided, in ascending order. Items are triangles,
    /// unless the job has another granularity.
    pub visible: Vec<u32>,
    /// The items of `visible` that were neither seen nor proved hidden, in ascending order.
    pub undecided: Vec<u32>,
    /// The number of visibility cubes on the cell's surface.
    pub samples: u32,
    /// The statistics of the sampling with sight lines.
    pub stats: CellStats,
    /// The results of exact queries; `None` for the method aggressive.
    pub decision: Option<Decision>,
    /// True if the cell contains no viewpoint. Such a cell is not sampled, and its set is empty.
    pub unreached: bool,
    /// The numbers of lines that met each item of `visible`; `None` if the job does not request
    /// contributions.
    pub hits: Option<Hits>,
}

/// The numbers of lines from a cell that met each item of the cell's set: the item's share of the view.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hits {
    /// The number of viewpoints from which lines were cast.
    pub viewpoints: u32,
    /// The number of lines from each viewpoint.
    pub lines: u32,
    /// For each item of the set: the number of lines from all viewpoints that met the item, and the largest
    /// number from one viewpoint.
    pub counts: Vec<[u32; 2]>,
}

impl CellSet {
    /// Returns the cell's values, in the order of [`crate::statistics::column_names`].
    ///
    /// The columns of exact queries are 0 in a cell without exact queries. Columns that an older worker does
    /// not count are also 0.
    pub fn row(&self) -> [u64; COLUMNS] {
        let mut row = [0; COLUMNS];
        let counts = self.decision.as_ref().map_or(&[][..], |d| &d.counts);
        let sampled = [u64::from(self.samples)]
            .into_iter()
            .chain(self.stats.numbers());
        for (place, value) in row.iter_mut().zip(sampled.chain(counts.iter().copied())) {
            *place = value;
        }
        row
    }
}

/// The part of a cell's result that exact queries determine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Decision {
    /// The values of [`crate::statistics::DecisionStats`], at most [`Decision::MOST_COUNTS`] values.
    pub counts: Vec<u64>,
    /// The cell's certificate in bytes; empty if the job stores no certificates.
    pub certificate: Vec<u8>,
}

impl Decision {
    /// Maximum number of counts of a decision.
    pub const MOST_COUNTS: usize = 64;

    /// Returns the number of exact queries.
    pub fn queries(&self) -> u64 {
        self.count("exact_queries")
    }

    /// Returns the number of rays that searched for witnesses.
    pub fn rays(&self) -> u64 {
        self.count("exact_rays")
    }

    fn count(&self, name: &str) -> u64 {
        let at = DecisionStats::NAMES.iter().position(|n| *n == name);
        at.and_then(|at| self.counts.get(at)).copied().unwrap_or(0)
    }
}

/// The triangles that one visibility cube saw, with the angular strata in which they were seen (Nirenstein
/// and Blake 2004, section 3.5).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VisibilitySample {
    /// The ids of the seen triangles, in ascending order.
    pub ids: Vec<u32>,
    /// For each id, the set of strata in which the triangle was seen: bit k for stratum k.
    pub strata: Vec<u32>,
    /// The triangle that covers most pixels, the lowest id among equals; `None` if only sky was seen. This
    /// triangle determines whether the sample is inside a solid (Nirenstein and Blake 2004, section 3.6).
    pub dominant: Option<u32>,
    /// The ids of all pixels, only for the measure Err′: 6·n·n ids for a face of n·n pixels, face by face,
    /// row by row.
    pub pixels: Option<Arc<[u32]>>,
}

impl VisibilitySample {
    /// Creates a sample from (id, strata mask, pixel count) entries, in any order and with repetitions.
    pub fn from_runs(mut runs: Vec<(u32, u32, u32)>) -> Self {
        runs.sort_unstable_by_key(|r| r.0);
        let mut sample = Self::default();
        let mut best = 0u64;
        for same in runs.chunk_by(|a, b| a.0 == b.0) {
            let count: u64 = same.iter().map(|r| u64::from(r.2)).sum();
            sample.ids.push(same[0].0);
            sample.strata.push(same.iter().fold(0, |m, r| m | r.1));
            if count > best {
                best = count;
                sample.dominant = Some(same[0].0);
            }
        }
        sample
    }

    /// Returns the sample with more triangles, given as (id, strata mask) with repetitions. The pixels and
    /// the dominant triangle do not change.
    #[must_use]
    pub fn with(self, more: impl Iterator<Item = (u32, u32)>) -> Self {
        let Self {
            ids,
            strata,
            dominant,
            pixels,
        } = self;
        let runs = ids
            .into_iter()
            .zip(strata)
            .chain(more)
            .map(|(id, mask)| (id, mask, 0));
        Self {
            dominant,
            pixels,
            ..Self::from_runs(runs.collect())
        }
    }
}
