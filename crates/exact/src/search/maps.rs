//! Hash maps for one pair of polygons: many maps are created, and few of them grow large.

use rustc_hash::FxHashMap;

/// Creates a map with room for `many` entries.
///
/// Growing an empty map for every pair costs more time than the look-ups.
pub fn with_room<K, V>(many: usize) -> FxHashMap<K, V> {
    FxHashMap::with_capacity_and_hasher(many, rustc_hash::FxBuildHasher)
}
