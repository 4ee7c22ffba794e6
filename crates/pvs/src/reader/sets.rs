//! Decoder of a cell's sets: as ids, runs, a bit set, objects, or the items that the result names.
//!
//! A cell's set is the exclusive or of the sets on its path from the leaf to the root, up to the first set in
//! absolute form. The decoder works on the boundaries of runs: each set flips the bits at which its runs
//! start and end, and the prefix parity of these bits gives the members. The header's number of items must
//! not decide how much memory is allocated. If one bit per item would need many times more bytes than the
//! coded sets, the decoder sorts the boundaries instead.

use std::ops::Range;

use super::Pvs;
use crate::codec;
use crate::error::PvsError;
use crate::items::ItemTable;
use crate::layout::{Section, u64_at};
use crate::runs;

/// The maximum size of a bit set that is allocated regardless of the size of the coded sets, in bytes.
const MOST_FREE_BYTES: usize = 4 << 20;
/// The maximum number of bytes of boundaries per byte of a coded set. A run has a code of at least one bit
/// for its gap and one for its length.
const MOST_GROWTH: usize = 32;

/// The sizes of the coded sets on the path from a cell's leaf to the root, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeBytes {
    /// The size of the leaf's own set.
    pub own: u64,
    /// The size of all sets that are read to decode the cell, including the leaf's set.
    pub path: u64,
}

impl Pvs {
    /// Stores the triangles to draw from a cell in `ids`, as ascending ids.
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if the cell does not exist. [`PvsError::Memory`] if memory is insufficient.
    /// [`PvsError::Malformed`] if the set is malformed although the checksums match.
    pub fn visible(&self, cell: u32, ids: &mut Vec<u32>) -> Result<(), PvsError> {
        self.ids(Section::Visible, cell, ids)
    }

    /// Stores the items to draw from a cell in `items`, as ascending numbers. The items are triangles,
    /// clusters or objects, depending on [`Self::granularity`].
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn visible_items(&self, cell: u32, items: &mut Vec<u32>) -> Result<(), PvsError> {
        self.item_ids(Section::Visible, cell, items)
    }

    /// Stores the items of the visible set that were neither seen nor proved hidden in `items`, as ascending
    /// numbers.
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn undecided_items(&self, cell: u32, items: &mut Vec<u32>) -> Result<(), PvsError> {
        self.item_ids(Section::Undecided, cell, items)
    }

    /// Stores the triangles of an item in `ids`, as ascending ids. Skips triangles that are never visible. An
    /// item that does not exist has no triangles.
    pub fn item_triangles(&self, item: u32, ids: &mut Vec<u32>) {
        ids.clear();
        ids.extend(
            self.item_bounds(item)
                .chunks_exact(2)
                .flat_map(|run| run[0]..run[1]),
        );
    }

    /// Returns the triangles of an item like [`Self::item_triangles`], as the boundaries of maximal runs
    /// ([`crate::runs`]).
    pub fn item_bounds(&self, item: u32) -> Vec<u32> {
        if item < self.item_count() {
            self.items.triangles(&[item, item + 1], &self.objects)
        } else {
            Vec::new()
        }
    }

    /// Stores the triangles of the visible set that were neither seen nor proved hidden in `ids`, as
    /// ascending ids.
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn undecided(&self, cell: u32, ids: &mut Vec<u32>) -> Result<(), PvsError> {
        self.ids(Section::Undecided, cell, ids)
    }

    /// Stores the triangles to draw from a cell in `runs`, as maximal runs of consecutive ids, ascending.
    /// Each run is the range of a draw call.
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn visible_runs(&self, cell: u32, runs: &mut Vec<Range<u32>>) -> Result<(), PvsError> {
        runs.clear();
        self.each_run(Section::Visible, cell, |run| runs.push(run))
    }

    /// Stores the triangles to draw from a cell in `bits`: bit `id % 64` of word `id / 64`. `bits` must have
    /// ⌈N / 64⌉ words for N triangles, and the function writes all of them. This is the fastest form.
    ///
    /// # Errors
    /// The errors of [`Self::visible`], and [`PvsError::BitsLength`] if `bits` has the wrong length.
    pub fn visible_bits(&self, cell: u32, bits: &mut [u64]) -> Result<(), PvsError> {
        let needed = self.words();
        if bits.len() != needed {
            return Err(PvsError::BitsLength {
                given: bits.len(),
                needed,
            });
        }
        bits.fill(0);
        match self.items {
            ItemTable::Triangles => self.boundaries(Section::Visible, cell, bits)?,
            // A run flips the bit at its start and the bit at its end, as in the coded sets.
            _ => self.each_run(Section::Visible, cell, |run| {
                for at in [run.start, run.end] {
                    if let Some(word) = bits.get_mut((at >> 6) as usize) {
                        *word ^= 1 << (at & 63);
                    }
                }
            })?,
        }
        let mut inside = 0;
        for word in bits {
            *word = members(*word, &mut inside);
        }
        Ok(())
    }

    /// Stores the objects with at least one visible triangle in `objects`, as ascending indices.
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn visible_objects(&self, cell: u32, objects: &mut Vec<u32>) -> Result<(), PvsError> {
        self.objects_of(Section::Visible, cell, objects)
    }

    /// Stores the objects with at least one undecided triangle and no triangle known to be visible in
    /// `objects`, as ascending indices. These objects are a subset of [`Self::visible_objects`].
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn undecided_objects(&self, cell: u32, objects: &mut Vec<u32>) -> Result<(), PvsError> {
        self.objects_of(Section::Undecided, cell, objects)?;
        if objects.is_empty() || matches!(self.items, ItemTable::Objects { .. }) {
            return Ok(());
        }
        let [visible, undecided] = [self.visible_bounds(cell)?, self.undecided_bounds(cell)?];
        let [known] = runs::sweep([&visible, &undecided], |m| u32::from(m == 1));
        let mut seen = Vec::new();
        let mut next = 0;
        known
            .chunks_exact(2)
            .for_each(|run| self.touched(run[0]..run[1], &mut next, &mut seen));
        objects.retain(|object| seen.binary_search(object).is_err());
        Ok(())
    }

    /// Returns the triangles to draw from a cell as the boundaries of maximal runs. The form is start, end,
    /// start, end, …, with exclusive ends ([`crate::runs`]).
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn visible_bounds(&self, cell: u32) -> Result<Vec<u32>, PvsError> {
        self.bounds(Section::Visible, cell)
    }

    /// Returns the undecided triangles of a cell in the form of [`Self::visible_bounds`].
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn undecided_bounds(&self, cell: u32) -> Result<Vec<u32>, PvsError> {
        self.bounds(Section::Undecided, cell)
    }

    /// Returns the number of triangles to draw from a cell. The function does not store their ids.
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn visible_count(&self, cell: u32) -> Result<u32, PvsError> {
        self.count(Section::Visible, cell)
    }

    /// Returns the number of undecided triangles of a cell.
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub fn undecided_count(&self, cell: u32) -> Result<u32, PvsError> {
        self.count(Section::Undecided, cell)
    }

    /// Returns the number of items to draw from a cell.
    ///
    /// # Errors
    /// The errors of [`Self::visible`].
    pub(super) fn visible_item_count(&self, cell: u32) -> Result<usize, PvsError> {
        let mut count = 0;
        self.each_item_run(Section::Visible, cell, |run| count += run.len())?;
        Ok(count)
    }

    /// Returns the size of a cell's visible set in the file, in bytes.
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if the cell does not exist. [`PvsError::Malformed`] if the file was changed after
    /// opening.
    pub fn visible_bytes(&self, cell: u32) -> Result<NodeBytes, PvsError> {
        let leaf = self.leaf(cell)?;
        let own = self.set(Section::Visible, leaf)?.len() as u64;
        Ok(NodeBytes {
            own,
            path: self.path_bytes(Section::Visible, leaf)? as u64,
        })
    }

    /// Returns the size of the sets that are read to decode the set of a leaf, in bytes.
    fn path_bytes(&self, section: Section, leaf: u32) -> Result<usize, PvsError> {
        let mut bytes = 0;
        for node in self.tree.path(leaf) {
            let set = self.set(section, node)?;
            bytes += set.len();
            if codec::is_absolute(set) {
                break;
            }
        }
        Ok(bytes)
    }

    /// Returns the sizes in bytes of the file, of its visible sets and of its undecided sets (sets with
    /// offsets).
    pub fn file_bytes(&self) -> [u64; 3] {
        let part = |s| self.part(s).len() as u64;
        [
            self.bytes.get().len() as u64,
            part(Section::Visible),
            part(Section::Undecided),
        ]
    }

    /// Returns the bytes of the visible sets as stored in the file, for comparisons of set codes.
    pub fn visible_section(&self) -> &[u8] {
        self.part(Section::Visible)
    }

    /// Returns the number of words of a bit set over all triangles.
    fn words(&self) -> usize {
        (self.layout.triangles as usize).div_ceil(64)
    }

    /// Returns the number of words of a bit set over all items.
    fn item_words(&self) -> usize {
        (self.item_count() as usize).div_ceil(64)
    }

    fn ids(&self, section: Section, cell: u32, ids: &mut Vec<u32>) -> Result<(), PvsError> {
        if let ItemTable::Triangles = self.items {
            return self.item_ids(section, cell, ids);
        }
        ids.clear();
        let mut fits = true;
        self.each_run(section, cell, |run| {
            fits = fits && ids.try_reserve(run.len()).is_ok();
            if fits {
                ids.extend(run);
            }
        })?;
        if fits { Ok(()) } else { Err(self.no_memory()) }
    }

    fn item_ids(&self, section: Section, cell: u32, ids: &mut Vec<u32>) -> Result<(), PvsError> {
        ids.clear();
        let words = match self.marks(section, cell)? {
            Marks::Words(words) => words,
            Marks::Bounds(bounds) => {
                for run in bounds.chunks_exact(2) {
                    let run = run[0]..run[1];
                    if ids.try_reserve(run.len()).is_err() {
                        return Err(self.no_memory());
                    }
                    ids.extend(run);
                }
                return Ok(());
            }
        };
        let mut inside = 0;
        let mut part = [0u32; 64];
        for (i, &word) in words.iter().enumerate() {
            if word == 0 && inside == 0 {
                continue;
            }
            let mut rest = members(word, &mut inside);
            let mut count = 0;
            while rest != 0 {
                part[count] = i as u32 * 64 + rest.trailing_zeros();
                count += 1;
                rest &= rest - 1;
            }
            if ids.try_reserve(count).is_err() {
                return Err(self.no_memory());
            }
            ids.extend_from_slice(&part[..count]);
        }
        Ok(())
    }

    fn no_memory(&self) -> PvsError {
        PvsError::Memory {
            triangles: self.layout.triangles,
        }
    }

    fn objects_of(
        &self,
        section: Section,
        cell: u32,
        objects: &mut Vec<u32>,
    ) -> Result<(), PvsError> {
        if let ItemTable::Objects { .. } = self.items {
            return self.item_ids(section, cell, objects);
        }
        objects.clear();
        let mut next = 0;
        self.each_run(section, cell, |run| self.touched(run, &mut next, objects))
    }

    /// Appends the objects that a run touches. The runs of a set must come in ascending order, and `next`
    /// must be the first object that no earlier run has touched.
    fn touched(&self, run: Range<u32>, next: &mut usize, objects: &mut Vec<u32>) {
        // Objects tile the triangles in order: skip the objects that end before the run.
        *next += self.objects[*next..].partition_point(|o| o.first + o.count <= run.start);
        while let Some(o) = self.objects.get(*next).filter(|o| o.first < run.end) {
            if o.count > 0 {
                objects.push(*next as u32);
            }
            *next += 1;
        }
    }

    /// Returns the boundaries of the runs of the triangles of a cell's set.
    fn bounds(&self, section: Section, cell: u32) -> Result<Vec<u32>, PvsError> {
        let mut bounds = Vec::new();
        self.each_run(section, cell, |run| bounds.extend([run.start, run.end]))?;
        Ok(bounds)
    }

    /// Returns the number of triangles of a cell's set.
    fn count(&self, section: Section, cell: u32) -> Result<u32, PvsError> {
        let mut count = 0;
        self.each_run(section, cell, |run| count += run.end - run.start)?;
        Ok(count)
    }

    /// Returns the coded set of a node.
    fn set(&self, section: Section, node: u32) -> Result<&[u8], PvsError> {
        let bytes = self.part(section);
        let table = (self.layout.nodes as usize + 1) * 8;
        let at = |i: usize| usize::try_from(u64_at(bytes, i * 8)).ok();
        // Opening has checked the offsets. Check them again: this is cheap, and a file that was changed since
        // then must not cause a panic.
        match (at(node as usize), at(node as usize + 1)) {
            (Some(start), Some(end)) => bytes[table..].get(start..end),
            _ => None,
        }
        .ok_or_else(|| section.malformed("the offset of a node's set is out of range"))
    }

    /// Marks the starts and ends of the runs of a cell's set in zeroed words. The exclusive or of sets is the
    /// exclusive or of their boundaries, so each set on the root path flips its own boundaries. An end after
    /// the last bit of the last word is omitted, because no bit beyond the last triangle is ever a member.
    fn boundaries(&self, section: Section, cell: u32, words: &mut [u64]) -> Result<(), PvsError> {
        self.each_coded_run(section, cell, |start, end| {
            let (first, last) = ((start >> 6) as usize, (end >> 6) as usize);
            let (mark_start, mark_end) = (1u64 << (start & 63), 1u64 << (end & 63));
            if first == last {
                // Most runs are short. One access is faster than two dependent accesses to the same word.
                if let Some(word) = words.get_mut(first) {
                    *word ^= mark_start ^ mark_end;
                }
            } else {
                if let Some(word) = words.get_mut(first) {
                    *word ^= mark_start;
                }
                if let Some(word) = words.get_mut(last) {
                    *word ^= mark_end;
                }
            }
        })
    }

    /// Calls `each` with the start and the end of every run of the coded sets on a cell's path.
    fn each_coded_run(
        &self,
        section: Section,
        cell: u32,
        mut each: impl FnMut(u32, u32),
    ) -> Result<(), PvsError> {
        let leaf = self.leaf(cell)?;
        if self.part(section).is_empty() {
            return Ok(());
        }
        for node in self.tree.path(leaf) {
            let set = self.set(section, node)?;
            codec::decode(set, self.item_count(), &mut each)
                .map_err(|e| section.malformed(format!("the set of node {node}: {}", e.0)))?;
            if codec::is_absolute(set) {
                break;
            }
        }
        Ok(())
    }

    /// Decodes the set of a cell. The memory is proportional to the coded bytes, or at most
    /// [`MOST_FREE_BYTES`].
    fn marks(&self, section: Section, cell: u32) -> Result<Marks, PvsError> {
        let leaf = self.leaf(cell)?;
        let bytes = if self.part(section).is_empty() {
            0
        } else {
            self.path_bytes(section, leaf)?
        };
        if self.item_words() * 8 > MOST_FREE_BYTES.max(MOST_GROWTH * bytes) {
            return self.sorted(section, cell).map(Marks::Bounds);
        }
        let mut words = Vec::new();
        words
            .try_reserve_exact(self.item_words())
            .map_err(|_| self.no_memory())?;
        words.resize(self.item_words(), 0u64);
        self.boundaries(section, cell, &mut words)?;
        Ok(Marks::Words(words))
    }

    /// Returns the boundaries of the items of a cell's set. A boundary of an even number of sets on the path
    /// is not a boundary of the exclusive or.
    fn sorted(&self, section: Section, cell: u32) -> Result<Vec<u32>, PvsError> {
        let mut all: Vec<u32> = Vec::new();
        let mut fits = true;
        self.each_coded_run(section, cell, |start, end| {
            fits = fits && all.try_reserve(2).is_ok();
            if fits {
                all.extend([start, end]);
            }
        })?;
        if !fits {
            return Err(self.no_memory());
        }
        all.sort_unstable();
        let mut kept = 0;
        for k in 0..all.len() {
            if kept > 0 && all[kept - 1] == all[k] {
                kept -= 1;
            } else {
                all[kept] = all[k];
                kept += 1;
            }
        }
        all.truncate(kept);
        Ok(all)
    }

    /// Calls `each` with the maximal runs of the triangles of a cell's set, ascending.
    fn each_run(
        &self,
        section: Section,
        cell: u32,
        mut each: impl FnMut(Range<u32>),
    ) -> Result<(), PvsError> {
        if let ItemTable::Triangles = self.items {
            return self.each_item_run(section, cell, each);
        }
        let mut items = Vec::new();
        self.each_item_run(section, cell, |run| items.extend([run.start, run.end]))?;
        let bounds = self.items.triangles(&items, &self.objects);
        bounds.chunks_exact(2).for_each(|run| each(run[0]..run[1]));
        Ok(())
    }

    /// Calls `each` with the maximal runs of the items of a cell's set, ascending.
    fn each_item_run(
        &self,
        section: Section,
        cell: u32,
        mut each: impl FnMut(Range<u32>),
    ) -> Result<(), PvsError> {
        let words = match self.marks(section, cell)? {
            Marks::Words(words) => words,
            Marks::Bounds(bounds) => {
                bounds.chunks_exact(2).for_each(|run| each(run[0]..run[1]));
                return Ok(());
            }
        };
        let mut start = None;
        for (i, &word) in words.iter().enumerate() {
            let mut rest = word;
            while rest != 0 {
                let at = i as u32 * 64 + rest.trailing_zeros();
                rest &= rest - 1;
                start = match start {
                    None => Some(at),
                    Some(from) => {
                        each(from..at);
                        None
                    }
                };
            }
        }
        if let Some(from) = start {
            each(from..self.item_count());
        }
        Ok(())
    }
}

/// The decoded boundaries of a cell's set.
enum Marks {
    /// One bit per item, set if a run starts or ends at the item.
    Words(Vec<u64>),
    /// The ascending boundaries.
    Bounds(Vec<u32>),
}

/// Returns the members of a word of marked boundaries: each bit becomes the parity of the marks at or before
/// this bit. `inside` must be all ones if the word before ended within a run, and 0 otherwise. The function
/// updates `inside` for the next word.
fn members(marks: u64, inside: &mut u64) -> u64 {
    let mut x = marks;
    if x != 0 {
        for shift in [1, 2, 4, 8, 16, 32] {
            x ^= x << shift;
        }
    }
    x ^= *inside;
    *inside = (x >> 63).wrapping_neg();
    x
}
