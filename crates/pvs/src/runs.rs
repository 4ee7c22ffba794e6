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

/// Returns the boundaries of the runs of ones, where bit i of word w is the id 64·w + i.
pub fn from_bits(bits: &[u64]) -> Vec<u32> {
    let mut bounds = Vec::new();
    let mut before = 0;
    for (base, word) in (0..).step_by(64).zip(bits) {
        // The bits that differ from the bit before.
        let mut changes = word ^ (word << 1 | before);
        before = word >> 63;
        while changes != 0 {
            bounds.push(base + changes.trailing_zeros());
            changes &= changes - 1;
        }
    }
    if before == 1 {
        bounds.push(bits.len() as u32 * 64);
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
    // Each step writes to all outputs, and only the length of an output depends on the data. Branches on the
    // data would be wrong half of the time.
    let most = inputs.iter().map(|input| input.len()).sum();
    let mut outputs = [const { Vec::new() }; O];
    outputs.iter_mut().for_each(|output| output.resize(most, 0));
    let mut lengths = [0usize; O];
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
            let here = heads[i] == at;
            inside ^= u32::from(here) << i;
            next[i] += usize::from(here);
            heads[i] = head(i, next[i]);
        }
        let wanted = f(inside);
        for (o, output) in outputs.iter_mut().enumerate() {
            output[lengths[o]] = at as u32;
            lengths[o] += ((wanted ^ given) >> o & 1) as usize;
        }
        given = wanted;
    }
    for (output, length) in outputs.iter_mut().zip(lengths) {
        output.truncate(length);
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
    fn bits_have_boundaries_of_their_ids() {
        assert_eq!(from_bits(&[]), [0u32; 0]);
        assert_eq!(from_bits(&[0b1101, 0]), [0, 1, 2, 4]);
        assert_eq!(from_bits(&[1 << 63, 1, u64::MAX]), [63, 65, 128, 192]);
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
