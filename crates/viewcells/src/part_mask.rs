//! The parts of cells in which viewpoints can be. Each cell of a grid has 4×4×4 equal parts, and a mask marks
//! the parts with viewpoints. For a tree of boxes, the mask has one row of cells, in the order of the boxes.
//!
//! A part is marked if a viewpoint may be in the part. So the marked parts contain all viewpoints and a
//! margin of at most one part around the viewpoints. Cells without a marked part are not sampled. Other
//! modules decide which parts to mark (boxes, meshes, points, reachability).

use sightline_numbers::varint;

/// The number of parts along each side of a cell.
pub const PARTS: u32 = 4;

/// The marked parts of the cells of a grid. Cells are in the order of their index: x fastest, then y, then z.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartMask {
    cells: [u32; 3],
    /// The marks of each cell, with bit (z·4 + y)·4 + x for the part x, y, z of the cell.
    parts: Vec<u64>,
}

/// The reason why bytes are not the marks of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the viewpoints cannot be read: {0}")]
pub struct PartMaskError(&'static str);

impl PartMaskError {
    /// The error for bytes after the marks.
    pub const LONG: Self = Self("further bytes follow the marks of the last cell");
}

impl PartMask {
    /// Creates a mask without marks for a grid with the given numbers of cells along each axis, which
    /// [`crate::Division`] must have checked.
    pub fn empty(cells: [u32; 3]) -> Self {
        let count: usize = cells.iter().map(|c| *c as usize).product();
        Self {
            cells,
            parts: vec![0; count],
        }
    }

    /// Creates the mask of a grid of a single cell with the given marks ([`Self::parts`]).
    pub fn single(parts: u64) -> Self {
        Self {
            cells: [1; 3],
            parts: vec![parts],
        }
    }

    /// Returns the number of cells along each axis.
    pub fn cells(&self) -> [u32; 3] {
        self.cells
    }

    /// Returns the number of parts of the grid along each axis.
    pub fn sides(&self) -> [u32; 3] {
        self.cells.map(|c| c * PARTS)
    }

    /// Marks the part at these coordinates in the grid of parts, which must be below [`Self::sides`].
    pub fn mark(&mut self, part: [u32; 3]) {
        let (cell, bit) = self.position(part);
        self.parts[cell] |= 1 << bit;
    }

    /// Marks all parts of the cell with index `cell`.
    pub fn mark_all(&mut self, cell: usize) {
        self.parts[cell] = u64::MAX;
    }

    /// Returns true if the part at these coordinates, which must be below [`Self::sides`], is marked.
    pub fn has(&self, part: [u32; 3]) -> bool {
        let (cell, bit) = self.position(part);
        self.parts[cell] >> bit & 1 == 1
    }

    fn position(&self, part: [u32; 3]) -> (usize, u32) {
        let ([x, y, z], [nx, ny, _]) = (
            part.map(|p| (p / PARTS) as usize),
            self.cells.map(|c| c as usize),
        );
        let [px, py, pz] = part.map(|p| p % PARTS);
        ((z * ny + y) * nx + x, (pz * PARTS + py) * PARTS + px)
    }

    /// Returns the marks of the cell with index `cell`: bit (z·4 + y)·4 + x for the part x, y, z of the cell.
    pub fn parts(&self, cell: usize) -> u64 {
        self.parts[cell]
    }

    /// Returns the number of cells with a marked part.
    pub fn reached(&self) -> usize {
        self.parts.iter().filter(|p| **p != 0).count()
    }

    /// Returns the number of cells.
    pub fn count(&self) -> usize {
        self.parts.len()
    }

    /// Returns the number of marked parts.
    pub fn marked(&self) -> u64 {
        self.parts.iter().map(|p| u64::from(p.count_ones())).sum()
    }

    /// Encodes the marks as runs of cells with equal marks. Each run is a LEB128 number of cells, and the
    /// marks as a little-endian u64.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for run in self.parts.chunk_by(|a, b| a == b) {
            varint::write(&mut bytes, run.len() as u64);
            bytes.extend(run[0].to_le_bytes());
        }
        bytes
    }

    /// Decodes the marks of a grid from the front of `bytes`, and leaves the rest in `bytes`. `cells` are the
    /// numbers of cells along each axis. [`crate::Division`] must have checked the grid.
    ///
    /// # Errors
    /// [`PartMaskError`] if the bytes are not a result of [`Self::encode`], or if no part is marked.
    pub fn decode(bytes: &mut &[u8], cells: [u32; 3]) -> Result<Self, PartMaskError> {
        let mut marks = Self::empty(cells);
        let (mut at, mut before) = (0usize, None);
        while at < marks.parts.len() && !bytes.is_empty() {
            let length = varint::read(bytes, varint::MOST_BYTES);
            let length = length.map_err(|_| PartMaskError("the length of a run is malformed"))?;
            let (word, rest) = bytes
                .split_first_chunk::<8>()
                .ok_or(PartMaskError("the marks of a run are cut short"))?;
            *bytes = rest;
            let word = u64::from_le_bytes(*word);
            let end = usize::try_from(length).ok().and_then(|n| at.checked_add(n));
            let run = end.and_then(|end| marks.parts.get_mut(at..end));
            let run = run.ok_or(PartMaskError(
                "the runs cover more cells than the division has",
            ))?;
            // Each mask has only one encoding, because the bytes are part of a job's key.
            if run.is_empty() || before == Some(word) {
                return Err(PartMaskError(
                    "a run is empty, or the next run has the same marks",
                ));
            }
            run.fill(word);
            (at, before) = (at + run.len(), Some(word));
        }
        if at != marks.parts.len() {
            return Err(PartMaskError(
                "the runs cover fewer cells than the division has",
            ));
        }
        if marks.reached() == 0 {
            return Err(PartMaskError(
                "no part of a cell is marked; mark at least one part",
            ));
        }
        Ok(marks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn marks_round_trip_and_damage_never_panics(
            cells in [1u32..5, 1u32..5, 1u32..5],
            places in proptest::collection::vec([any::<u32>(), any::<u32>(), any::<u32>()], 1..40),
            at in any::<prop::sample::Index>(),
            with in any::<u8>(),
        ) {
            let mut marks = PartMask::empty(cells);
            let part = |p: [u32; 3]| [0, 1, 2].map(|a| p[a] % (cells[a] * PARTS));
            places.iter().for_each(|p| marks.mark(part(*p)));
            prop_assert!(places.iter().all(|p| marks.has(part(*p))));
            let mut bytes = marks.encode();
            let decode = |mut bytes: &[u8]| PartMask::decode(&mut bytes, cells);
            prop_assert_eq!(decode(&bytes), Ok(marks));
            prop_assert!(decode(&bytes[..bytes.len() - 1]).is_err());
            bytes.push(7);
            let mut rest = bytes.as_slice();
            prop_assert!(PartMask::decode(&mut rest, cells).is_ok());
            prop_assert_eq!(rest, &[7]);
            let at = at.index(bytes.len());
            bytes[at] = with;
            let _ = decode(&bytes);
        }
    }

    #[test]
    fn part_belongs_to_its_cell() {
        let mut marks = PartMask::empty([2, 2, 1]);
        marks.mark([5, 3, 1]);
        assert_eq!(
            (0..4).map(|c| marks.parts(c)).collect::<Vec<_>>(),
            [0, 1 << (16 + 12 + 1), 0, 0]
        );
        let empty = PartMask::empty([2, 2, 1]).encode();
        assert!(PartMask::decode(&mut empty.as_slice(), [2, 2, 1]).is_err());
    }
}
