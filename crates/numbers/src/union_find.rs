//! Disjoint sets of numbers (union-find with path halving; Tarjan and van Leeuwen, "Worst-case Analysis of
//! Set Union Algorithms", 1984).
//!
//! The module is in this crate because the certificate checker uses disjoint sets, and this crate is the only
//! crate of the project on which the checker depends.

/// Disjoint sets of the numbers 0 … n−1.
///
/// The root of a set is its smallest number, so roots do not depend on the order in which numbers were
/// joined.
///
/// ```
/// use sightline_numbers::union_find::UnionFind;
///
/// let mut sets = UnionFind::new(4);
/// sets.join(3, 2);
/// sets.join(1, 3);
/// assert_eq!([0, 1, 2, 3].map(|x| sets.root(x)), [0, 1, 1, 1]);
/// ```
#[derive(Clone, Debug)]
pub struct UnionFind {
    parent: Vec<u32>,
}

impl UnionFind {
    /// Creates one set for each number 0 … n−1; `n` is at most 2³².
    pub fn new(n: usize) -> Self {
        Self {
            parent: (0..n as u32).collect(),
        }
    }

    /// Returns the smallest number of the set that contains `x`.
    ///
    /// # Panics
    /// If `x` is not below the `n` of [`UnionFind::new`].
    pub fn root(&mut self, mut x: u32) -> u32 {
        while self.parent[x as usize] != x {
            // Path halving keeps the trees flat.
            let above = self.parent[self.parent[x as usize] as usize];
            self.parent[x as usize] = above;
            x = above;
        }
        x
    }

    /// Joins the set that contains `a` with the set that contains `b`.
    ///
    /// # Panics
    /// If `a` or `b` is not below the `n` of [`UnionFind::new`].
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Compares the roots with the smallest numbers that repeated relabelling computes, for two orders of
        /// the joins.
        #[test]
        fn roots_are_smallest_numbers(pairs in proptest::collection::vec((0u32..40, 0u32..40), 0..60)) {
            let mut least: Vec<u32> = (0..40).collect();
            loop {
                let before = least.clone();
                for (a, b) in &pairs {
                    let both = least[*a as usize].min(least[*b as usize]);
                    (least[*a as usize], least[*b as usize]) = (both, both);
                }
                if least == before {
                    break;
                }
            }
            let (mut forward, mut backward) = (UnionFind::new(40), UnionFind::new(40));
            pairs.iter().for_each(|(a, b)| forward.join(*a, *b));
            pairs.iter().rev().for_each(|(a, b)| backward.join(*b, *a));
            for x in 0..40 {
                prop_assert_eq!(forward.root(x), least[x as usize]);
                prop_assert_eq!(backward.root(x), least[x as usize]);
            }
        }
    }
}
