//! The end of a phase: the host reads counts and new words, and the table with all credits becomes that of
//! the last barrier.

use super::GpuRounds;
use super::kernels::Kernel;
use super::memory::{COUNTER_BYTES, Lent, Part};
use crate::error::BackendError;
use crate::lines::device::Found;
use crate::lines::device::Tally;

/// Places in the counters, as in `block.wgsl`.
const WORDS: usize = 2;
const SEED_RAYS: usize = 4;
const PAIR_WORDS: usize = 5;
const TALLY: usize = 8;
/// Unit of gains, as in `candidates.wgsl`.
const GAIN_UNIT: f64 = 1.0 / (1u64 << 18) as f64;

/// A table whose new words go to the host.
struct Table<'a> {
    /// The kernel that lists them.
    kernel: Kernel,
    /// Where it counts them.
    counter: usize,
    list: &'a wgpu::Buffer,
    /// 64-bit words of the table.
    places: u32,
}

impl GpuRounds<'_> {
    /// The new words of a table, of which there are `new`.
    fn new_words(
        &self,
        lent: &Lent,
        table: &Table<'_>,
        new: u32,
    ) -> Result<Vec<(u32, u64)>, BackendError> {
        let mut words = Vec::with_capacity(new as usize);
        let mut keep = |count: u32| -> Result<(), BackendError> {
            let numbers = self.read(
                self.encoder(),
                lent,
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
        // More than the list holds: by ranges of places that cannot be more.
        for first in (0..table.places).step_by(fit as usize) {
            let count = fit.min(table.places - first);
            let offset = self.part(
                lent,
                &Part {
                    count,
                    first,
                    ..Part::default()
                },
            );
            let mut encoder = self.encoder();
            encoder.clear_buffer(&lent.counters, 4 * table.counter as u64, Some(4));
            self.run(&mut encoder, lent, offset, &[table.kernel]);
            let counter = (&lent.counters, 4 * table.counter as u64, 4);
            if let Some(new) = self
                .read(encoder, lent, &[counter])?
                .first()
                .filter(|new| **new > 0)
            {
                keep(*new)?;
            }
        }
        Ok(words)
    }

    /// The tables whose new words go to the host: that of triangles, and that of pairs where there is one.
    fn tables<'b>(&self, lent: &'b Lent) -> [Table<'b>; 2] {
        let (kernel, counter, list) = (Kernel::GatherWords, WORDS, &lent.words);
        let seen = Table {
            kernel,
            counter,
            list,
            places: self.tables.places,
        };
        let (kernel, counter, list) = (Kernel::GatherPairs, PAIR_WORDS, &lent.pair_words);
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

    /// Makes the tables with all credits those of the last barrier.
    pub(super) fn publish(&self) -> Result<(), BackendError> {
        let mut encoder = self.encoder();
        let t = &self.tables;
        encoder.copy_buffer_to_buffer(&t.now, 0, &t.seen, 0, t.seen.size());
        encoder.copy_buffer_to_buffer(&t.joined, 0, &t.pairs, 0, t.pairs.size());
        self.submit(encoder).map(drop)
    }

    /// Ends a phase: reads counts and new words, and publishes the table.
    pub(super) fn end(
        &self,
        lent: &Lent,
        mut encoder: wgpu::CommandEncoder,
        items: usize,
    ) -> Result<Found, BackendError> {
        let tables = self.tables(lent);
        for table in tables.iter().filter(|t| t.places > 0) {
            let offset = self.part(
                lent,
                &Part {
                    count: table.places,
                    ..Part::default()
                },
            );
            self.run(&mut encoder, lent, offset, &[table.kernel]);
        }
        let wanted = [
            (&lent.counters, 0, COUNTER_BYTES),
            (&lent.stats, 0, 16 * items as u64),
        ];
        let numbers = self.read(encoder, lent, &wanted)?;
        if let Some(profile) = &self.profile {
            let mut encoder = self.encoder();
            let bytes = profile.resolve(&mut encoder);
            profile.add(&self.read(encoder, lent, &[(&profile.stamps, 0, bytes)])?);
        }
        let (counters, counts) = numbers.split_at(COUNTER_BYTES as usize / 4);
        let counts = counts
            .chunks_exact(4)
            .map(|c| [c[0], c[1], c[2], c[3]])
            .collect();
        let [words, pair_words] =
            tables.map(|table| self.new_words(lent, &table, counters[table.counter]));
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
        Ok(Found {
            counts,
            rays,
            tally,
            words,
            pair_words,
        })
    }
}

/// The finds of two phases that are one for the caller.
pub(super) fn joined(mut one: Found, two: Found) -> Found {
    one.counts.extend(two.counts);
    one.words.extend(two.words);
    one.pair_words.extend(two.pair_words);
    one.rays += two.rays;
    one.tally = one.tally.and(&two.tally);
    one
}
