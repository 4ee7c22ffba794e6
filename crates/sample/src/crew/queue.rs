//! The assignment of a phase's items to members: the costliest items first, in pieces that shrink.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// A helper's number, unique within its crew.
pub type Member = u64;

/// The number of pieces that a helper has at once: one piece that the helper computes, and one that waits. A
/// piece is a list of items.
pub const IN_HAND: usize = 2;
/// The divisor of an even share: the work of a piece is the helper's even share of the remaining work,
/// divided by this number.
const PART_OF_SHARE: u64 = 4;

/// The items of a phase without answers. The type is public for benchmarks that replay a crew.
#[derive(Debug, Default)]
pub struct Queue {
    /// The indices of the items that no member computes, the costliest first.
    free: VecDeque<usize>,
    costs: Vec<u64>,
    /// The sum of the costs of the free items.
    left: u64,
    /// The helper that computes each assigned item.
    given: BTreeMap<usize, Member>,
    /// The assigned items that the leader also computes, because it has no other work.
    repeated: BTreeSet<usize>,
}

impl Queue {
    /// Creates the queue of a phase whose items have these costs, by index, in any common unit.
    pub fn new(costs: Vec<u64>) -> Self {
        let costs: Vec<u64> = costs.into_iter().map(|c| c.max(1)).collect();
        let mut items: Vec<usize> = (0..costs.len()).collect();
        items.sort_by_key(|i| std::cmp::Reverse(costs[*i]));
        let left = costs.iter().fold(0, |sum: u64, c| sum.saturating_add(*c));
        Self {
            free: items.into(),
            costs,
            left,
            ..Self::default()
        }
    }

    /// Removes and returns the costliest free item, or `None` if no item is free.
    pub fn next_free(&mut self) -> Option<usize> {
        let item = self.free.pop_front()?;
        self.left = self.left.saturating_sub(self.costs[item]);
        Some(item)
    }

    /// Returns the cheapest item that is assigned to a helper and that the leader has not started. The leader
    /// calls this function if it has no other work, so that it does not wait for helpers.
    pub fn next_given(&mut self) -> Option<usize> {
        let waiting = self.given.keys().filter(|i| !self.repeated.contains(i));
        let item = waiting.copied().min_by_key(|i| (self.costs[*i], *i))?;
        self.repeated.insert(item);
        Some(item)
    }

    /// Assigns free items to the helper `member`, and returns their indices. `members` is the number of
    /// members that work on the phase. The list is empty if no item is free.
    pub fn piece(&mut self, member: Member, members: usize) -> Vec<usize> {
        let aim = self.left / (PART_OF_SHARE * members.max(1) as u64);
        let (mut piece, mut cost) = (Vec::new(), 0);
        while let Some(item) = self.next_free() {
            self.given.insert(item, member);
            piece.push(item);
            cost += self.costs[item];
            if cost >= aim {
                break;
            }
        }
        piece
    }

    /// Records that an item has an answer.
    pub fn answered(&mut self, item: usize) {
        self.given.remove(&item);
        self.repeated.remove(&item);
    }

    /// Frees the items of a helper that has left. Returns true if the helper had items.
    pub fn take_back(&mut self, member: Member) -> bool {
        let back: Vec<usize> = self
            .given
            .iter()
            .filter(|(_, m)| **m == member)
            .map(|(i, _)| *i)
            .collect();
        for item in &back {
            self.given.remove(item);
            if !self.repeated.remove(item) {
                self.left = self.left.saturating_add(self.costs[*item]);
                self.free.push_front(*item);
            }
        }
        !back.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_is_assigned_once_costliest_first_in_shrinking_pieces() {
        let mut queue = Queue::new((1..=100).collect());
        let (mut seen, mut sizes) = (BTreeSet::new(), Vec::new());
        assert_eq!(queue.next_free(), Some(99));
        seen.insert(99);
        loop {
            let piece = queue.piece(7, 2);
            if piece.is_empty() {
                break;
            }
            sizes.push(piece.iter().map(|i| *i as u64 + 1).sum::<u64>());
            piece.iter().for_each(|i| assert!(seen.insert(*i)));
        }
        assert_eq!(seen.len(), 100);
        assert!(
            sizes[0] >= (5050 - 100) / 8 && sizes[0] < 5050 / 4,
            "{sizes:?}"
        );
        assert!(sizes.windows(2).all(|w| w[0] + 50 >= w[1]), "{sizes:?}");
    }

    #[test]
    fn lost_helper_frees_items_unless_leader_computes_them() {
        let mut queue = Queue::new(vec![5; 4]);
        let piece = [queue.piece(1, 1), queue.piece(1, 1)].concat();
        assert_eq!(piece.len(), 2);
        while queue.next_free().is_some() {}
        let repeated = queue.next_given().unwrap();
        queue.answered(piece[1]);
        let other = piece[0];
        if repeated == other {
            assert!(queue.take_back(1));
            assert_eq!(queue.next_free(), None);
        } else {
            assert!(queue.take_back(1));
            assert_eq!(queue.next_free(), Some(other));
        }
        assert!(!queue.take_back(1));
        assert_eq!(queue.next_given(), None);
    }
}
