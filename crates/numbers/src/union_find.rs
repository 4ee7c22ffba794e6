//! Disjoint sets of numbers (union-find with path halving; Tarjan and van Leeuwen, "Worst-case Analysis of
//! Set Union Algorithms", 1984).
//!
//! It is in this crate because the certificate checker needs it and depends on no other crate of the project.

/// Disjoint sets of the numbers 0 … n−1. The root of a set is its least number, so roots depend on which
/// numbers were joined and not on the order.
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
    /// `n` sets of one number each; `n` is at most 2³².
    pub fn new(n: usize) -> Self {
        Self {
            parent: (0..n as u32).collect(),
        }
    }

    /// The least number of the set that `x` is in.
    ///
    /// # Panics
    /// When `x` is not below the `n` of [`UnionFind::new`].
    pub fn root(&mut self, mut x: u32) -> u32 {
        while self.parent[x as usize] != x {
            // Path halving keeps the trees flat.
            let above = self.parent[self.parent[x as usize] as usize];
            self.parent[x as usize] = above;
            x = above;
        }
        x
    }

    /// Joins the sets that `a` and `b` are in.
    ///
    /// # Panics
    /// As [`UnionFind::root`].
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
        /// Roots are the least numbers that repeated relabelling finds, whatever the order of the joins.
        #[test]
        fn roots_are_the_least_numbers(pairs in proptest::collection::vec((0u32..40, 0u32..40), 0..60)) {
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
