//! The coded form of a set. It consists of the lengths of alternating gaps and runs (Nirenstein 2003,
//! appendix B.2, extended to runs of ones), each as an exponential Golomb code.
//!
//! A set has one byte of flags. Unless the set is empty, the following parts come next:
//!
//! - a byte for the order k of the gap code,
//! - a byte for the order of the run code,
//! - the number of runs and the number of bytes of the gap codes, as LEB128 numbers,
//! - the codes of all gaps,
//! - the codes of all runs.
//!
//! Codes fill bytes from the least significant bit up. The last byte is padded with zeros. Gaps and runs are
//! two streams, so that a processor can decode a gap and a run at the same time. A coded set of zero bytes is
//! the empty set in relative form.
//!
//! With w = v + 2ᵏ and n = ⌊log₂ w⌋, the code of v consists of n − k zeros, a one, and the low n bits of w.
//! The coded value of a gap is its length less 1, except for the first gap. The coded value of a run is its
//! length less 1.

/// The flag of a set in absolute form: a reader ignores the sets of the nodes above on the path from the
/// root.
const ABSOLUTE: u8 = 1;
/// The flag of an empty set, after which no bytes follow.
const EMPTY: u8 = 2;
/// The maximum order of a code that is useful for 32-bit numbers.
const MAX_ORDER: u32 = 31;

/// A description of the fault of a coded set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadSet(pub &'static str);

/// Codes a set that is given by its boundaries (see [`crate::runs`]), and appends the code to `out`.
pub fn encode(bounds: &[u32], absolute: bool, out: &mut Vec<u8>) {
    if bounds.is_empty() {
        if absolute {
            out.push(ABSOLUTE | EMPTY);
        }
        return;
    }
    let (mut gap_lengths, mut run_lengths) = (CodeLengths::default(), CodeLengths::default());
    each_gap_and_run(bounds, |gap, run| {
        gap_lengths.add(gap);
        run_lengths.add(run);
    });
    let (mut gaps, mut runs) = (gap_lengths.writer(), run_lengths.writer());
    each_gap_and_run(bounds, |gap, run| {
        gaps.put_code(gap);
        runs.put_code(run);
    });
    out.extend([
        u8::from(absolute) * ABSOLUTE,
        gaps.order as u8,
        runs.order as u8,
    ]);
    let (gaps, runs) = (gaps.finish(), runs.finish());
    varint(bounds.len() as u64 / 2, out);
    varint(gaps.len() as u64, out);
    out.extend(gaps);
    out.extend(runs);
}

/// Returns the number of bytes of a set in absolute form, given by its boundaries (see [`crate::runs`]).
pub fn coded_bytes(bounds: &[u32]) -> u64 {
    if bounds.is_empty() {
        return 1;
    }
    let (mut gaps, mut runs) = (CodeLengths::default(), CodeLengths::default());
    each_gap_and_run(bounds, |gap, run| {
        gaps.add(gap);
        runs.add(run);
    });
    let [gaps, runs] = [gaps, runs].map(|lengths| lengths.best_order().1.div_ceil(8));
    let mut counts = Vec::new();
    varint(bounds.len() as u64 / 2, &mut counts);
    varint(gaps, &mut counts);
    3 + counts.len() as u64 + gaps + runs
}

/// Returns true if a coded set is in absolute form.
pub fn is_absolute(bytes: &[u8]) -> bool {
    bytes.first().is_some_and(|flags| flags & ABSOLUTE != 0)
}

/// Decodes a set of ids below `limit`. Calls `each` with the start and the exclusive end of each run,
/// ascending. On an error, `each` may have been called for some runs.
pub fn decode(bytes: &[u8], limit: u32, mut each: impl FnMut(u32, u32)) -> Result<(), BadSet> {
    let Some((&flags, rest)) = bytes.split_first() else {
        return Ok(());
    };
    if flags == ABSOLUTE | EMPTY && rest.is_empty() {
        return Ok(());
    }
    if flags & !ABSOLUTE != 0 {
        return Err(BadSet("a set has unknown flags"));
    }
    let &[gap_order, run_order, ref rest @ ..] = rest else {
        return Err(BadSet("a set is cut short within its header"));
    };
    let (gap_order, run_order) = (u32::from(gap_order), u32::from(run_order));
    if gap_order.max(run_order) > MAX_ORDER {
        return Err(BadSet("the order of a set's code is above 31"));
    }
    let short = BadSet("a set is cut short");
    let (count, rest) = read_varint(rest).ok_or(short)?;
    let (gap_bytes, rest) = read_varint(rest).ok_or(short)?;
    let (gaps, runs) = usize::try_from(gap_bytes)
        .ok()
        .and_then(|n| rest.split_at_checked(n))
        .ok_or(short)?;
    // Every code has at least one bit, so the number of bytes bounds the loop.
    if count == 0 || count > gaps.len().min(runs.len()) as u64 * 8 {
        return Err(BadSet("the number of a set's runs does not fit its length"));
    }
    let (mut gaps, mut runs) = (BitReader::new(gaps), BitReader::new(runs));
    // The end of the previous run. The value −1 before the first run allows a first gap of 0.
    let mut end = -1i64;
    for _ in 0..count {
        let start = end + 1 + gaps.code(gap_order)?;
        end = start + 1 + runs.code(run_order)?;
        if end > i64::from(limit) {
            return Err(BadSet("a set has an id that is too large"));
        }
        each(start as u32, end as u32);
    }
    gaps.finish()?;
    runs.finish()
}

/// Calls `each` with the numbers to code of every gap and the run after it.
#[inline(always)]
fn each_gap_and_run(bounds: &[u32], mut each: impl FnMut(u32, u32)) {
    // The id after the boundary before the gap. Boundaries ascend strictly, so only the first gap can be 0;
    // it is coded without subtracting 1.
    let mut from = 0;
    for run in bounds.chunks_exact(2) {
        each(run[0] - from, run[1] - run[0] - 1);
        from = run[1].wrapping_add(1);
    }
}

/// The numbers of bits of numbers, which determine the lengths of their codes for every order.
struct CodeLengths {
    /// The number of numbers with each number of bits.
    bits: [u32; 33],
    /// The number of numbers with each number of bits below the leading ones.
    below_ones: [u32; 33],
}

impl Default for CodeLengths {
    fn default() -> Self {
        Self {
            bits: [0; 33],
            below_ones: [0; 33],
        }
    }
}

impl CodeLengths {
    #[inline(always)]
    fn add(&mut self, number: u32) {
        let bits = 32 - number.leading_zeros();
        // The complement of the number within its bits has leading zeros where the number has leading ones.
        let below = 32 - (!number & ((1u64 << bits) - 1) as u32).leading_zeros();
        self.bits[bits as usize] += 1;
        self.below_ones[below as usize] += 1;
    }

    /// Returns the order that codes the numbers in the fewest bits, and the number of these bits. Of several
    /// such orders, returns the lowest.
    fn best_order(&self) -> (u32, u64) {
        let all: u64 = self.bits.iter().map(|n| u64::from(*n)).sum();
        // From the longest number on, all orders give codes of k + 1 bits.
        let longest = self.bits.iter().rposition(|n| *n > 0).unwrap_or(0) as u64;
        // The numbers of more than k bits, twice the sum of their bits, and the numbers of more than k bits
        // below the leading ones. Adding 2ᵏ carries into a new bit for the others of more than k bits.
        let (mut longer, mut twice, mut not_carrying) = (0u64, 0u64, 0u64);
        let mut best = (0, u64::MAX);
        for k in (0..=longest.min(u64::from(MAX_ORDER))).rev() {
            let above = k as usize + 1;
            longer += u64::from(self.bits[above]);
            twice += 2 * (k + 1) * u64::from(self.bits[above]);
            not_carrying += u64::from(self.below_ones[above]);
            // A code has 2n − k + 1 bits with n = ⌊log₂(v + 2ᵏ)⌋. For a number v of b bits, n is k if b ≤ k.
            // Otherwise n is b if all bits from k up are ones, because the sum carries into a new bit, and
            // b − 1 if not.
            let bits = twice - longer * k + longer - 2 * not_carrying + (all - longer) * (k + 1);
            if bits <= best.1 {
                best = (k as u32, bits);
            }
        }
        best
    }

    /// Creates a writer of the codes of the numbers.
    fn writer(&self) -> CodeWriter {
        let (order, bits) = self.best_order();
        CodeWriter {
            order,
            bits: BitWriter {
                out: Vec::with_capacity(bits.div_ceil(8) as usize),
                buffer: 0,
                held: 0,
            },
        }
    }
}

#[cfg(test)]
mod order_tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn best_order_is_shortest_of_all_orders(
            values in proptest::collection::vec((any::<u32>(), 0u32..32).prop_map(|(v, s)| v >> s), 0..40),
        ) {
            let bits = |k: u32| -> u64 {
                let logarithms = values.iter().map(|v| (u64::from(*v) + (1 << k)).ilog2());
                logarithms.map(|n| u64::from(2 * n - k + 1)).sum()
            };
            let best = (0..=MAX_ORDER).min_by_key(|k| bits(*k)).unwrap();
            let mut lengths = CodeLengths::default();
            values.iter().for_each(|v| lengths.add(*v));
            prop_assert_eq!(lengths.best_order(), (best, bits(best)));
        }
    }
}

/// A writer of codes of one order, one after another.
struct CodeWriter {
    order: u32,
    bits: BitWriter,
}

impl CodeWriter {
    #[inline(always)]
    fn put_code(&mut self, number: u32) {
        let k = self.order;
        let w = u64::from(number) + (1 << k);
        let n = w.ilog2();
        let (zeros, low) = (n - k, w & ((1 << n) - 1));
        if zeros + 1 + n <= MOST_PUT {
            self.bits.put((low << 1 | 1) << zeros, zeros + 1 + n);
        } else {
            self.bits.put(1 << zeros, zeros + 1);
            self.bits.put(low, n);
        }
    }

    fn finish(self) -> Vec<u8> {
        self.bits.finish()
    }
}

/// Appends a number as LEB128: 7 bits per byte, the least significant first. The top bit is set in all bytes
/// but the last. The crate contains this code so that it depends on no other crate of the project.
pub fn varint(mut v: u64, out: &mut Vec<u8>) {
    while v >= 0x80 {
        out.push(v as u8 | 0x80);
        v >>= 7;
    }
    out.push(v as u8);
}

pub fn read_varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut v = 0u64;
    for (i, &b) in bytes.iter().enumerate().take(9) {
        v |= u64::from(b & 0x7f) << (7 * i);
        if b < 0x80 {
            return Some((v, &bytes[i + 1..]));
        }
    }
    None
}

/// The maximum number of bits put at once: the buffer contains at most 31 bits before.
const MOST_PUT: u32 = 33;

struct BitWriter {
    out: Vec<u8>,
    buffer: u64,
    held: u32,
}

impl BitWriter {
    /// Appends the low `count` ≤ [`MOST_PUT`] bits of `value`. The other bits of `value` must be 0.
    #[inline(always)]
    fn put(&mut self, value: u64, count: u32) {
        self.buffer |= value << self.held;
        self.held += count;
        while self.held >= 32 {
            self.out
                .extend_from_slice(&(self.buffer as u32).to_le_bytes());
            self.buffer >>= 32;
            self.held -= 32;
        }
    }

    fn finish(mut self) -> Vec<u8> {
        let bytes = self.buffer.to_le_bytes();
        self.out
            .extend_from_slice(&bytes[..self.held.div_ceil(8) as usize]);
        self.out
    }
}

struct BitReader<'a> {
    rest: &'a [u8],
    /// The next bits, least significant first. The bits from `held` on are 0 or a copy of the first bits of
    /// `rest`.
    buffer: u64,
    held: u32,
}

impl<'a> BitReader<'a> {
    fn new(rest: &'a [u8]) -> Self {
        Self {
            rest,
            buffer: 0,
            held: 0,
        }
    }

    /// Fills the buffer to at least 56 bits, or with all remaining bits.
    fn refill(&mut self) {
        if let Some((word, _)) = self.rest.split_first_chunk::<8>() {
            self.buffer |= u64::from_le_bytes(*word) << self.held;
            let bytes = (63 - self.held) >> 3;
            self.rest = &self.rest[bytes as usize..];
            self.held += bytes * 8;
        } else {
            while self.held < 56
                && let Some((&byte, rest)) = self.rest.split_first()
            {
                self.buffer |= u64::from(byte) << self.held;
                self.held += 8;
                self.rest = rest;
            }
        }
    }

    /// Decodes a number with order `k` ≤ 31.
    #[inline(always)]
    fn code(&mut self, k: u32) -> Result<i64, BadSet> {
        // Always refill: a branch would cost more, since the processor cannot predict it.
        self.refill();
        let zeros = self.buffer.trailing_zeros();
        let n = zeros + k;
        let length = zeros + 1 + n;
        if length > self.held {
            return self.long_code(k);
        }
        // `length` ≤ 63 here.
        let low = self.buffer >> (zeros + 1) & ((1 << n) - 1);
        self.buffer >>= length;
        self.held -= length;
        Ok(((1 << n | low) - (1 << k)) as i64)
    }

    /// Decodes a code that is longer than the buffered bits.
    #[cold]
    fn long_code(&mut self, k: u32) -> Result<i64, BadSet> {
        self.refill();
        let zeros = self.buffer.trailing_zeros();
        let n = zeros + k;
        // Numbers of 32 bits need at most n = 32. A buffer of zeros gives 64 zeros.
        if n > 32 {
            return Err(BadSet("the length of a gap or run exceeds 32 bits"));
        }
        self.take(zeros + 1)?;
        self.refill();
        let low = self.take(n)?;
        Ok(((1 << n | low) - (1 << k)) as i64)
    }

    /// Removes and returns the next `count` ≤ 33 bits.
    fn take(&mut self, count: u32) -> Result<u64, BadSet> {
        if count > self.held {
            return Err(BadSet("a set is cut short"));
        }
        let value = self.buffer & ((1 << count) - 1);
        self.buffer >>= count;
        self.held -= count;
        Ok(value)
    }

    /// Checks that fewer than 8 bits remain and that all of them are zero.
    fn finish(self) -> Result<(), BadSet> {
        let spare = self.buffer & ((1u64 << self.held.min(63)) - 1);
        if self.rest.is_empty() && self.held < 8 && spare == 0 {
            Ok(())
        } else {
            Err(BadSet("bytes follow the last run of a set"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs;
    use proptest::prelude::*;

    fn round_trip(bounds: &[u32], absolute: bool, limit: u32) {
        let mut bytes = Vec::new();
        encode(bounds, absolute, &mut bytes);
        let mut back = Vec::new();
        decode(&bytes, limit, |a, b| back.extend([a, b])).unwrap();
        assert_eq!(back, bounds);
        assert_eq!(is_absolute(&bytes), absolute);
        if absolute {
            assert_eq!(coded_bytes(bounds), bytes.len() as u64);
        }
    }

    #[test]
    fn extreme_sets_round_trip() {
        for absolute in [false, true] {
            round_trip(&[], absolute, 0);
            round_trip(&[0, 1], absolute, 1);
            round_trip(&[0, u32::MAX], absolute, u32::MAX);
            round_trip(&[u32::MAX - 1, u32::MAX], absolute, u32::MAX);
            round_trip(&[0, 1, u32::MAX - 1, u32::MAX], absolute, u32::MAX);
            round_trip(
                &(0..2000).map(|i| i * i).collect::<Vec<_>>(),
                absolute,
                4_000_000,
            );
        }
    }

    #[test]
    fn long_codes_in_a_row_round_trip() {
        // This covers 33-bit codes put while 31 bits are buffered: all numbers of short gaps before two long
        // ones.
        for short in 0..64u32 {
            let gaps = (0..short)
                .map(|_| 1)
                .chain([100_000, 100_000, 65_536])
                .chain((0..60).map(|_| 1));
            let mut end = 0;
            let bounds: Vec<u32> = gaps
                .flat_map(|gap| {
                    end += gap + 1;
                    [end - 1, end]
                })
                .collect();
            round_trip(&bounds, false, u32::MAX);
        }
    }

    #[test]
    fn decode_rejects_ids_beyond_limit() {
        let mut bytes = Vec::new();
        encode(&[0, 11], false, &mut bytes);
        assert!(decode(&bytes, 11, |_, _| ()).is_ok());
        assert!(decode(&bytes, 10, |_, _| ()).is_err());
    }

    proptest! {
        #[test]
        fn random_sets_round_trip(
            ids in proptest::collection::btree_set(0u32..3000, 0..600),
            absolute: bool,
        ) {
            let ids: Vec<u32> = ids.into_iter().collect();
            round_trip(&runs::from_ids(&ids), absolute, 3000);
        }

        #[test]
        fn sparse_sets_round_trip(ids in proptest::collection::btree_set(0u32..u32::MAX, 0..60)) {
            let ids: Vec<u32> = ids.into_iter().collect();
            round_trip(&runs::from_ids(&ids), false, u32::MAX);
        }

        /// Covers many short lengths and a few long ones, as in large scenes. With a low order, long lengths
        /// have long codes.
        #[test]
        fn uneven_sets_round_trip(
            lengths in proptest::collection::vec(
                prop_oneof![8 => 1u32..3, 1 => (0u32..22).prop_map(|k| 1 << k), 1 => 1u32..1 << 21],
                2..400,
            ),
        ) {
            let mut end = 0;
            let bounds: Vec<u32> = lengths.iter().map(|l| { end += l; end }).collect();
            round_trip(&bounds[..bounds.len() / 2 * 2], false, u32::MAX);
        }

        #[test]
        fn decode_of_any_bytes_gives_ascending_runs_or_error(
            bytes in proptest::collection::vec(any::<u8>(), 0..80),
            limit: u32,
        ) {
            let mut last = -1i64;
            let mut ascending = true;
            let _ = decode(&bytes, limit, |a, b| {
                ascending &= last < i64::from(a) && a < b && b <= limit;
                last = i64::from(b);
            });
            prop_assert!(ascending);
        }

        #[test]
        fn decode_rejects_truncated_set(
            ids in proptest::collection::btree_set(0u32..3000, 1..100),
            part in 0.0f64..1.0,
        ) {
            let mut bytes = Vec::new();
            encode(&runs::from_ids(&ids.into_iter().collect::<Vec<_>>()), false, &mut bytes);
            let keep = (bytes.len() as f64 * part) as usize;
            prop_assume!(keep > 0);
            prop_assert!(decode(&bytes[..keep], 3000, |_, _| ()).is_err());
        }
    }
}
