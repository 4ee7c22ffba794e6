//! The end of a phase: the host reads counts and new words.
//!
//! The table with all credits then becomes the table of the last barrier.

use super::GpuRounds;
use super::kernels::Kernel;
use super::memory::{BlockLists, COUNTER_BYTES, Part};
use crate::error::TracerError;
use crate::lines::device::DevicePhaseResult;
use crate::lines::device::Tally;

/// The indices in the counters, as in `block.wgsl`.
const WORDS: usize = 2;
const SEED_RAYS: usize = 4;
const PAIR_WORDS: usize = 5;
const TALLY: usize = 8;
/// The unit of gains, as in `candidates.wgsl`.
const GAIN_UNIT: f64 = 1.0 / (1u64 << 18) as f64;

/// A table whose new words the host reads.
struct Table<'a> {
    /// The kernel that lists the new words.
    kernel: Kernel,
    /// The index of the counter of the new words.
    counter: usize,
    list: &'a wgpu::Buffer,
    /// The number of 64-bit words of the table.
    places: u32,
}

impl GpuRounds<'_> {
    /// Reads the new words of a table. `new` is their number.
    fn new_words(
        &self,
        block_lists: &BlockLists,
        table: &Table<'_>,
        new: u32,
    ) -> Result<Vec<(u32, u64)>, TracerError> {
        let mut words = Vec::with_capacity(new as usize);
        let mut keep = |count: u32| -> Result<(), TracerError> {
            let numbers = self.read(
                self.encoder(),
                block_lists,
                &[(table.list, 0, 12 * u64::from(count))],
            )?;
            let some = numbers.chunks_exact(3);
            words.extend(some.map(|w| (w[0], u64::from(w[1]) | u64::from(w[2]) << 32)));
            Ok(())
        };
        let fit = 3 * self.capacity;
        if new <= fit {
            if new > 0 {
                keep(new)?;
            }
            return Ok(words);
        }
        // If the list is too short, the words are read by ranges of places that cannot exceed the list.
        for first in (0..table.places).step_by(fit as usize) {
            let count = fit.min(table.places - first);
            let offset = self.part(
                block_lists,
                &Part {
                    count,
                    first,
                    ..Part::default()
                },
            );
            let mut encoder = self.encoder();
            encoder.clear_buffer(&block_lists.counters, 4 * table.counter as u64, Some(4));
            self.run(&mut encoder, block_lists, offset, &[table.kernel]);
            let counter = (&block_lists.counters, 4 * table.counter as u64, 4);
            if let Some(new) = self
                .read(encoder, block_lists, &[counter])?
                .first()
                .filter(|new| **new > 0)
            {
                keep(*new)?;
            }
        }
        Ok(words)
    }

    /// Returns the tables whose new words the host reads: the table of triangles and the table of pairs,
    /// which may be empty.
    fn tables<'b>(&self, block_lists: &'b BlockLists) -> [Table<'b>; 2] {
        let (kernel, counter, list) = (Kernel::GatherWords, WORDS, &block_lists.words);
        let seen = Table {
            kernel,
            counter,
            list,
            places: self.tables.places,
        };
        let (kernel, counter, list) = (Kernel::GatherPairs, PAIR_WORDS, &block_lists.pair_words);
        [
            seen,
            Table {
                kernel,
                counter,
                list,
                places: self.tables.pair_places,
            },
        ]
    }

    /// Makes the tables with all credits the tables of the last barrier.
    pub(super) fn publish(&self) -> Result<(), TracerError> {
        let mut encoder = self.encoder();
        let t = &self.tables;
        encoder.copy_buffer_to_buffer(&t.now, 0, &t.seen, 0, t.seen.size());
        encoder.copy_buffer_to_buffer(&t.joined, 0, &t.pairs, 0, t.pairs.size());
        self.submit(encoder).map(drop)
    }

    /// Ends a phase: reads counts and new words, and publishes the table.
    pub(super) fn end(
        &self,
        block_lists: &BlockLists,
        mut encoder: wgpu::CommandEncoder,
        items: usize,
    ) -> Result<DevicePhaseResult, TracerError> {
        let tables = self.tables(block_lists);
        for table in tables.iter().filter(|t| t.places > 0) {
            let offset = self.part(
                block_lists,
                &Part {
                    count: table.places,
                    ..Part::default()
                },
            );
            self.run(&mut encoder, block_lists, offset, &[table.kernel]);
        }
        let wanted = [
            (&block_lists.counters, 0, COUNTER_BYTES),
            (&block_lists.stats, 0, 16 * items as u64),
        ];
        let numbers = self.read(encoder, block_lists, &wanted)?;
        if let Some(profile) = &self.profile {
            let mut encoder = self.encoder();
            let bytes = profile.resolve(&mut encoder);
            profile.add(&self.read(encoder, block_lists, &[(&profile.stamps, 0, bytes)])?);
        }
        let (counters, counts) = numbers.split_at(COUNTER_BYTES as usize / 4);
        let counts = counts
            .chunks_exact(4)
            .map(|c| [c[0], c[1], c[2], c[3]])
            .collect();
        let [words, pair_words] =
            tables.map(|table| self.new_words(block_lists, &table, counters[table.counter]));
        let (words, pair_words) = (words?, pair_words?);
        self.publish()?;
        let rays = u64::from(counters[SEED_RAYS]);
        let tally = Tally::of_device(
            std::array::from_fn(|d| {
                let at = |k: usize| u64::from(counters[TALLY + 5 * d + k]);
                [at(0), at(1) | at(2) << 32, at(3) | at(4) << 32]
            }),
            GAIN_UNIT,
        );
        Ok(DevicePhaseResult {
            counts,
            rays,
            tally,
            words,
            pair_words,
        })
    }
}

/// Joins the results of two phases that are one phase for the caller.
pub(super) fn joined(mut one: DevicePhaseResult, two: DevicePhaseResult) -> DevicePhaseResult {
    one.counts.extend(two.counts);
    one.words.extend(two.words);
    one.pair_words.extend(two.pair_words);
    one.rays += two.rays;
    one.tally = one.tally.and(&two.tally);
    one
}
