//! Hash maps for one pair of polygons: many maps are created, and few of them grow large.

use rustc_hash::FxHashMap;

/// A map with room for `many` entries: growing an empty map for every pair takes longer than the look-ups.
pub fn with_room<K, V>(many: usize) -> FxHashMap<K, V> {
    FxHashMap::with_capacity_and_hasher(many, rustc_hash::FxBuildHasher)
}
