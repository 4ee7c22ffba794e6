//! Bytes for packs and cell sets: differences as variable-length integers, then zstd.
//!
//! Equal values give equal bytes, so the digest of the bytes identifies the content. Decoding trusts nothing:
//! every count is checked against the bytes that are left before anything is allocated for it.

use std::io::Read;
use std::sync::Arc;

use rayon::prelude::*;
use sightline_numbers::varint::{self, VarintError};
use sightline_viewcells::{CellBox, LatticePoint, Split};

use crate::output::{CellSet, CellSets, Decision, Node, Pack, TileOutput, VisibilitySample};
use crate::statistics::CellStats;

/// Compression level. Differences between ids hold no long matches, so levels 2 and 3 take longer and give
/// nothing smaller.
const LEVEL: i32 = 1;
/// From this number of ids on, cells are coded on all cores; below it, waiting for the cores takes longer.
const MANY: usize = 1 << 20;
/// Most bytes one tile's output may unpack to: far above any real tile, far below a machine's memory.
pub const MAX_UNPACKED: u64 = 4 << 30;

/// The bytes are not a tile's output.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a tile's output cannot be read: {0}; it was damaged or written by another version")]
pub struct CodecError(&'static str);

/// Encodes a tile's output.
pub fn encode(output: &TileOutput) -> Result<Vec<u8>, std::io::Error> {
    let mut raw = Vec::new();
    match output {
        TileOutput::Pack(pack) => {
            raw.push(b'P');
            put(&mut raw, pack.samples.len() as u32);
            for (p, s) in &pack.samples {
                p.iter().for_each(|c| put(&mut raw, *c));
                put_ids(&mut raw, &s.ids);
                // Neighbouring ids are mostly seen in the same strata.
                let mut last = 0;
                for m in &s.strata {
                    put(&mut raw, m ^ last);
                    last = *m;
                }
                put(&mut raw, s.dominant.map_or(0, |d| d.wrapping_add(1)));
                match &s.pixels {
                    None => put(&mut raw, 0),
                    Some(pixels) => {
                        put(&mut raw, pixels.len() as u32);
                        // Runs along the rows, as the paper stores its samples (2004, §4.2.2).
                        for run in pixels.chunk_by(|a, b| a == b) {
                            put(&mut raw, run.len() as u32);
                            put(&mut raw, run[0].wrapping_add(1));
                        }
                    }
                }
            }
        }
        TileOutput::Cells(sets) => {
            raw.push(b'C');
            put(&mut raw, sets.nodes.len() as u32);
            for node in &sets.nodes {
                match node {
                    Node::Cell => raw.push(3),
                    Node::Split(s) => {
                        raw.push(s.axis as u8);
                        put(&mut raw, s.at);
                    }
                }
            }
            // Where cells are decided exactly the cores have other work, of minutes: whoever holds a lock
            // here would wait for it.
            let sampled = sets.cells.iter().all(|c| c.decision.is_none());
            let ids: usize = sets.cells.iter().map(|c| c.visible.len()).sum();
            if sampled && ids >= MANY {
                let cells: Vec<Vec<u8>> = sets
                    .cells
                    .par_iter()
                    .map(|cell| {
                        // Most ids take a byte.
                        let mut raw = Vec::with_capacity(cell.visible.len() + cell.visible.len() / 4 + 64);
                        put_cell(cell, &mut raw).map(|()| raw)
                    })
                    .collect::<Result<_, _>>()?;
                raw.reserve(cells.iter().map(Vec::len).sum());
                // Each is dropped as soon as it is copied.
                cells.into_iter().for_each(|cell| raw.extend_from_slice(&cell));
            } else {
                sets.cells.iter().try_for_each(|cell| put_cell(cell, &mut raw))?;
            }
        }
    }
    if raw.len() as u64 > MAX_UNPACKED {
        return Err(std::io::Error::other(
            "a tile's output is larger than can be sent; use fewer --block-cells, more cells or a larger \
                --min-distance",
        ));
    }
    zstd::stream::encode_all(raw.as_slice(), LEVEL)
}

/// Decodes a tile's output for a scene of `triangles` triangles.
///
/// # Errors
/// [`CodecError`] saying what is wrong.
pub fn decode(bytes: &[u8], triangles: u32) -> Result<TileOutput, CodecError> {
    read(bytes, triangles, &|_| true)
}

/// Checks a tile's output without keeping its samples: a pack comes back empty, however much it unpacks to.
///
/// # Errors
/// [`CodecError`] saying what is wrong.
pub fn check(bytes: &[u8], triangles: u32) -> Result<TileOutput, CodecError> {
    read(bytes, triangles, &|_| false)
}

/// Decodes a pack, keeping only the samples in the closed box `within`: a leaf tile needs few of a face's
/// samples.
///
/// # Errors
/// [`CodecError`] when the bytes are no pack; also those parts that are not kept are checked.
pub fn decode_pack(bytes: &[u8], triangles: u32, within: &CellBox) -> Result<Pack, CodecError> {
    match read(bytes, triangles, &|p| within.contains(p))? {
        TileOutput::Pack(pack) => Ok(pack),
        TileOutput::Cells(_) => Err(CodecError("it holds cells and not samples")),
    }
}

fn read(bytes: &[u8], triangles: u32, keep: &dyn Fn(LatticePoint) -> bool) -> Result<TileOutput, CodecError> {
    let mut raw = Vec::new();
    zstd::stream::Decoder::new(bytes)
        .and_then(|d| d.take(MAX_UNPACKED).read_to_end(&mut raw))
        .map_err(|_| CodecError("it is not zstd data"))?;
    let mut r = Reader { bytes: &raw, triangles };
    let output = match r.byte()? {
        b'P' => TileOutput::Pack(r.pack(keep)?),
        b'C' => TileOutput::Cells(r.cells()?),
        _ => return Err(CodecError("its kind is unknown")),
    };
    if r.bytes.is_empty() { Ok(output) } else { Err(CodecError("there is more than it announces")) }
}

fn put_cell(cell: &CellSet, raw: &mut Vec<u8>) -> Result<(), std::io::Error> {
    put_ids(raw, &cell.visible);
    put(raw, cell.samples);
    cell.stats.numbers().into_iter().for_each(|n| varint::write(raw, n));
    let Some(decision) = &cell.decision else {
        raw.push(0);
        return Ok(());
    };
    raw.push(1);
    put_ids(raw, &decision.undecided);
    put(raw, decision.counts.len() as u32);
    decision.counts.iter().for_each(|n| varint::write(raw, *n));
    let length = u32::try_from(decision.certificate.len()).map_err(std::io::Error::other)?;
    put(raw, length);
    raw.extend_from_slice(&decision.certificate);
    Ok(())
}

fn put(out: &mut Vec<u8>, value: u32) {
    varint::write(out, value.into());
}

/// Count, then each id's distance from the one before; ids ascend.
fn put_ids(out: &mut Vec<u8>, ids: &[u32]) {
    put(out, ids.len() as u32);
    let mut next = 0;
    for id in ids {
        put(out, id - next);
        next = id + 1;
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    triangles: u32,
}

impl Reader<'_> {
    fn byte(&mut self) -> Result<u8, CodecError> {
        let (first, rest) = self.bytes.split_first().ok_or(CodecError("it is cut short"))?;
        self.bytes = rest;
        Ok(*first)
    }

    fn u32(&mut self) -> Result<u32, CodecError> {
        u32::try_from(self.u64()?).map_err(|_| CodecError("a number is too large"))
    }

    fn u64(&mut self) -> Result<u64, CodecError> {
        varint::read(&mut self.bytes, varint::MOST_BYTES).map_err(|e| match e {
            VarintError::CutShort => CodecError("it is cut short"),
            VarintError::TooLarge => CodecError("a number is too large"),
            VarintError::TooLong | VarintError::NotShortest => CodecError("a number is too long"),
        })
    }

    /// A count of things that take at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, CodecError> {
        let n = self.u32()? as usize;
        if n <= self.bytes.len() / least { Ok(n) } else { Err(CodecError("it announces more than there is")) }
    }

    fn ids(&mut self) -> Result<Vec<u32>, CodecError> {
        let n = self.count(1)?;
        if n > self.triangles as usize {
            return Err(CodecError("it names more triangles than there are"));
        }
        let mut ids = Vec::with_capacity(n);
        let mut next = 0u32;
        for _ in 0..n {
            // Most are of one byte.
            let gap = match self.bytes.split_first() {
                Some((b, rest)) if *b < 0x80 => {
                    self.bytes = rest;
                    u32::from(*b)
                }
                _ => self.u32()?,
            };
            let id = next.checked_add(gap).filter(|id| *id < self.triangles);
            let id = id.ok_or(CodecError("a triangle id is out of range"))?;
            next = id + 1;
            ids.push(id);
        }
        Ok(ids)
    }

    fn pack(&mut self, keep: &dyn Fn(LatticePoint) -> bool) -> Result<Pack, CodecError> {
        let n = self.count(6)?;
        let mut samples = Vec::new();
        let mut before = None;
        for _ in 0..n {
            let p = [self.u32()?, self.u32()?, self.u32()?];
            if before.is_some_and(|q| q >= p) {
                return Err(CodecError("samples are out of order"));
            }
            before = Some(p);
            let ids = self.ids()?;
            let mut last = 0;
            let strata = ids
                .iter()
                .map(|_| {
                    last ^= self.u32()?;
                    Ok(last)
                })
                .collect::<Result<_, CodecError>>()?;
            let dominant = self.u32()?.checked_sub(1);
            if dominant.is_some_and(|d| d >= self.triangles) {
                return Err(CodecError("a triangle id is out of range"));
            }
            let keep = keep(p);
            let pixels = self.pixels(keep)?;
            if keep {
                samples.push((p, Arc::new(VisibilitySample { ids, strata, dominant, pixels })));
            }
        }
        Ok(Pack { samples })
    }

    fn pixels(&mut self, keep: bool) -> Result<Option<Arc<[u32]>>, CodecError> {
        let n = self.u32()? as usize;
        if n == 0 {
            return Ok(None);
        }
        // The largest cube that parameters allow.
        if n > 6 * 4096 * 4096 {
            return Err(CodecError("a cube has too many pixels"));
        }
        let (mut pixels, mut read) = (Vec::new(), 0);
        while read < n {
            let run = self.u32()? as usize;
            let id = self.u32()?.wrapping_sub(1);
            if run == 0 || run > n - read {
                return Err(CodecError("a run of pixels is too long"));
            }
            read += run;
            if keep {
                pixels.resize(read, id);
            }
        }
        Ok(Some(pixels.into()))
    }

    fn stats(&mut self) -> Result<CellStats, CodecError> {
        let mut numbers = [0; CellStats::NAMES.len()];
        for n in &mut numbers {
            *n = self.u64()?;
        }
        CellStats::from_numbers(numbers).ok_or(CodecError("a cell's statistics are beyond their range"))
    }

    fn cells(&mut self) -> Result<CellSets, CodecError> {
        let n = self.count(1)?;
        let mut nodes = Vec::with_capacity(n);
        let mut cells = 0usize;
        // Subtrees still to be read: a preorder that is a tree uses up exactly its nodes.
        let mut open = 1usize;
        for _ in 0..n {
            if open == 0 {
                return Err(CodecError("its tree has too many nodes"));
            }
            match self.byte()? {
                3 => {
                    nodes.push(Node::Cell);
                    cells += 1;
                    open -= 1;
                }
                axis @ 0..3 => {
                    nodes.push(Node::Split(Split { axis: axis.into(), at: self.u32()? }));
                    open += 1;
                }
                _ => return Err(CodecError("a node's kind is unknown")),
            }
        }
        if open != 0 {
            return Err(CodecError("its tree is not whole"));
        }
        let mut sets = CellSets { nodes, cells: Vec::new() };
        for _ in 0..cells {
            let (visible, samples, stats) = (self.ids()?, self.u32()?, self.stats()?);
            let decision = self.decision(&visible)?;
            sets.cells.push(CellSet { visible, samples, stats, decision });
        }
        Ok(sets)
    }

    fn decision(&mut self, visible: &[u32]) -> Result<Option<Decision>, CodecError> {
        match self.byte()? {
            0 => return Ok(None),
            1 => {}
            _ => return Err(CodecError("a decision is of no kind there is")),
        }
        let undecided = self.ids()?;
        let mut rest = visible.iter();
        if !undecided.iter().all(|id| rest.any(|v| v == id)) {
            return Err(CodecError("what is undecided is not in the set"));
        }
        let n = self.count(1)?;
        if n > Decision::MOST_COUNTS {
            return Err(CodecError("a decision has too many counts"));
        }
        let counts = (0..n).map(|_| self.u64()).collect::<Result<_, _>>()?;
        let length = self.count(1)?;
        let (certificate, rest) = self.bytes.split_at(length);
        self.bytes = rest;
        Ok(Some(Decision { undecided, counts, certificate: certificate.to_vec() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ids() -> impl Strategy<Value = Vec<u32>> {
        proptest::collection::btree_set(0u32..1000, 0..20).prop_map(|s| s.into_iter().collect())
    }

    fn sample() -> impl Strategy<Value = VisibilitySample> {
        (ids(), any::<u32>(), proptest::option::of(0u32..1000), proptest::option::of(1usize..30)).prop_map(
            |(ids, seed, dominant, pixels)| VisibilitySample {
                strata: ids.iter().map(|i| i.wrapping_mul(seed)).collect(),
                ids,
                dominant,
                pixels: pixels.map(|n| (0..n as u32).map(|i| (i / 3).wrapping_sub(1)).collect()),
            },
        )
    }

    fn outputs() -> impl Strategy<Value = TileOutput> {
        let pack = proptest::collection::btree_map(any::<[u32; 3]>(), sample(), 0..6).prop_map(|m| {
            TileOutput::Pack(Pack { samples: m.into_iter().map(|(p, s)| (p, Arc::new(s))).collect() })
        });
        let cells =
            (ids(), ids(), 0usize..3, any::<u32>(), any::<u32>()).prop_map(|(a, b, axis, at, samples)| {
                TileOutput::Cells(CellSets {
                    nodes: vec![Node::Split(Split { axis, at }), Node::Cell, Node::Cell],
                    cells: vec![
                        CellSet {
                            visible: a,
                            samples,
                            stats: CellStats {
                                rays: [1, u64::MAX, samples.into(), 4],
                                rounds: samples,
                                bound_look: 3,
                                unfinished: true,
                                ..CellStats::default()
                            },
                            decision: None,
                        },
                        CellSet {
                            samples: 7,
                            decision: Some(Decision {
                                undecided: b.iter().copied().step_by(2).collect(),
                                counts: vec![u64::from(at), u64::MAX],
                                certificate: samples.to_le_bytes().to_vec(),
                            }),
                            visible: b,
                            ..CellSet::default()
                        },
                    ],
                })
            });
        prop_oneof![pack, cells]
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded(output in outputs()) {
            let bytes = encode(&output).unwrap();
            prop_assert_eq!(decode(&bytes, 1000).unwrap(), output);
        }

        #[test]
        fn damage_never_panics(
            output in outputs(),
            at in any::<prop::sample::Index>(),
            with in any::<u8>(),
            cut in any::<prop::sample::Index>(),
        ) {
            // Damage under the compression, where zstd's own checks do not stop it.
            let mut raw = zstd::stream::decode_all(encode(&output).unwrap().as_slice()).unwrap();
            let i = at.index(raw.len());
            raw[i] = with;
            raw.truncate(cut.index(raw.len()) + 1);
            let _ = decode(&zstd::stream::encode_all(raw.as_slice(), 1).unwrap(), 1000);
        }
    }

    #[test]
    fn many_cells_are_coded_as_a_few_are() {
        let cell = |k: u32| CellSet {
            visible: (0..MANY as u32 / 4).map(|i| i * (k + 1)).collect(),
            samples: k,
            ..CellSet::default()
        };
        let split = |at| Node::Split(Split { axis: 0, at });
        let nodes = vec![split(4), split(2), Node::Cell, Node::Cell, split(6), Node::Cell, Node::Cell];
        let sets = CellSets { nodes, cells: (0..4).map(cell).collect() };
        let mut one_by_one = Vec::new();
        sets.cells.iter().for_each(|c| put_cell(c, &mut one_by_one).unwrap());
        let output = TileOutput::Cells(sets);
        let bytes = encode(&output).unwrap();
        let raw = zstd::stream::decode_all(bytes.as_slice()).unwrap();
        assert!(raw.ends_with(&one_by_one));
        assert_eq!(decode(&bytes, 4 * MANY as u32).unwrap(), output);
    }

    #[test]
    fn ids_beyond_the_scene_are_refused() {
        let sets = CellSets {
            nodes: vec![Node::Cell],
            cells: vec![CellSet { visible: vec![5], samples: 1, ..CellSet::default() }],
        };
        let bytes = encode(&TileOutput::Cells(sets)).unwrap();
        assert!(decode(&bytes, 6).is_ok());
        assert!(decode(&bytes, 5).is_err());
        assert!(decode(b"", 5).is_err());
    }

    #[test]
    fn what_is_undecided_has_to_be_in_the_set() {
        let sets = |undecided: &[u32]| {
            let decision = Some(Decision { undecided: undecided.to_vec(), ..Decision::default() });
            let cell = CellSet { visible: vec![2, 5], decision, ..CellSet::default() };
            encode(&TileOutput::Cells(CellSets { nodes: vec![Node::Cell], cells: vec![cell] })).unwrap()
        };
        for fine in [&[][..], &[2], &[5], &[2, 5]] {
            assert!(decode(&sets(fine), 6).is_ok());
        }
        for wrong in [&[1][..], &[2, 3], &[2, 3, 5]] {
            assert!(decode(&sets(wrong), 6).is_err());
        }
    }
}
