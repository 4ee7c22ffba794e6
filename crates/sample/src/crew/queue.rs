//! Who computes which item of a phase: the costliest first, in pieces that shrink as the phase goes on.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// A helper's number, unique within its crew.
pub type Member = u64;

/// Pieces that a helper has at once: one that it computes, and one that waits for it.
pub const IN_HAND: usize = 2;
/// A piece for a helper has this part of what an even share of the rest would be.
const PART_OF_SHARE: u64 = 4;

/// The items of a phase that have no answers yet. Public for measurements that replay a crew.
#[derive(Debug, Default)]
pub struct Queue {
    /// Items that nobody computes, the costliest first.
    free: VecDeque<usize>,
    costs: Vec<u64>,
    /// The cost of the free items.
    left: u64,
    /// The helper that computes each item.
    given: BTreeMap<usize, Member>,
    /// Given items that the leader computes as well, because it has nothing else to do.
    repeated: BTreeSet<usize>,
}

impl Queue {
    /// A phase with items of these costs.
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

    /// The next item for the leader.
    pub fn next_free(&mut self) -> Option<usize> {
        let item = self.free.pop_front()?;
        self.left = self.left.saturating_sub(self.costs[item]);
        Some(item)
    }

    /// An item that a helper has been given and the leader has not begun, the cheapest first: with nothing
    /// else to do, the leader does not wait for helpers.
    pub fn next_given(&mut self) -> Option<usize> {
        let waiting = self.given.keys().filter(|i| !self.repeated.contains(i));
        let item = waiting.copied().min_by_key(|i| (self.costs[*i], *i))?;
        self.repeated.insert(item);
        Some(item)
    }

    /// Items for a helper, when `members` work on the phase; empty when none are free.
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

    /// Notes that an item has its answer.
    pub fn answered(&mut self, item: usize) {
        self.given.remove(&item);
        self.repeated.remove(&item);
    }

    /// Takes back the items of a helper that has gone; returns whether there were some.
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
    fn every_item_is_handed_out_once_in_shrinking_pieces_the_costliest_first() {
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
    fn what_a_lost_helper_had_is_free_again_unless_the_leader_has_it() {
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
