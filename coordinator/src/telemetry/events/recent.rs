//! The last events in memory, encoded as bytes.
//!
//! A farm creates hundreds of events per second, and objects with separate texts need several times as much
//! memory.

use std::collections::VecDeque;

use sightline_numbers::varint;
use sightline_records::ids::{JobId, TileIndex};

use super::{Entry, EventKind, LogEvent};

/// Maximum size of the stored events in bytes, without the growing block.
const MOST_BYTES: usize = 8 << 20;
/// The size in bytes at which a block ends. Blocks are dropped as a whole.
const BLOCK_BYTES: usize = 64 << 10;
/// Maximum length of a variable-length integer, in bytes.
const LONGEST: u32 = 10;

/// The last events, ascending and without gaps.
#[derive(Default)]
pub(super) struct Recent {
    blocks: VecDeque<Block>,
    /// The size of the complete blocks, in bytes.
    full: usize,
    last: u64,
}

/// A block of consecutive events.
struct Block {
    /// The number of the first event.
    first: u64,
    /// The encoded events. Each starts with its job, because most queries are about one job.
    bytes: Vec<u8>,
    /// The start of each event in `bytes`.
    starts: Vec<u32>,
}

impl Recent {
    /// Returns the number of the last event.
    pub(super) fn last(&self) -> u64 {
        self.last
    }

    /// Appends an event, and drops the oldest events above the maximum size. If the event's number is not the
    /// next one, drops all previous events.
    pub(super) fn push(&mut self, entry: &Entry) {
        if entry.number != self.last + 1 {
            (self.blocks, self.full) = (VecDeque::new(), 0);
        }
        self.last = entry.number;
        match self.blocks.back_mut() {
            Some(block) if block.size() < BLOCK_BYTES => block.push(entry),
            full => {
                if let Some(full) = full {
                    full.bytes.shrink_to_fit();
                    full.starts.shrink_to_fit();
                    self.full += full.size();
                }
                let mut block = Block {
                    first: entry.number,
                    bytes: Vec::new(),
                    starts: Vec::new(),
                };
                block.push(entry);
                self.blocks.push_back(block);
                while self.full > MOST_BYTES {
                    self.full -= self
                        .blocks
                        .pop_front()
                        .map_or(self.full, |block| block.size());
                }
            }
        }
    }

    /// Returns at most `most` events with higher numbers than `after`, ascending, of one job or of all jobs.
    /// The second value is the last inspected number.
    pub(super) fn after(&self, job: Option<JobId>, after: u64, most: usize) -> (Vec<Entry>, u64) {
        let mut found = Vec::new();
        let begin = self
            .blocks
            .partition_point(|block| block.end() <= after.saturating_add(1));
        for block in self.blocks.range(begin..) {
            let skip = after.saturating_add(1).saturating_sub(block.first) as usize;
            for at in skip..block.starts.len() {
                if found.len() == most {
                    return (found, block.first + at as u64 - 1);
                }
                if job.is_none_or(|job| block.job(at) == Some(job)) {
                    found.extend(block.entry(at));
                }
            }
        }
        (found, self.last.max(after))
    }

    /// Returns the number after which a job has its last `most` events.
    pub(super) fn before_last(&self, job: JobId, most: usize) -> u64 {
        let numbers = self.blocks.iter().rev().flat_map(|block| {
            let of_job = (0..block.starts.len())
                .rev()
                .filter(move |at| block.job(*at) == Some(job));
            of_job.map(|at| block.first + at as u64)
        });
        numbers.into_iter().nth(most).unwrap_or(0)
    }
}

impl Block {
    fn size(&self) -> usize {
        self.bytes.len() + self.starts.len() * size_of::<u32>()
    }

    /// Returns the number after the last event of the block.
    fn end(&self) -> u64 {
        self.first + self.starts.len() as u64
    }

    fn push(&mut self, entry: &Entry) {
        let what = &entry.what;
        // Even a block of few long events ends before 4 GiB, because texts and names are short.
        self.starts.push(self.bytes.len() as u32);
        let out = &mut self.bytes;
        option(out, what.job.map(|job| job.0));
        option(out, what.tile.map(|tile| u64::from(tile.0)));
        out.push(what.kind as u8);
        varint::write(out, entry.at_ms);
        varint::write(out, what.worker.len() as u64);
        out.extend(what.worker.as_bytes());
        out.extend(what.text.as_bytes());
    }

    fn bytes(&self, at: usize) -> Option<&[u8]> {
        let start = *self.starts.get(at)? as usize;
        let end = self
            .starts
            .get(at + 1)
            .map_or(self.bytes.len(), |end| *end as usize);
        self.bytes.get(start..end)
    }

    fn job(&self, at: usize) -> Option<JobId> {
        read_option(&mut self.bytes(at)?)?.map(JobId)
    }

    fn entry(&self, at: usize) -> Option<Entry> {
        let from = &mut self.bytes(at)?;
        let job = read_option(from)?.map(JobId);
        let tile = read_option(from)?.map(|tile| TileIndex(tile as u32));
        let kind = *EventKind::ALL.get(usize::from(*from.split_off_first()?))?;
        let at_ms = varint::read(from, LONGEST).ok()?;
        let length = varint::read(from, LONGEST).ok()?;
        let (worker, text) = from.split_at_checked(length as usize)?;
        let text_of = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let what = LogEvent {
            kind,
            job,
            tile,
            worker: text_of(worker),
            text: text_of(text),
        };
        Some(Entry {
            number: self.first + at as u64,
            at_ms,
            what,
        })
    }
}

/// Writes an optional number.
fn option(out: &mut Vec<u8>, number: Option<u64>) {
    out.push(u8::from(number.is_some()));
    if let Some(number) = number {
        varint::write(out, number);
    }
}

/// Reads a number that [`option`] wrote. Returns `None` if the bytes are invalid.
fn read_option(from: &mut &[u8]) -> Option<Option<u64>> {
    match from.split_off_first()? {
        0 => Some(None),
        _ => varint::read(from, LONGEST).ok().map(Some),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(number: u64) -> Entry {
        let job = (!number.is_multiple_of(7)).then_some(JobId(number % 5));
        let tile = number
            .is_multiple_of(3)
            .then_some(TileIndex(u32::MAX - number as u32));
        let kind = EventKind::ALL[number as usize % EventKind::ALL.len()];
        let worker = if number.is_multiple_of(2) {
            String::new()
        } else {
            format!("ä-{number}")
        };
        let what = LogEvent {
            kind,
            job,
            tile,
            worker,
            text: format!("event «{number}»"),
        };
        Entry {
            number,
            at_ms: 1_800_000_000_000 + number,
            what,
        }
    }

    #[test]
    fn kinds_are_found_by_their_number() {
        assert!(
            EventKind::ALL
                .iter()
                .enumerate()
                .all(|(at, kind)| *kind as usize == at)
        );
    }

    #[test]
    fn events_are_returned_unchanged_from_every_number() {
        let mut recent = Recent::default();
        let all: Vec<Entry> = (1..=20_000).map(entry).collect();
        all.iter().for_each(|entry| recent.push(entry));
        assert!(recent.blocks.len() > 3);
        assert_eq!(recent.after(None, 0, usize::MAX), (all.clone(), 20_000));
        for after in (0..20_010u64).step_by(7).chain([u64::MAX]) {
            let rest = all
                .iter()
                .filter(|e| e.number > after)
                .take(3)
                .cloned()
                .collect::<Vec<_>>();
            assert_eq!(recent.after(None, after, 3).0, rest, "{after}");
        }
        let of_job: Vec<u64> = all
            .iter()
            .filter(|e| e.what.job == Some(JobId(2)))
            .map(|e| e.number)
            .collect();
        for most in [0, 1, 100, of_job.len() - 1] {
            let before = recent.before_last(JobId(2), most);
            assert_eq!(before, of_job[of_job.len() - 1 - most]);
            assert_eq!(
                recent.after(Some(JobId(2)), before, usize::MAX).0.len(),
                most
            );
        }
        assert_eq!(recent.before_last(JobId(2), of_job.len()), 0);
    }

    #[test]
    fn oldest_events_are_dropped() {
        let mut recent = Recent::default();
        for number in 1..=500_000 {
            recent.push(&entry(number));
        }
        let held: usize = recent
            .blocks
            .iter()
            .map(|b| b.bytes.capacity() + 4 * b.starts.capacity())
            .sum();
        assert!(
            (MOST_BYTES..MOST_BYTES + 4 * BLOCK_BYTES).contains(&held),
            "{held}"
        );
        let (kept, last) = recent.after(None, 0, usize::MAX);
        assert_eq!(last, 500_000);
        let first = 500_001 - kept.len() as u64;
        assert!(
            kept.len() > 100_000 && kept.iter().map(|e| e.number).eq(first..=500_000),
            "{}",
            kept.len()
        );
    }

    #[test]
    fn events_before_gap_are_dropped() {
        let mut recent = Recent::default();
        [1, 2, 5, 6]
            .map(entry)
            .iter()
            .for_each(|entry| recent.push(entry));
        assert_eq!(recent.after(None, 0, 9), (vec![entry(5), entry(6)], 6));
    }
}
