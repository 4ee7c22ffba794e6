//! Likely items: the items that complete the sets of a block, and their union with the seen items.

use std::collections::BTreeMap;

/// The number of seen items of a block per likely item.
pub(super) const SEEN_PER_LIKELY: usize = 20;

/// A likely item of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LikelyItem {
    /// The item.
    pub item: u32,
    /// The rank of the item: a number that grows with the expected number of missed lines that end on it.
    pub rank: f32,
}

/// The completion of a block.
pub(super) struct Completion<'a> {
    /// The classes of triangles with the same three vertices, which are seen together.
    pub(super) duplicates: &'a [Vec<u32>],
    /// The class of each triangle that has duplicates.
    pub(super) class: BTreeMap<u32, u32>,
    /// The likely items of each cell, by ascending item; empty before the first completion.
    pub(super) likely: Vec<Vec<LikelyItem>>,
}

/// Returns the likely items of both lists, by ascending item, with the higher of two ranks.
pub(super) fn joined(a: &[LikelyItem], b: &[LikelyItem]) -> Vec<LikelyItem> {
    let mut all = [a, b].concat();
    all.sort_unstable_by(|a, b| a.item.cmp(&b.item).then(b.rank.total_cmp(&a.rank)));
    all.dedup_by_key(|likely| likely.item);
    all
}

/// Returns a set and its undecided part, both in ascending order: the seen items and the highest of the
/// likely items that were not seen, at most `most` of these. Both lists must ascend.
pub(super) fn completed_set(
    mut seen: Vec<u32>,
    mut likely: Vec<LikelyItem>,
    most: usize,
) -> (Vec<u32>, Vec<u32>) {
    likely.retain(|l| seen.binary_search(&l.item).is_err());
    if likely.len() > most {
        likely.sort_unstable_by(|a, b| b.rank.total_cmp(&a.rank).then(a.item.cmp(&b.item)));
        likely.truncate(most);
        likely.sort_unstable_by_key(|l| l.item);
    }
    let undecided: Vec<u32> = likely.into_iter().map(|l| l.item).collect();
    merge(&mut seen, &undecided);
    (seen, undecided)
}

/// Adds ascending numbers to ascending numbers, from the end, so that each number moves once.
fn merge(all: &mut Vec<u32>, added: &[u32]) {
    let (mut old, mut new) = (all.len(), added.len());
    all.resize(old + new, 0);
    while new > 0 {
        let at = old + new - 1;
        if old > 0 && all[old - 1] > added[new - 1] {
            all[at] = all[old - 1];
            old -= 1;
        } else {
            all[at] = added[new - 1];
            new -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn likely(items: &[(u32, f32)]) -> Vec<LikelyItem> {
        let likely = items.iter();
        likely
            .map(|(item, rank)| LikelyItem {
                item: *item,
                rank: *rank,
            })
            .collect()
    }

    #[test]
    fn set_contains_seen_items_and_highest_likely_ones() {
        let items = likely(&[(0, 1.0), (3, 9.0), (4, 3.0), (9, 2.0), (11, 2.0)]);
        let set = completed_set(vec![1, 3, 5, 7], items.clone(), usize::MAX);
        assert_eq!(set, (vec![0, 1, 3, 4, 5, 7, 9, 11], vec![0, 4, 9, 11]));
        let set = completed_set(vec![1, 3, 5, 7], items, 2);
        assert_eq!(set, (vec![1, 3, 4, 5, 7, 9], vec![4, 9]));
    }

    #[test]
    fn joined_item_has_higher_rank() {
        let (a, b) = (likely(&[(1, 2.0), (5, 1.0)]), likely(&[(1, 3.0), (2, 1.0)]));
        let expected = likely(&[(1, 3.0), (2, 1.0), (5, 1.0)]);
        assert_eq!(joined(&a, &b), expected);
    }
}
