//! Maps of one pair of polygons: many are made, few grow large.

use rustc_hash::FxHashMap;

/// A map with room for so many: growing from nothing, pair after pair, takes longer than looking things up.
pub fn with_room<K, V>(many: usize) -> FxHashMap<K, V> {
    FxHashMap::with_capacity_and_hasher(many, rustc_hash::FxBuildHasher)
}
