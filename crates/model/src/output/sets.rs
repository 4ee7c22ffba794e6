//! What a tile yields: the samples it rendered, or the subtree of view cells and their sets.

use std::sync::Arc;

use sightline_viewcells::{LatticePoint, Split};

use crate::pairs::TilePairs;
use crate::statistics::{COLUMNS, CellStats, DecisionStats};

/// The result of one tile.
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
    /// Samples with their lattice positions, in ascending order of position.
    pub samples: Vec<(LatticePoint, Arc<VisibilitySample>)>,
}

/// The view cells of a leaf tile.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellSets {
    /// The tile's subtree of the kd-tree, in preorder.
    pub nodes: Vec<Node>,
    /// Its cells, in the order of their nodes.
    pub cells: Vec<CellSet>,
    /// Which cells of the whole division see which, as far as this tile's lines show; `None` when the job
    /// does not ask.
    pub pairs: Option<TilePairs>,
    /// The scene divided along its walls, as the result has it. Of the first tile of a job of the method
    /// portals; empty in others.
    pub portals: Vec<u8>,
}

/// A node of a leaf tile's subtree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// An inner node; its two children follow, first the one below the plane.
    Split(Split),
    /// A view cell.
    Cell,
}

/// The visibility set of one view cell.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellSet {
    /// The items (triangles, unless the job has another granularity) seen from the cell, meeting it, or
    /// undecided, in ascending order.
    pub visible: Vec<u32>,
    /// Number of visibility cubes on the cell's surface.
    pub samples: u32,
    /// How sampling with sight lines came to the set.
    pub stats: CellStats,
    /// What exact queries decided; `None` with the method aggressive.
    pub decision: Option<Decision>,
    /// Whether no viewpoint is in the cell. It was not sampled then, and its set is empty.
    pub unreached: bool,
    /// How many lines met each item of `visible`; `None` when the job does not ask.
    pub hits: Option<Hits>,
}

/// How many lines from a cell met each item of its set: the item's share of the view.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hits {
    /// Number of viewpoints from which lines were cast.
    pub viewpoints: u32,
    /// Lines from each viewpoint.
    pub lines: u32,
    /// For each item of the set, the lines of all viewpoints that met it, and the most from one viewpoint.
    pub counts: Vec<[u32; 2]>,
}

impl CellSet {
    /// The cell's values, in the order of [`crate::statistics::column_names`]. A cell without exact queries
    /// has zeros in their columns, and so has one from a worker that counts fewer of them.
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

/// The part of a cell's result that comes from exact queries.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Decision {
    /// Triangles of the set that were neither seen nor proved hidden, in ascending order.
    pub undecided: Vec<u32>,
    /// The values of [`crate::statistics::DecisionStats`], at most [`Decision::MOST_COUNTS`].
    pub counts: Vec<u64>,
    /// The cell's certificate in bytes; empty when the job keeps none.
    pub certificate: Vec<u8>,
}

impl Decision {
    /// Most counts of a decision.
    pub const MOST_COUNTS: usize = 64;

    /// The number of queries that were asked.
    pub fn queries(&self) -> u64 {
        self.count("exact_queries")
    }

    /// The number of rays that looked for witnesses.
    pub fn rays(&self) -> u64 {
        self.count("exact_rays")
    }

    fn count(&self, name: &str) -> u64 {
        let at = DecisionStats::NAMES.iter().position(|n| *n == name);
        at.and_then(|at| self.counts.get(at)).copied().unwrap_or(0)
    }
}

/// The triangles that one visibility cube saw, with the angular strata they were seen in (Nirenstein and
/// Blake 2004, section 3.5).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VisibilitySample {
    /// Ids of the triangles seen, in ascending order.
    pub ids: Vec<u32>,
    /// For each id the set of strata in which it was seen: bit k for stratum k.
    pub strata: Vec<u32>,
    /// The triangle that covers most pixels, the least id among equals; `None` when only sky was seen. It
    /// decides whether the sample is inside a solid (Nirenstein and Blake 2004, section 3.6).
    pub dominant: Option<u32>,
    /// The ids of all pixels, for the measure Err′ alone: 6·n·n ids, face by face, row by row.
    pub pixels: Option<Arc<[u32]>>,
}

impl VisibilitySample {
    /// Gathers (id, strata mask, pixel count) entries, in any order and with repetitions, into a sample.
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

    /// The sample with more triangles, as (id, strata mask) with repetitions. Pixels and the triangle that
    /// covers most of them stay.
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
