//! The watermark: a small file that records the acknowledged part of the journal.
//!
//! ```text
//! two slots of 512 bytes, written in turn (little-endian throughout):
//! "SLMARK01"  sequence u64  journal id u64  length u64  chain u64  next job u64  epoch u64  crc32c u32 of
//! the bytes before
//! ```
//! A crash in the middle of an append leaves an incomplete frame at the end of the journal. A damaged disk
//! leaves a bad frame at any position. Only a record of the acknowledged length distinguishes the two. The
//! store's writer records it after each sync of the journal and before the acknowledgement. The slot is then
//! in the page cache, which outlives the process. The slot is synced when the writer is idle
//! ([`WatermarkFile::sync`]). So the watermark never exceeds the durable part of the journal. After a power
//! failure it lacks at most the most recent commits.
//!
//! The slot with the higher sequence counts. If one slot is incomplete or damaged, the other one is used.

use std::io::{self, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::disk::{self, Access, Disk, DiskFile, ZeroUnreadable};
use super::error::JournalError;
use super::place::{JournalPosition, Numbers};

const MAGIC: &[u8; 8] = b"SLMARK01";
/// The distance between the slots, in bytes. Disks write sectors of this size in one step.
const SLOT_BYTES: u64 = 512;
/// The length of a slot's content, in bytes.
const CONTENT: usize = 8 * 7 + 4;

/// The acknowledged part of a journal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Watermark {
    /// The id of the journal.
    pub(super) journal: u64,
    /// The offset of the end of the last acknowledged frame, in bytes.
    pub(super) length: u64,
    /// The running checksum of the frames up to `length`.
    pub(super) chain: u64,
    /// The number of the next job. All lower numbers are assigned.
    pub(super) next_job: u64,
    /// The epoch that began last.
    pub(super) epoch: u64,
}

impl Watermark {
    /// Returns the end of the acknowledged part.
    pub(super) fn place(&self) -> JournalPosition {
        JournalPosition {
            offset: self.length,
            chain: self.chain,
        }
    }

    /// Returns the numbers that the store had assigned.
    pub(super) fn numbers(&self) -> Numbers {
        Numbers {
            next_job: self.next_job,
            epoch: self.epoch,
        }
    }

    /// Creates the watermark of a journal that is acknowledged up to `end`.
    pub(super) fn new(journal: u64, end: JournalPosition, numbers: Numbers) -> Self {
        let (
            JournalPosition {
                offset: length,
                chain,
            },
            Numbers { next_job, epoch },
        ) = (end, numbers);
        Self {
            journal,
            length,
            chain,
            next_job,
            epoch,
        }
    }
}

/// An open watermark file.
pub(super) struct WatermarkFile {
    path: PathBuf,
    file: Box<dyn DiskFile>,
    /// The sequence number of the slot that was written last.
    sequence: u64,
    /// True while the last slot may not be durable.
    unsynced: bool,
}

/// Returns the path of the watermark that belongs to the journal at `journal`.
pub(super) fn path_of(journal: &Path) -> PathBuf {
    journal.with_extension("mark")
}

/// Reads the intact watermarks in the file at `path`, newest first. Skips damaged and unreadable slots.
/// Returns an empty list if the file does not exist.
pub(super) fn read(disk: &dyn Disk, path: &Path) -> Result<Vec<Watermark>, JournalError> {
    match disk::read_up_to(&ZeroUnreadable(disk), path, 2 * SLOT_BYTES) {
        Ok(bytes) => Ok(slots(&bytes)
            .into_iter()
            .rev()
            .map(|(_, mark)| mark)
            .collect()),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(e) => Err(fault("read", path)(e)),
    }
}

/// Decodes the intact slots, ascending by sequence.
fn slots(bytes: &[u8]) -> Vec<(u64, Watermark)> {
    let slot = |at: u64| {
        let content = bytes.get(at as usize..)?.first_chunk::<CONTENT>()?;
        let (numbers, crc) = content.split_last_chunk::<4>()?;
        if u32::from_le_bytes(*crc) != crc32c::crc32c(numbers) || !numbers.starts_with(MAGIC) {
            return None;
        }
        let mut numbers = numbers
            .chunks_exact(8)
            .skip(1)
            .map(|n| n.try_into().map_or(0, u64::from_le_bytes));
        let mut next = || numbers.next().unwrap_or_default();
        let sequence = next();
        let (journal, length, chain, next_job, epoch) = (next(), next(), next(), next(), next());
        Some((
            sequence,
            Watermark {
                journal,
                length,
                chain,
                next_job,
                epoch,
            },
        ))
    };
    let mut found: Vec<_> = [0, SLOT_BYTES].into_iter().filter_map(slot).collect();
    found.sort_by_key(|(sequence, _)| *sequence);
    found
}

impl WatermarkFile {
    /// Opens or creates the file, without changing existing slots.
    pub(super) fn open(disk: &dyn Disk, path: &Path) -> Result<Self, JournalError> {
        if disk
            .attributes(path)
            .map_err(fault("look at", path))?
            .is_none()
        {
            let beside = path.with_extension("mark-new");
            let empty = [0; 2 * SLOT_BYTES as usize];
            disk::replace(disk, path, &beside, &empty).map_err(fault("create", path))?;
        }
        let bytes = disk::read_up_to(&ZeroUnreadable(disk), path, 2 * SLOT_BYTES)
            .map_err(fault("read", path))?;
        let sequence = slots(&bytes).last().map_or(0, |(sequence, _)| *sequence);
        let file = disk
            .open(path, Access::Update)
            .map_err(fault("open", path))?;
        Ok(Self {
            path: path.to_owned(),
            file,
            sequence,
            unsynced: false,
        })
    }

    /// Writes a watermark into the older slot, without a sync.
    pub(super) fn record(&mut self, mark: &Watermark) -> Result<(), JournalError> {
        let sequence = self.sequence + 1;
        let mut content = MAGIC.to_vec();
        for number in [
            sequence,
            mark.journal,
            mark.length,
            mark.chain,
            mark.next_job,
            mark.epoch,
        ] {
            content.extend(number.to_le_bytes());
        }
        content.extend(crc32c::crc32c(&content).to_le_bytes());
        self.file
            .seek(SeekFrom::Start(sequence % 2 * SLOT_BYTES))
            .and_then(|_| self.file.write_all(&content))
            .map_err(fault("write", &self.path))?;
        (self.sequence, self.unsynced) = (sequence, true);
        Ok(())
    }

    /// Makes the recorded watermark durable, unless it already is.
    pub(super) fn sync(&mut self) -> Result<(), JournalError> {
        if self.unsynced {
            self.file.sync().map_err(fault("sync", &self.path))?;
            self.unsynced = false;
        }
        Ok(())
    }
}

fn fault(doing: &'static str, path: &Path) -> impl Fn(io::Error) -> JournalError {
    let path = path.to_owned();
    move |source| JournalError::Io {
        doing,
        path: path.clone(),
        source: Arc::new(source),
    }
}

#[cfg(test)]
mod tests {
    use super::super::disk::SystemDisk;
    use super::*;

    fn mark(n: u64) -> Watermark {
        Watermark {
            journal: 7,
            length: 24 + n,
            chain: n * n,
            next_job: n,
            epoch: 1,
        }
    }

    #[test]
    fn watermark_survives_damage_to_one_slot() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("journal.mark");
        assert_eq!(read(&SystemDisk, &path).unwrap(), []);
        for n in 1..5 {
            let mut file = WatermarkFile::open(&SystemDisk, &path).unwrap();
            file.record(&mark(n)).unwrap();
            file.sync().unwrap();
            assert_eq!(read(&SystemDisk, &path).unwrap()[0], mark(n));
        }
        let whole = std::fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[at] ^= 1;
            std::fs::write(&path, &flipped).unwrap();
            let found = read(&SystemDisk, &path).unwrap();
            assert!(found[0] == mark(4) || found == [mark(3)], "{at}: {found:?}");
        }
        std::fs::write(&path, b"short").unwrap();
        assert_eq!(read(&SystemDisk, &path).unwrap(), []);
    }
}
