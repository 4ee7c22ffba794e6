//! Which triangle is seen from which cell: one row of bits a triangle, twice over.
//!
//! Decisions read the state of the last barrier; finds go to the other copy. So what is found does not depend
//! on the order in which threads find it: or-ing commutes, and nobody reads what is written until all have
//! written.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

use super::grid::Slot;

/// Rows that share a mark saying that something in them is new.
const GROUP: usize = 16;

/// Bits by triangle and cell.
pub struct SeenBits {
    words: usize,
    before: Vec<u64>,
    now: Vec<AtomicU64>,
    touched: Vec<AtomicU8>,
}

impl SeenBits {
    /// Nothing seen yet: `rows` triangles, `words` words of cells each.
    pub fn new(rows: usize, words: usize) -> Self {
        // Written, by all threads, and not left to the kernel to make zero when first read: pages that are
        // read before they are written are mapped twice, and the second time every core has to be
        // interrupted.
        let all = || (0..rows * words).into_par_iter().with_min_len(1 << 16);
        let before = all().map(|_| 0).collect();
        let now = all().map(|_| AtomicU64::new(0)).collect();
        let mut touched = Vec::new();
        touched.resize_with(rows.div_ceil(GROUP), || AtomicU8::new(0));
        Self { words, before, now, touched }
    }

    /// Words of a row.
    pub fn words(&self) -> usize {
        self.words
    }

    /// A triangle's cells as of the last barrier.
    pub fn row(&self, triangle: u32) -> &[u64] {
        &self.before[triangle as usize * self.words..][..self.words]
    }

    /// Whether a triangle was seen from a cell at the last barrier.
    pub fn seen(&self, triangle: u32, slot: Slot) -> bool {
        self.before[triangle as usize * self.words + slot.word as usize] >> slot.bit & 1 == 1
    }

    /// Credits cells with a triangle; read after the next barrier.
    pub fn credit(&self, triangle: u32, crossed: &[(u32, u64)]) {
        let row = triangle as usize * self.words;
        for (word, bits) in crossed {
            let at = row + *word as usize;
            if bits & !self.before[at] != 0 && bits & !self.now[at].load(Relaxed) != 0 {
                self.now[at].fetch_or(*bits, Relaxed);
                self.touched[triangle as usize / GROUP].store(1, Relaxed);
            }
        }
    }

    /// A barrier: what was credited is from now on seen.
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

    /// Makes the triangles of each class share what any of them is credited with. Settles first.
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

    /// The triangles seen from each cell of a word, ascending.
    pub fn columns(&self, word: u32) -> Vec<Vec<u32>> {
        let mut columns = vec![Vec::new(); 64];
        for (triangle, bits) in self.before.iter().skip(word as usize).step_by(self.words).enumerate() {
            let mut rest = *bits;
            while rest != 0 {
                columns[rest.trailing_zeros() as usize].push(triangle as u32);
                rest &= rest - 1;
            }
        }
        columns
    }
}
