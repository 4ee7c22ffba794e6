//! The sample cache of one tile, with counters that show when a sample is final (Nirenstein 2003, section
//! 4.2.2).
//!
//! Every sample touches eight octants, the eighths of space around its position. A finished cell counts the
//! octants that the cell fills: four for a sample in its face, two on an edge, one at a corner. A sample with
//! eight finished octants is dropped, because no unfinished cell can need it. Octants outside the tile count
//! from the start. Samples are stored in the order of their lattice positions, so the result does not depend
//! on the order of insertion.

use std::collections::BTreeMap;
use std::sync::Arc;

use sightline_model::VisibilitySample;
use sightline_viewcells::{CellBox, LatticePoint};

/// The counters of the cache, for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheCounters {
    /// The number of inserted samples.
    pub inserted: u64,
    /// The number of requests for a sample that was in the cache.
    pub hits: u64,
    /// The number of samples dropped because all their octants were finished.
    pub dropped: u64,
    /// The maximum number of samples in the cache at once.
    pub most_held: u64,
}

/// A cache of samples by lattice position.
pub struct SampleCache {
    tile: CellBox,
    entries: BTreeMap<LatticePoint, Entry>,
    counters: CacheCounters,
}

struct Entry {
    sample: Arc<VisibilitySample>,
    final_octants: u8,
}

impl SampleCache {
    /// Creates an empty cache for the tile with the cells in the box `tile`.
    pub fn new(tile: CellBox) -> Self {
        Self {
            tile,
            entries: BTreeMap::new(),
            counters: CacheCounters::default(),
        }
    }

    /// Inserts a sample at position `p`, unless the cache already contains a sample at `p`. All samples of a
    /// position are equally valid, and the order of insertion is fixed.
    pub fn insert(&mut self, p: LatticePoint, sample: Arc<VisibilitySample>) {
        let outside = 8 - self.tile.octants(p);
        if outside == 8 {
            return;
        }
        self.entries.entry(p).or_insert_with(|| {
            self.counters.inserted += 1;
            Entry {
                sample,
                final_octants: outside,
            }
        });
        self.counters.most_held = self.counters.most_held.max(self.entries.len() as u64);
    }

    /// Returns the sample at `p`, if the cache contains one.
    pub fn get(&mut self, p: LatticePoint) -> Option<Arc<VisibilitySample>> {
        let found = self.entries.get(&p).map(|e| Arc::clone(&e.sample));
        self.counters.hits += u64::from(found.is_some());
        found
    }

    /// Returns the samples on the surface of `cell`, by position.
    pub fn on_surface(&self, cell: &CellBox) -> Vec<&VisibilitySample> {
        let x = |x: u32| [x, 0, 0];
        let range = x(cell.lo[0])..=[cell.hi[0], u32::MAX, u32::MAX];
        self.entries
            .range(range)
            .filter(|(p, _)| cell.on_surface(**p))
            .map(|(_, e)| &*e.sample)
            .collect()
    }

    /// Counts the octants of a finished cell and drops the samples that become final.
    pub fn finish(&mut self, cell: &CellBox) {
        let before = self.entries.len();
        self.entries.retain(|p, e| {
            e.final_octants += cell.octants(*p);
            debug_assert!(e.final_octants <= 8, "an octant was finished twice");
            e.final_octants < 8
        });
        self.counters.dropped += (before - self.entries.len()) as u64;
    }

    /// Returns the counters so far.
    pub fn counters(&self) -> CacheCounters {
        self.counters
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sightline_viewcells::Split;

    #[test]
    fn samples_are_dropped_when_last_cell_is_finished() {
        let tile = CellBox {
            lo: [0; 3],
            hi: [4; 3],
        };
        let mut cache = SampleCache::new(tile);
        let sample = Arc::new(VisibilitySample::default());
        for x in 0..=4 {
            for y in 0..=4 {
                for z in 0..=4 {
                    if x % 2 == 0 || y % 2 == 0 || z % 2 == 0 {
                        cache.insert([x, y, z], Arc::clone(&sample));
                    }
                }
            }
        }
        let mut cells = vec![tile];
        for axis in 0..3 {
            cells = cells
                .iter()
                .flat_map(|c| c.children(Split { axis, at: 2 }))
                .collect();
        }
        for (i, cell) in cells.iter().enumerate() {
            assert!(!cache.entries.is_empty(), "cell {i} finds its samples");
            cache.finish(cell);
        }
        assert!(cache.entries.is_empty());
        let c = cache.counters();
        assert_eq!(c.inserted, c.dropped);
    }

    #[test]
    fn cache_ignores_samples_outside_tile() {
        let mut cache = SampleCache::new(CellBox {
            lo: [0; 3],
            hi: [4; 3],
        });
        cache.insert([5, 0, 0], Arc::default());
        assert!(cache.entries.is_empty());
    }
}
