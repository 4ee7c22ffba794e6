//! The encoding of the results of a phase's items: their answers, and the bits that are new in the tables.
//!
//! Numbers have variable length, lists ascend and contain differences, and zstd compresses the whole. The
//! results of all items of a phase are equal for every member, so their bytes are also equal. The decoder
//! checks every index and every count before it changes or allocates anything.

use std::io::Read as _;

use sightline_model::CellStats;
use sightline_numbers::memory::other_than_exhaustion;
use sightline_numbers::varint;
use sightline_trace::lines::bits::SeenBits;
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::lines::tally::Tally;

use crate::crew::ForeignFinds;

/// Compression level. The words of bits contain no long matches.
const LEVEL: i32 = 1;
/// Maximum unpacked size of encoded results, in bytes.
const MAX_UNPACKED: u64 = 4 << 30;

/// The answer of an item.
pub(super) trait ItemResult: Send + Sync {
    /// Appends the encoded answer to `out`.
    fn write(&self, out: &mut Vec<u8>);

    /// Reads an answer from the front of `bytes`.
    fn read(bytes: &mut &[u8]) -> Option<Self>
    where
        Self: Sized;

    /// Returns the number of rays cast for the answer.
    fn rays(&self) -> u64;
}

/// Reads a number of variable length.
fn number(bytes: &mut &[u8]) -> Option<u64> {
    varint::read(bytes, varint::MOST_BYTES).ok()
}

/// An answer that is a number of rays.
impl ItemResult for u64 {
    fn write(&self, out: &mut Vec<u8>) {
        varint::write(out, *self);
    }

    fn read(bytes: &mut &[u8]) -> Option<Self> {
        number(bytes)
    }

    fn rays(&self) -> u64 {
        *self
    }
}

/// An answer that is a number of rays and an estimate from them.
impl ItemResult for (u64, f64) {
    fn write(&self, out: &mut Vec<u8>) {
        varint::write(out, self.0);
        out.extend(self.1.to_bits().to_le_bytes());
    }

    fn read(bytes: &mut &[u8]) -> Option<Self> {
        Some((number(bytes)?, f64::from_bits(word(bytes)?)))
    }

    fn rays(&self) -> u64 {
        self.0
    }
}

/// An answer that is the statistics of a cell and the tally of attempts at its candidates.
impl ItemResult for (CellStats, Tally) {
    fn write(&self, out: &mut Vec<u8>) {
        self.0
            .numbers()
            .into_iter()
            .chain(self.1.numbers())
            .for_each(|n| varint::write(out, n));
    }

    fn read(bytes: &mut &[u8]) -> Option<Self> {
        let mut stats = [0; CellStats::NAMES.len()];
        for n in &mut stats {
            *n = number(bytes)?;
        }
        let mut tally = Tally::default().numbers();
        for n in &mut tally {
            *n = number(bytes)?;
        }
        Some((CellStats::from_numbers(stats)?, Tally::from_numbers(tally)))
    }

    fn rays(&self) -> u64 {
        self.0.rays.iter().sum()
    }
}

fn word(bytes: &mut &[u8]) -> Option<u64> {
    let (first, rest) = bytes.split_first_chunk::<8>()?;
    *bytes = rest;
    Some(u64::from_le_bytes(*first))
}

/// Decoded results: answers by index of the item, and words of bits by their indices in the table of
/// triangles (`seen`) and in the table of pairs (`joined`).
pub(super) struct Finds<A> {
    pub(super) answers: Vec<(usize, A)>,
    pub(super) seen: Vec<(usize, u64)>,
    pub(super) joined: Vec<(usize, u64)>,
}

/// Encodes the answers of some of `items` items, by ascending number, with the bits that are new in the
/// tables since the last barrier.
pub(super) fn encode<'b, A: ItemResult + 'b>(
    items: usize,
    answers: impl Iterator<Item = (usize, &'b A)>,
    bits: Option<&SeenBits>,
    pairs: Option<&Pairs>,
) -> Vec<u8> {
    let mut raw = Vec::new();
    varint::write(&mut raw, items as u64);
    let (mut list, mut count, mut next) = (Vec::new(), 0u64, 0);
    for (item, answer) in answers {
        varint::write(&mut list, (item - next) as u64);
        answer.write(&mut list);
        (count, next) = (count + 1, item + 1);
    }
    varint::write(&mut raw, count);
    raw.append(&mut list);
    let mut words = Words::default();
    if let Some(bits) = bits {
        bits.each_new(|at, word| words.push(at, word));
    }
    std::mem::take(&mut words).end(&mut raw);
    if let Some(pairs) = pairs {
        pairs.each_new(|at, word| words.push(at, word));
    }
    words.end(&mut raw);
    // Without a lack of memory, writing to memory does not fail. The decoder rejects results that are cut
    // short.
    zstd::stream::encode_all(raw.as_slice(), LEVEL)
        .map_err(other_than_exhaustion)
        .unwrap_or_default()
}

/// Words by ascending index.
#[derive(Default)]
struct Words {
    bytes: Vec<u8>,
    count: u64,
    next: usize,
}

impl Words {
    fn push(&mut self, at: usize, word: u64) {
        varint::write(&mut self.bytes, (at - self.next) as u64);
        self.bytes.extend(word.to_le_bytes());
        (self.count, self.next) = (self.count + 1, at + 1);
    }

    fn end(mut self, out: &mut Vec<u8>) {
        varint::write(out, self.count);
        out.append(&mut self.bytes);
    }
}

/// Decodes the results of a phase of `items` items.
///
/// # Errors
/// [`ForeignFinds`] with the first fault of the bytes.
pub(super) fn decode<A: ItemResult>(
    bytes: &[u8],
    items: usize,
    bits: Option<&SeenBits>,
    pairs: Option<&Pairs>,
) -> Result<Finds<A>, ForeignFinds> {
    let mut raw = Vec::new();
    zstd::stream::Decoder::new(bytes)
        .and_then(|d| d.take(MAX_UNPACKED).read_to_end(&mut raw))
        .map_err(|e| {
            other_than_exhaustion(e);
            ForeignFinds("the bytes are not zstd data")
        })?;
    let mut rest = raw.as_slice();
    if number(&mut rest) != Some(items as u64) {
        return Err(ForeignFinds(
            "the results have another number of items than the phase",
        ));
    }
    let count = count(&mut rest, 2)?;
    let (mut answers, mut next) = (Vec::with_capacity(count.min(items)), 0u64);
    for _ in 0..count {
        let item = number(&mut rest)
            .and_then(|gap| next.checked_add(gap))
            .filter(|i| *i < items as u64);
        let item = item.ok_or(ForeignFinds("the index of an item is out of range"))?;
        let answer = A::read(&mut rest).ok_or(ForeignFinds("an answer is malformed"))?;
        answers.push((item as usize, answer));
        next = item + 1;
    }
    let seen = words(&mut rest, bits.map_or(0, SeenBits::places))?;
    let joined = words(&mut rest, pairs.map_or(0, Pairs::places))?;
    match rest {
        [] => Ok(Finds {
            answers,
            seen,
            joined,
        }),
        _ => Err(ForeignFinds("bytes follow after the announced words")),
    }
}

/// Reads a count of elements that have at least `least` bytes each.
fn count(rest: &mut &[u8], least: usize) -> Result<usize, ForeignFinds> {
    let count = number(rest)
        .and_then(|n| usize::try_from(n).ok())
        .filter(|n| *n <= rest.len() / least);
    count.ok_or(ForeignFinds(
        "an announced count exceeds the remaining bytes",
    ))
}

/// Reads words at ascending indices below `places`.
fn words(rest: &mut &[u8], places: usize) -> Result<Vec<(usize, u64)>, ForeignFinds> {
    let count = count(rest, 9)?;
    let (mut words, mut next) = (Vec::with_capacity(count), 0u64);
    for _ in 0..count {
        let at = number(rest)
            .and_then(|gap| next.checked_add(gap))
            .filter(|at| *at < places as u64);
        let at = at.ok_or(ForeignFinds("the index of a word is out of range"))?;
        words.push((
            at as usize,
            word(rest).ok_or(ForeignFinds("the last word is cut short"))?,
        ));
        next = at + 1;
    }
    Ok(words)
}
