//! The decoder of a tile's output.

use std::sync::Arc;

use sightline_numbers::varint::{self, VarintError};
use sightline_viewcells::{LatticePoint, Split};

use super::error::CodecError;
use crate::output::{CellSet, CellSets, Decision, Hits, Pack, SubtreeNode, VisibilitySample};
use crate::pairs::{MOST_PAIR_CELLS, PairTable, TilePairs};
use crate::statistics::CellStats;

pub(super) struct Reader<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) triangles: u32,
    /// The remaining memory for pixels, in bytes. A run of many pixels has few bytes in the encoding.
    pub(super) room: u64,
}

impl Reader<'_> {
    pub(super) fn byte(&mut self) -> Result<u8, CodecError> {
        let (first, rest) = self
            .bytes
            .split_first()
            .ok_or(CodecError("the bytes are cut short"))?;
        self.bytes = rest;
        Ok(*first)
    }

    fn u32(&mut self) -> Result<u32, CodecError> {
        u32::try_from(self.u64()?).map_err(|_| CodecError("a number exceeds 32 bits"))
    }

    fn u64(&mut self) -> Result<u64, CodecError> {
        varint::read(&mut self.bytes, varint::MOST_BYTES).map_err(|e| match e {
            VarintError::CutShort => CodecError("the bytes are cut short"),
            VarintError::TooLarge => CodecError("a number exceeds 64 bits"),
            VarintError::TooLong | VarintError::NotShortest => {
                CodecError("an integer is not encoded in the shortest form")
            }
        })
    }

    /// Reads a count of elements that have at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, CodecError> {
        let n = self.u32()? as usize;
        if n <= self.bytes.len() / least {
            Ok(n)
        } else {
            Err(CodecError("a count exceeds the remaining bytes"))
        }
    }

    fn ids(&mut self) -> Result<Vec<u32>, CodecError> {
        self.ids_below(self.triangles)
    }

    /// Reads ascending numbers below `limit`, after their count.
    fn ids_below(&mut self, limit: u32) -> Result<Vec<u32>, CodecError> {
        let n = self.count(1)?;
        if n > limit as usize {
            return Err(CodecError(
                "a list of ids is longer than the number of possible ids",
            ));
        }
        let mut ids = Vec::with_capacity(n);
        let mut next = 0u32;
        for _ in 0..n {
            // Most gaps have one byte.
            let gap = match self.bytes.split_first() {
                Some((b, rest)) if *b < 0x80 => {
                    self.bytes = rest;
                    u32::from(*b)
                }
                _ => self.u32()?,
            };
            let id = next.checked_add(gap).filter(|id| *id < limit);
            let id = id.ok_or(CodecError("the id of a triangle or cell is too large"))?;
            next = id + 1;
            ids.push(id);
        }
        Ok(ids)
    }

    pub(super) fn pack(&mut self, keep: &dyn Fn(LatticePoint) -> bool) -> Result<Pack, CodecError> {
        let n = self.count(6)?;
        let mut samples = Vec::new();
        let mut before = None;
        for _ in 0..n {
            let p = [self.u32()?, self.u32()?, self.u32()?];
            if before.is_some_and(|q| q >= p) {
                return Err(CodecError("the positions of samples are not ascending"));
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
                return Err(CodecError("a triangle id is too large"));
            }
            let keep = keep(p);
            let pixels = self.pixels(keep)?;
            if keep {
                samples.push((
                    p,
                    Arc::new(VisibilitySample {
                        ids,
                        strata,
                        dominant,
                        pixels,
                    }),
                ));
            }
        }
        Ok(Pack { samples })
    }

    fn pixels(&mut self, keep: bool) -> Result<Option<Arc<[u32]>>, CodecError> {
        let n = self.u32()? as usize;
        if n == 0 {
            return Ok(None);
        }
        // The pixels of the largest cube that the parameters allow.
        if n > 6 * 4096 * 4096 {
            return Err(CodecError("a visibility cube has more than 6·4096² pixels"));
        }
        if keep {
            let left = self.room.checked_sub(4 * n as u64);
            self.room = left.ok_or(CodecError("the unpacked pixels exceed the tile's limit"))?;
        }
        let (mut pixels, mut read) = (Vec::new(), 0);
        while read < n {
            let run = self.u32()? as usize;
            let id = self.u32()?.wrapping_sub(1);
            if run == 0 || run > n - read {
                return Err(CodecError(
                    "a run of pixels is empty or longer than its cube",
                ));
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
        CellStats::from_numbers(numbers)
            .ok_or(CodecError("a value of a cell's statistics is too large"))
    }

    pub(super) fn cells(&mut self) -> Result<CellSets, CodecError> {
        let n = self.count(1)?;
        let mut nodes = Vec::with_capacity(n);
        let mut cells = 0usize;
        // The number of subtrees that are still to be read. A valid preorder uses exactly its nodes.
        let mut open = 1usize;
        for _ in 0..n {
            if open == 0 {
                return Err(CodecError("the tree of cells has too many nodes"));
            }
            match self.byte()? {
                3 => {
                    nodes.push(SubtreeNode::Cell);
                    cells += 1;
                    open -= 1;
                }
                axis @ 0..3 => {
                    nodes.push(SubtreeNode::Split(Split {
                        axis: axis.into(),
                        at: self.u32()?,
                    }));
                    open += 1;
                }
                _ => {
                    return Err(CodecError(
                        "the first byte of a tree node is not 0, 1, 2 or 3",
                    ));
                }
            }
        }
        if open != 0 {
            return Err(CodecError("the tree of cells has too few nodes"));
        }
        let mut sets = CellSets {
            nodes,
            ..CellSets::default()
        };
        for _ in 0..cells {
            let visible = self.ids()?;
            let undecided = self.part_of(&visible)?;
            let (samples, stats) = (self.u32()?, self.stats()?);
            let unreached = match self.byte()? {
                0 => false,
                1 if visible.is_empty() => true,
                _ => {
                    return Err(CodecError(
                        "the byte of the unreached flag is not 0 or 1, or an unreached cell has items",
                    ));
                }
            };
            let hits = self.hits(visible.len())?;
            let decision = self.decision()?;
            sets.cells.push(CellSet {
                visible,
                undecided,
                samples,
                stats,
                decision,
                unreached,
                hits,
            });
        }
        sets.pairs = self.pairs()?;
        sets.portals = self.counted()?;
        Ok(sets)
    }

    /// Reads bytes after their count.
    fn counted(&mut self) -> Result<Vec<u8>, CodecError> {
        let length = self.count(1)?;
        let (counted, rest) = self.bytes.split_at(length);
        self.bytes = rest;
        Ok(counted.to_vec())
    }

    fn hits(&mut self, items: usize) -> Result<Option<Hits>, CodecError> {
        match self.byte()? {
            0 => return Ok(None),
            1 => {}
            _ => return Err(CodecError("the byte before a cell's hits is not 0 or 1")),
        }
        let (viewpoints, lines) = (self.u32()?, self.u32()?);
        let all = viewpoints.checked_mul(lines).filter(|all| *all > 0);
        let all = all.ok_or(CodecError(
            "the number of lines of a cell's hits is 0 or above 32 bits",
        ))?;
        if items > self.bytes.len() / 2 {
            return Err(CodecError("a count exceeds the remaining bytes"));
        }
        let mut counts = Vec::with_capacity(items);
        for _ in 0..items {
            let count = [self.u32()?, self.u32()?];
            if count[0] > all || count[1] > lines || count[1] > count[0] {
                return Err(CodecError("an item has more hits than lines"));
            }
            counts.push(count);
        }
        Ok(Some(Hits {
            viewpoints,
            lines,
            counts,
        }))
    }

    fn pairs(&mut self) -> Result<Option<TilePairs>, CodecError> {
        let hidden = match self.byte()? {
            0 => return Ok(None),
            1 => false,
            2 => true,
            _ => {
                return Err(CodecError(
                    "the byte before the pairs of cells is not 0, 1 or 2",
                ));
            }
        };
        // Each row has at least one byte, and the limit bounds the memory.
        let cells = self.count(1)? as u32;
        if u64::from(cells) > MOST_PAIR_CELLS {
            return Err(CodecError("the table of pairs has more than 32768 cells"));
        }
        let seen = self.pair_table(cells)?;
        let hidden = if hidden {
            Some(self.pair_table(cells)?)
        } else {
            None
        };
        Ok(Some(TilePairs { seen, hidden }))
    }

    fn pair_table(&mut self, cells: u32) -> Result<PairTable, CodecError> {
        let mut table = PairTable::empty(cells);
        for cell in 0..cells {
            let bounds = self.ids_below(cells + 1)?;
            if bounds.len() % 2 != 0 || bounds.first().is_some_and(|first| *first < cell) {
                return Err(CodecError(
                    "the runs of a cell's pairs have no end, or begin before the cell",
                ));
            }
            bounds
                .chunks_exact(2)
                .flat_map(|run| run[0]..run[1])
                .for_each(|b| table.insert(cell, b));
        }
        Ok(table)
    }

    /// Reads ids, all of which have to be in the set `visible`.
    fn part_of(&mut self, visible: &[u32]) -> Result<Vec<u32>, CodecError> {
        let part = self.ids()?;
        let mut rest = visible.iter();
        match part.iter().all(|id| rest.any(|v| v == id)) {
            true => Ok(part),
            false => Err(CodecError("an undecided item is not in the cell's set")),
        }
    }

    fn decision(&mut self) -> Result<Option<Decision>, CodecError> {
        match self.byte()? {
            0 => return Ok(None),
            1 => {}
            _ => {
                return Err(CodecError(
                    "the byte before a cell's decision is not 0 or 1",
                ));
            }
        }
        let n = self.count(1)?;
        if n > Decision::MOST_COUNTS {
            return Err(CodecError("a cell's decision has more than 64 counts"));
        }
        let counts = (0..n).map(|_| self.u64()).collect::<Result<_, _>>()?;
        let certificate = self.counted()?;
        Ok(Some(Decision {
            counts,
            certificate,
        }))
    }
}
