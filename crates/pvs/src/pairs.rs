//! Cell-to-cell visibility: two symmetric relations over the cells, and their bytes.
//!
//! Cell a sees cell b if an unobstructed segment connects a point of a with a point of b. Every cell sees
//! itself. The section contains the coded rows of the relation *visible*. If some pair is undecided, the rows
//! of the relation *undecided* follow. Row i contains only the cells from i on, because the relation is
//! symmetric. Each row is stored as the exclusive or with row i − 1, because neighbouring cells see nearly
//! the same cells. The form of a row is a LEB128 number, which is the length in bytes, and a coded set
//! (module `codec`).

use crate::codec::{self, read_varint, varint};
use crate::error::PvsError;
use crate::layout::Section;
use crate::runs;

/// The maximum number of cells of a file with cell-to-cell relations. A table has cells² / 8 bytes in memory.
pub const MOST_PAIR_CELLS: u32 = 1 << 15;

/// A symmetric relation over cells: one bit per ordered pair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Relation {
    cells: u32,
    words: usize,
    rows: Vec<u64>,
}

impl Relation {
    /// Creates a relation without any pair.
    ///
    /// # Errors
    /// [`PvsError::TooLarge`] if `cells` exceeds [`MOST_PAIR_CELLS`]. [`PvsError::Memory`] if memory is
    /// insufficient.
    pub fn empty(cells: u32) -> Result<Self, PvsError> {
        if cells > MOST_PAIR_CELLS {
            let (value, limit) = (u64::from(cells), u64::from(MOST_PAIR_CELLS));
            return Err(PvsError::TooLarge {
                what: "the number of cells with pairs",
                value,
                limit,
            });
        }
        let words = (cells as usize).div_ceil(64);
        let mut rows = Vec::new();
        let length = words * cells as usize;
        rows.try_reserve_exact(length)
            .map_err(|_| PvsError::Memory { triangles: cells })?;
        rows.resize(length, 0);
        Ok(Self { cells, words, rows })
    }

    /// Returns the number of cells.
    pub fn cells(&self) -> u32 {
        self.cells
    }

    /// Adds the pair of two cells. Both must be below [`Self::cells`].
    pub fn insert(&mut self, a: u32, b: u32) {
        for (a, b) in [(a, b), (b, a)] {
            self.rows[a as usize * self.words + b as usize / 64] |= 1 << (b % 64);
        }
    }

    /// Returns true if two cells are a pair. Both must be below [`Self::cells`].
    pub fn has(&self, a: u32, b: u32) -> bool {
        self.row(a)[b as usize / 64] >> (b % 64) & 1 == 1
    }

    /// Returns the cells that form a pair with `cell`, as bits. Cell `b` is bit `b % 64` of word `b / 64`.
    pub fn row(&self, cell: u32) -> &[u64] {
        &self.rows[cell as usize * self.words..][..self.words]
    }

    /// Returns true if `cell` forms a pair with a cell from `first` to before `end`.
    pub(crate) fn has_any(&self, cell: u32, first: u32, end: u32) -> bool {
        let row = self.row(cell);
        let (from, to) = (
            first as usize / 64,
            (end as usize).div_ceil(64).min(row.len()),
        );
        (from..to).any(|w| {
            let mut bits = row[w];
            if w == from {
                bits &= u64::MAX << (first % 64);
            }
            if (w + 1) * 64 > end as usize {
                bits &= u64::MAX >> (63 - (end - 1) % 64);
            }
            bits != 0
        })
    }

    /// Returns the cells that form a pair with `cell`, ascending.
    pub fn partners(&self, cell: u32) -> impl Iterator<Item = u32> + '_ {
        self.row(cell).iter().enumerate().flat_map(|(w, bits)| {
            let mut rest = *bits;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros())?;
                rest &= rest - 1;
                Some(w as u32 * 64 + bit)
            })
        })
    }

    /// Returns the number of unordered pairs, including the pairs of a cell with itself.
    pub fn pairs(&self) -> u64 {
        let all: u64 = self.rows.iter().map(|w| u64::from(w.count_ones())).sum();
        let own = (0..self.cells).filter(|c| self.has(*c, *c)).count() as u64;
        (all + own) / 2
    }

    /// Appends the bytes of the relation.
    pub(crate) fn encode(&self, out: &mut Vec<u8>) {
        let mut above: Vec<u32> = Vec::new();
        let mut coded = Vec::new();
        for cell in 0..self.cells {
            let later: Vec<u32> = self.partners(cell).filter(|b| *b >= cell).collect();
            let row = runs::from_ids(&later);
            // Remove the previous cell from the row above, because this row does not contain it.
            let [above_here] = runs::sweep([&above, &[cell, u32::MAX]], |m| u32::from(m == 3));
            let [change] = runs::sweep([&row, &above_here], |m| u32::from(m == 1 || m == 2));
            coded.clear();
            codec::encode(&change, false, &mut coded);
            varint(coded.len() as u64, out);
            out.extend_from_slice(&coded);
            above = row;
        }
    }

    /// Decodes a relation over `cells` cells from the front of `bytes`.
    pub(crate) fn decode(bytes: &mut &[u8], cells: u32) -> Result<Self, PvsError> {
        let bad = |reason: &str| Section::CellPairs.malformed(reason);
        // A row has at least one byte, so the length of the file bounds the memory by its square.
        if bytes.len() < cells as usize {
            return Err(bad("the section has fewer bytes than rows"));
        }
        let mut relation = Self::empty(cells)?;
        let mut above: Vec<u32> = Vec::new();
        for cell in 0..cells {
            let (length, rest) =
                read_varint(bytes).ok_or_else(|| bad("the section is cut short"))?;
            let row = usize::try_from(length)
                .ok()
                .and_then(|n| rest.split_at_checked(n));
            let (row, rest) =
                row.ok_or_else(|| bad("a row reaches beyond the end of the section"))?;
            *bytes = rest;
            let mut change = Vec::new();
            codec::decode(row, cells, |start, end| change.extend([start, end]))
                .map_err(|e| bad(&format!("row {cell}: {}", e.0)))?;
            if change.first().is_some_and(|first| *first < cell) {
                return Err(bad("a row contains a cell before the row's own cell"));
            }
            let [above_here] = runs::sweep([&above, &[cell, u32::MAX]], |m| u32::from(m == 3));
            [above] = runs::sweep([&change, &above_here], |m| u32::from(m == 1 || m == 2));
            above
                .chunks_exact(2)
                .flat_map(|run| run[0]..run[1])
                .for_each(|b| relation.insert(cell, b));
        }
        Ok(relation)
    }
}

/// The two cell-to-cell relations of a result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellPairs {
    /// The cells that see each other, including the undecided pairs.
    pub visible: Relation,
    /// The pairs of `visible` that were neither seen nor proved hidden; `None` without such pairs.
    pub undecided: Option<Relation>,
}

impl CellPairs {
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        self.visible.encode(&mut out);
        if let Some(undecided) = self.undecided.as_ref().filter(|u| u.pairs() > 0) {
            undecided.encode(&mut out);
        }
        out
    }

    pub(crate) fn decode(mut bytes: &[u8], cells: u32) -> Result<Self, PvsError> {
        let bad = |reason: &str| Section::CellPairs.malformed(reason);
        let visible = Relation::decode(&mut bytes, cells)?;
        let undecided = match bytes {
            [] => None,
            _ => Some(Relation::decode(&mut bytes, cells)?),
        };
        if !bytes.is_empty() {
            return Err(bad("bytes follow the last row"));
        }
        let pairs = Self { visible, undecided };
        pairs.check(cells)?;
        Ok(pairs)
    }

    /// Checks that both relations have `cells` cells, and that every undecided pair is also visible.
    pub(crate) fn check(&self, cells: u32) -> Result<(), PvsError> {
        let bad = |reason: &str| Err(Section::CellPairs.malformed(reason));
        let Self { visible, undecided } = self;
        if visible.cells != cells || undecided.as_ref().is_some_and(|u| u.cells != cells) {
            return bad("a relation and the tree have different numbers of cells");
        }
        if undecided
            .as_ref()
            .is_some_and(|u| u.rows.iter().zip(&visible.rows).any(|(u, v)| u & !v != 0))
        {
            return bad("a pair is undecided and not visible");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn relation(cells: u32, pairs: &[(u32, u32)]) -> Relation {
        let mut relation = Relation::empty(cells).unwrap();
        pairs
            .iter()
            .for_each(|(a, b)| relation.insert(a % cells, b % cells));
        relation
    }

    proptest! {
        #[test]
        fn relations_round_trip_and_damage_never_panics(
            cells in 1u32..200,
            pairs in proptest::collection::vec((any::<u32>(), any::<u32>()), 0..300),
            open in 0usize..4,
            at in any::<prop::sample::Index>(),
            with in any::<u8>(),
        ) {
            let visible = relation(cells, &pairs);
            let some = relation(cells, &pairs[..open.min(pairs.len())]);
            let undecided = Some(some).filter(|u| u.pairs() > 0);
            let both = CellPairs { visible, undecided };
            let mut bytes = both.encode();
            prop_assert_eq!(&CellPairs::decode(&bytes, cells).unwrap(), &both);
            for a in 0..cells {
                for (first, end) in [(0, cells), (a, a + 1), (a / 2, a + 1), (a, cells)] {
                    let any = (first..end).any(|b| both.visible.has(a, b));
                    prop_assert_eq!(both.visible.has_any(a, first, end), any);
                }
            }
            prop_assert!(CellPairs::decode(&bytes[..bytes.len() - 1], cells).is_err());
            let at = at.index(bytes.len());
            bytes[at] = with;
            let _ = CellPairs::decode(&bytes, cells);
        }
    }

    #[test]
    fn rejects_too_many_cells_before_allocation() {
        assert!(matches!(
            Relation::empty(MOST_PAIR_CELLS + 1),
            Err(PvsError::TooLarge { .. })
        ));
        assert!(CellPairs::decode(&[0; 20], 21).is_err());
    }
}
