//! The table of triangles and cells: two copies of a row per triangle with a bit per cell.
//!
//! Decisions read the copy published at the last barrier, and new credits are written to the other copy. The
//! result therefore does not depend on the order of the threads: the bitwise or commutes, and no thread reads
//! the written copy before all threads have finished the phase.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

use super::grid::Slot;

/// The number of rows that share one mark of change.
const GROUP: usize = 16;

/// The number of parts of the table of which all cores make columns.
const COLUMN_PARTS: usize = 16;

/// A bit for each triangle and cell.
pub struct SeenBits {
    words: usize,
    before: Vec<u64>,
    now: Vec<AtomicU64>,
    touched: Vec<AtomicU8>,
}

impl SeenBits {
    /// Creates an empty table of `rows` triangles with `words` words of 64 cells each.
    pub fn new(rows: usize, words: usize) -> Self {
        // All threads write the zeros. A page that is read before it is written is mapped twice, and the
        // second mapping interrupts every core.
        let all = || (0..rows * words).into_par_iter().with_min_len(1 << 16);
        let before = all().map(|_| 0).collect();
        let now = all().map(|_| AtomicU64::new(0)).collect();
        let mut touched = Vec::new();
        touched.resize_with(rows.div_ceil(GROUP), || AtomicU8::new(0));
        Self {
            words,
            before,
            now,
            touched,
        }
    }

    /// Returns the number of words of a row.
    pub fn words(&self) -> usize {
        self.words
    }

    /// Returns the cells of a row as of the last barrier.
    pub fn row(&self, row: u32) -> &[u64] {
        &self.before[row as usize * self.words..][..self.words]
    }

    /// Returns true if a row was credited to a cell at the last barrier.
    pub fn seen(&self, row: u32, slot: Slot) -> bool {
        self.before[row as usize * self.words + slot.word as usize] >> slot.bit & 1 == 1
    }

    /// Credits cells with a row. The credit is visible to readers after the next barrier.
    pub fn credit(&self, row: u32, crossed: &[(u32, u64)]) {
        let start = row as usize * self.words;
        for (word, bits) in crossed {
            let at = start + *word as usize;
            if bits & !self.before[at] != 0 && bits & !self.now[at].load(Relaxed) != 0 {
                self.now[at].fetch_or(*bits, Relaxed);
                self.touched[row as usize / GROUP].store(1, Relaxed);
            }
        }
    }

    /// Returns the whole table as of the last barrier.
    pub fn table(&self) -> &[u64] {
        &self.before
    }

    /// Returns the number of words of the table.
    pub fn places(&self) -> usize {
        self.before.len()
    }

    /// Calls `each` with the index and the new bits of every word that has credits since the last barrier, by
    /// ascending index.
    pub fn each_new(&self, mut each: impl FnMut(usize, u64)) {
        self.each_touched(|at| {
            let new = self.now[at].load(Relaxed) & !self.before[at];
            if new != 0 {
                each(at, new);
            }
        });
    }

    /// Removes all credits since the last barrier. No thread may credit during the call.
    pub fn forget(&self) {
        self.each_touched(|at| self.now[at].store(self.before[at], Relaxed));
        self.touched.iter().for_each(|t| t.store(0, Relaxed));
    }

    /// Credits the cells of the bits of a word, by its index.
    pub fn add(&self, at: usize, bits: u64) {
        self.now[at].fetch_or(bits, Relaxed);
        self.touched[at / self.words / GROUP].store(1, Relaxed);
    }

    /// Calls `each` with the index of every word of a row group that has credits since the last barrier.
    fn each_touched(&self, mut each: impl FnMut(usize)) {
        let group = GROUP * self.words;
        for (number, _) in self
            .touched
            .iter()
            .enumerate()
            .filter(|(_, t)| t.load(Relaxed) != 0)
        {
            (number * group..((number + 1) * group).min(self.now.len())).for_each(&mut each);
        }
    }

    /// Publishes all credits since the last barrier.
    pub fn publish(&mut self) {
        let words = self.words;
        self.before
            .par_chunks_mut(GROUP * words)
            .zip(self.now.par_chunks(GROUP * words))
            .zip(&self.touched)
            .with_min_len(256)
            .for_each(|((before, now), touched)| {
                if touched.load(Relaxed) != 0 {
                    touched.store(0, Relaxed);
                    for (b, n) in before.iter_mut().zip(now) {
                        *b |= n.load(Relaxed);
                    }
                }
            });
    }

    /// Publishes all credits, and sets the rows of all triangles of each class to their union.
    pub fn share(&mut self, classes: &[Vec<u32>]) {
        self.publish();
        for class in classes {
            for word in 0..self.words {
                let at = |t: &u32| *t as usize * self.words + word;
                let any = class.iter().fold(0, |bits, t| bits | self.before[at(t)]);
                class.iter().for_each(|t| self.before[at(t)] = any);
            }
        }
    }

    /// Publishes all credits, adds each row after the first `items` to the rows that `shared` lists for it,
    /// and removes these rows.
    pub fn share_rows(&mut self, items: u32, shared: &[Vec<u32>]) {
        self.publish();
        for (row, with) in (items as usize..).zip(shared) {
            for word in 0..self.words {
                let bits = self.before[row * self.words + word];
                with.iter()
                    .for_each(|item| self.before[*item as usize * self.words + word] |= bits);
            }
        }
        self.before.truncate(items as usize * self.words);
    }

    /// Adds to the row of each item the rows of its triangles, as of the last barrier.
    pub fn gather(&self, members: &[Vec<u32>], items: &mut [u64]) {
        let rows = items
            .par_chunks_mut(self.words)
            .zip(members)
            .with_min_len(64);
        rows.for_each(|(item, triangles)| {
            for triangle in triangles {
                item.iter_mut()
                    .zip(self.row(*triangle))
                    .for_each(|(all, bits)| *all |= bits);
            }
        });
    }

    /// Replaces the rows of triangles by a row for each item.
    pub fn to_items(&mut self, members: &[Vec<u32>]) {
        let mut items = vec![0; members.len() * self.words];
        self.gather(members, &mut items);
        self.before = items;
    }

    /// Returns the triangles seen from each cell, in ascending order, indexed by [`Slot::index`].
    pub fn columns(&self) -> Vec<Vec<u32>> {
        let rows = self.before.len() / self.words;
        let part = rows.div_ceil(COLUMN_PARTS).max(GROUP);
        let parts: Vec<Vec<Vec<u32>>> = self
            .before
            .par_chunks(part * self.words)
            .zip(0..COLUMN_PARTS)
            .map(|(rows, at)| self.columns_of(rows, at * part))
            .collect();
        (0..self.words * 64)
            .into_par_iter()
            .map(|cell| {
                let parts = parts.iter().map(|part| &part[cell]);
                let mut column = Vec::with_capacity(parts.clone().map(Vec::len).sum());
                parts.for_each(|part| column.extend_from_slice(part));
                column
            })
            .collect()
    }

    /// Returns the triangles of some rows, the first of which is `first`, that are seen from each cell.
    fn columns_of(&self, rows: &[u64], first: usize) -> Vec<Vec<u32>> {
        let mut columns = vec![Vec::new(); self.words * 64];
        for (triangle, row) in (first as u32..).zip(rows.chunks_exact(self.words)) {
            for (word, bits) in row.iter().enumerate() {
                let mut rest = *bits;
                while rest != 0 {
                    columns[word * 64 + rest.trailing_zeros() as usize].push(triangle);
                    rest &= rest - 1;
                }
            }
        }
        columns
    }
}
