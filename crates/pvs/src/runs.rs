//! Sets of triangle ids as sorted lists of boundaries: start, end, start, end, … of maximal runs, with
//! exclusive ends.
//!
//! Triangles with close ids tend to be visible together (Nirenstein 2003, appendix B.2), so sets have few
//! runs. The time of set operations is linear in the number of runs. The exclusive or of sets is the
//! exclusive or of their boundaries.

/// Returns the boundaries of the runs of ascending ids.
pub fn from_ids(ids: &[u32]) -> Vec<u32> {
    let mut bounds: Vec<u32> = Vec::new();
    for &id in ids {
        match bounds.last_mut() {
            Some(end) if *end == id => *end = id + 1,
            _ => bounds.extend([id, id + 1]),
        }
    }
    bounds
}

/// Computes Boolean combinations of up to 32 sets in one sweep over their boundaries. Between two boundaries,
/// all ids are in the same inputs. Bit i of the argument of `f` is set if the ids are in input i. Bit o of
/// the result of `f` adds the ids to output o. `f(0)` must be 0.
pub fn sweep<const I: usize, const O: usize>(
    inputs: [&[u32]; I],
    f: impl Fn(u32) -> u32,
) -> [Vec<u32>; O] {
    let mut outputs = [const { Vec::new() }; O];
    let mut next = [0usize; I];
    // The next boundary of each input, or at the end of an input a value above all boundaries.
    let head = |i: usize, next: usize| inputs[i].get(next).map_or(u64::MAX, |at| u64::from(*at));
    let mut heads: [u64; I] = std::array::from_fn(|i| head(i, 0));
    let (mut inside, mut given) = (0u32, 0u32);
    loop {
        let at = heads.iter().fold(u64::MAX, |least, at| least.min(*at));
        if at == u64::MAX {
            break;
        }
        for i in 0..I {
            if heads[i] == at {
                inside ^= 1 << i;
                next[i] += 1;
                heads[i] = head(i, next[i]);
            }
        }
        let wanted = f(inside);
        for (o, output) in outputs.iter_mut().enumerate() {
            if (wanted ^ given) >> o & 1 == 1 {
                output.push(at as u32);
            }
        }
        given = wanted;
    }
    outputs
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn ids(bounds: &[u32]) -> Vec<u32> {
        bounds.chunks_exact(2).flat_map(|r| r[0]..r[1]).collect()
    }

    #[test]
    fn adjacent_ids_join_into_runs() {
        assert_eq!(from_ids(&[]), [0u32; 0]);
        assert_eq!(from_ids(&[0, 1, 2, 5, 7, 8]), [0, 3, 5, 6, 7, 9]);
    }

    #[test]
    fn sweep_keeps_largest_boundary() {
        let [both] = sweep([&[1, u32::MAX], &[5, 9, 20, u32::MAX]], |m| {
            u32::from(m == 3)
        });
        assert_eq!(both, [5, 9, 20, u32::MAX]);
    }

    proptest! {
        #[test]
        fn sweep_computes_boolean_function_of_sets(
            a in proptest::collection::btree_set(0u32..60, 0..40),
            b in proptest::collection::btree_set(0u32..60, 0..40),
        ) {
            let list = |s: &BTreeSet<u32>| from_ids(&s.iter().copied().collect::<Vec<_>>());
            let [both, either, only_a] = sweep([&list(&a), &list(&b)], |m| {
                u32::from(m == 3) | u32::from(m != 0) << 1 | u32::from(m == 1) << 2
            });
            prop_assert_eq!(ids(&both), a.intersection(&b).copied().collect::<Vec<_>>());
            prop_assert_eq!(ids(&either), a.union(&b).copied().collect::<Vec<_>>());
            prop_assert_eq!(ids(&only_a), a.difference(&b).copied().collect::<Vec<_>>());
            // Runs are maximal: no boundary occurs twice.
            prop_assert!(either.windows(2).all(|w| w[0] < w[1]));
        }
    }
}
