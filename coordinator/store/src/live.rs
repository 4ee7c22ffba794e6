//! The view of the embedded store, which answers queries. The view is sled or, after sled has failed, the
//! same entries in memory.
//!
//! After sled has met a full disk, it rejects all later changes. Reading it may fail, too, even before it has
//! rejected a change: a read splits a page that has grown, which is a write. Neither is an error of the
//! store, because the journal contains the complete state. The entries then stay in memory until the next
//! start, which brings sled up to date.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::disk::Disk;
use super::error::StoreError;
use super::journal::{self, HEADER_BYTES, Journal, JournalPosition};
use super::rules;
use super::salvage::ViewEntries;
use super::table::{Bytes, ChangedTable, Changes, Table, View, decode, encode};
use super::watermark::Watermark;

/// The number of changed keys after which a rebuild writes a batch to sled.
const REBUILD_KEYS: usize = 4096;
const APPLIED: &[u8] = b"a";
/// The cache capacity of sled, in bytes. Default of sled: 1 GiB.
const CACHE_BYTES: u64 = 64 << 20;

/// The part of the journal that the view contains; stored in the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Applied {
    /// The journal's id.
    journal: u64,
    /// The offset of the end of the last applied frame, in bytes.
    offset: u64,
    /// The running checksum of the journal at `offset`.
    chain: u64,
    /// The sum of the hashes of all other entries. The next start detects a lost, stale or damaged entry by
    /// it.
    sum: u64,
}

impl Applied {
    /// Returns the state before the first frame of a journal.
    fn nothing_of(journal: u64) -> Self {
        Self {
            journal,
            offset: HEADER_BYTES,
            chain: journal,
            sum: 0,
        }
    }

    fn place(&self) -> JournalPosition {
        JournalPosition {
            offset: self.offset,
            chain: self.chain,
        }
    }
}

/// The state that queries read: sled or its replacement, with changes that it has not accepted yet.
pub(super) struct Live {
    db: Entries,
    /// The entries that replace an unreadable sled at the next change.
    anew: OnceLock<BTreeMap<Bytes, Bytes>>,
    disk: Arc<dyn Disk>,
    /// The path of the journal.
    path: PathBuf,
    applied: Applied,
    /// The changes of frames that are not applied yet.
    waiting: Changes,
}

/// The storage of a view's entries.
enum Entries {
    Sled(sled::Db),
    Memory(BTreeMap<Bytes, Bytes>),
    /// A sled that can be neither read nor changed.
    #[cfg(test)]
    Stuck,
}

impl Table for Entries {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        match self {
            Self::Sled(db) => db.get(key),
            Self::Memory(entries) => Table::get(entries, key),
            #[cfg(test)]
            Self::Stuck => Err(stuck()),
        }
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        match self {
            Self::Sled(db) => db.scan(prefix),
            Self::Memory(entries) => entries.scan(prefix),
            #[cfg(test)]
            Self::Stuck => Err(stuck()),
        }
    }
}

impl std::fmt::Debug for Live {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Live")
            .field("applied", &self.applied)
            .finish_non_exhaustive()
    }
}

impl Table for Live {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        self.read(|entries| {
            ChangedTable {
                under: entries,
                changes: &self.waiting,
            }
            .get(key)
        })
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        self.read(|entries| {
            ChangedTable {
                under: entries,
                changes: &self.waiting,
            }
            .scan(prefix)
        })
    }
}

impl Table for sled::Db {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        Ok(guarded(|| sled::Tree::get(self, key))?.map(|value| value.to_vec()))
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        guarded(|| {
            self.scan_prefix(prefix)
                .filter(|entry| !matches!(entry, Ok((key, _)) if key == APPLIED))
                .map(|entry| entry.map(|(key, value)| (key.to_vec(), value.to_vec())))
                .collect()
        })
    }
}

impl Live {
    /// Opens sled, the view of a journal, and checks the sum of its entries' hashes.
    pub(super) fn open(
        path: &Path,
        disk: Arc<dyn Disk>,
        journal: &Path,
    ) -> Result<Self, StoreError> {
        let mut tries = 0;
        let db = loop {
            match guarded(|| {
                sled::Config::new()
                    .path(path)
                    .flush_every_ms(None)
                    .cache_capacity(CACHE_BYTES)
                    .open()
            }) {
                // The directory's lock keeps other processes out, so sled's previous handle in this process
                // is still being closed.
                Err(StoreError::View { what }) if tries < 100 && what.contains("acquire lock") => {
                    tries += 1;
                    std::thread::sleep(Duration::from_millis(20));
                }
                other => break other?,
            }
        };
        let applied = match guarded(|| sled::Tree::get(&db, APPLIED))? {
            Some(value) => decode(APPLIED, &value)?,
            None => Applied::nothing_of(0),
        };
        let live = Self::new(Entries::Sled(db), applied, disk, journal);
        let sum = live.db.scan(&[])?.iter().fold(0, |sum: u64, (key, value)| {
            sum.wrapping_add(hash(key, value))
        });
        if sum != applied.sum {
            return Err(StoreError::View {
                what: "the sum of the hashes of the entries is wrong".to_owned(),
            });
        }
        Ok(live)
    }

    /// Creates an empty view in memory, which lasts until the end of the process.
    #[cfg(any(test, feature = "simulation"))]
    pub(super) fn in_memory(disk: Arc<dyn Disk>, journal: &Path) -> Self {
        Self::new(
            Entries::Memory(BTreeMap::new()),
            Applied::nothing_of(0),
            disk,
            journal,
        )
    }

    fn new(db: Entries, applied: Applied, disk: Arc<dyn Disk>, path: &Path) -> Self {
        let waiting = Changes::new();
        Self {
            db,
            anew: OnceLock::new(),
            disk,
            path: path.to_owned(),
            applied,
            waiting,
        }
    }

    /// Returns the position in the journal up to which the view contains all frames, with the next job number
    /// and the epoch at this position. Returns `None` if the view contains no frame.
    pub(super) fn watermark(&self) -> Result<Option<Watermark>, StoreError> {
        let Applied {
            journal,
            offset: length,
            chain,
            ..
        } = self.applied;
        if length <= HEADER_BYTES {
            return Ok(None);
        }
        let view = View(self);
        let (next_job, epoch) = (view.next_job()?.0, view.epoch()?);
        Ok(Some(Watermark {
            journal,
            length,
            chain,
            next_job,
            epoch,
        }))
    }

    /// Returns the entries of the view with the result of [`Self::watermark`]. Returns `None` if the view
    /// contains no frame.
    pub(super) fn entries(&self) -> Result<Option<ViewEntries>, StoreError> {
        let Some(mark) = self.watermark()? else {
            return Ok(None);
        };
        Ok(Some((mark, self.scan(&[])?.into_iter().collect())))
    }

    /// Applies the frames of the journal that the view lacks.
    pub(super) fn caught_up(mut self, journal: &Journal) -> Result<Self, StoreError> {
        if self.applied == Applied::nothing_of(0) {
            self.applied = Applied::nothing_of(journal.id());
        }
        if self.applied.journal != journal.id() {
            return Err(StoreError::View {
                what: "the view was made from another journal".to_owned(),
            });
        }
        if !self.replay(journal.end().offset)? {
            let (has, end) = (self.applied.offset, journal.end().offset);
            let what = format!("the view contains {has} bytes of a journal of {end} bytes");
            return Err(StoreError::View { what });
        }
        Ok(self)
    }

    /// Applies the frames up to `length` bytes of the journal.
    ///
    /// Returns false, without applying any frame, if no frame begins or ends at the end of the view.
    fn replay(&mut self, length: u64) -> Result<bool, StoreError> {
        let (disk, path) = (Arc::clone(&self.disk), self.path.clone());
        let from = self.applied.place();
        let mut end = from;
        let reached = journal::replay(&*disk, &path, from, length, |payload, frame_end| {
            let events = rules::events(payload, frame_end.offset)?;
            let mut staged = std::mem::take(&mut self.waiting);
            for event in &events {
                rules::stage(event, &self.db, &mut staged)?;
            }
            end = frame_end;
            self.waiting = staged;
            if self.waiting.len() >= REBUILD_KEYS {
                self.apply(end)
            } else {
                Ok(())
            }
        })?;
        if reached {
            self.apply(end)?;
        }
        Ok(reached)
    }

    /// Reads the entries without waiting changes: from sled or, after its first error, from the journal.
    fn read<A>(&self, ask: impl Fn(&dyn Table) -> Result<A, StoreError>) -> Result<A, StoreError> {
        if let Some(entries) = self.anew.get() {
            return ask(entries);
        }
        match ask(&self.db) {
            Err(StoreError::View { what }) => ask(self.read_anew(&what)?),
            answer => answer,
        }
    }

    /// Reads the entries of the view from the journal, because sled cannot be read.
    fn read_anew(&self, what: &str) -> Result<&BTreeMap<Bytes, Bytes>, StoreError> {
        let applied = Applied::nothing_of(self.applied.journal);
        let (disk, memory) = (Arc::clone(&self.disk), Entries::Memory(BTreeMap::new()));
        let mut anew = Self::new(memory, applied, disk, &self.path);
        // Frames behind the applied part may not be durable yet.
        let replayed = anew.replay(self.applied.offset).inspect_err(
            |unread| tracing::error!(%what, %unread, "neither the store's view nor its journal can be read"),
        );
        if !replayed? {
            return Err(StoreError::View {
                what: what.to_owned(),
            });
        }
        let entries: BTreeMap<Bytes, Bytes> = anew.db.scan(&[])?.into_iter().collect();
        tracing::warn!(
            %what, entries = entries.len(),
            "the store's view cannot be read; it is rebuilt from the journal and stays in memory \
             until the next start"
        );
        Ok(self.anew.get_or_init(|| entries))
    }

    /// Applies the changes of a journal frame that ends at `end`.
    ///
    /// If sled rejects the changes, or could not be read before, the entries stay in memory from then on.
    pub(super) fn take(&mut self, changes: Changes, end: JournalPosition) {
        if let Some(entries) = self.anew.take() {
            self.replace_sled(entries);
        }
        self.waiting.extend(changes);
        let Err(error) = self.apply(end) else { return };
        match self.scan(&[]) {
            Ok(entries) => {
                tracing::warn!(
                    %error, entries = entries.len(),
                    "the store's view rejected a change, which is durable in the journal; the view \
                     is in memory until the next start"
                );
                self.replace_sled(entries.into_iter().collect());
                (self.applied.offset, self.applied.chain) = (end.offset, end.chain);
                self.waiting.clear();
            }
            // The change stays in `waiting`, where queries see it. The next change retries it.
            Err(unread) => tracing::warn!(
                %error, %unread, keys = self.waiting.len(),
                "the store's view rejected a change, which is durable in the journal, and cannot \
                 be read"
            ),
        }
    }

    /// Replaces sled by entries in memory, and closes sled.
    fn replace_sled(&mut self, entries: BTreeMap<Bytes, Bytes>) {
        self.anew = OnceLock::new();
        let old = std::mem::replace(&mut self.db, Entries::Memory(entries));
        // On a faulty disk, sled panics when it is closed.
        let closed = guarded(|| {
            drop(old);
            Ok(())
        });
        if let Err(error) = closed {
            tracing::warn!(%error, "the store's view could not be closed");
        }
    }

    /// Syncs sled's files. Durability does not need this; it only shortens the next start's replay.
    pub(super) fn flush(&self) {
        if let Entries::Sled(db) = &self.db
            && let Err(error) = guarded(|| db.flush())
        {
            tracing::warn!(
                %error,
                "the store's view could not be flushed; the next start brings it up to date"
            );
        }
    }

    /// Simulates a change that sled rejects: moves the view into memory.
    #[cfg(test)]
    pub(super) fn refuse_changes(&mut self) {
        let entries = self.scan(&[]).unwrap();
        self.db = Entries::Memory(entries.into_iter().collect());
    }

    /// Simulates a full disk: sled can be neither read nor changed from now on.
    #[cfg(test)]
    pub(super) fn get_stuck(&mut self) {
        self.db = Entries::Stuck;
    }

    /// Writes the waiting changes to sled, in one batch with the offset that the view then contains.
    fn apply(&mut self, end: JournalPosition) -> Result<(), StoreError> {
        if self.waiting.is_empty() && self.applied.place() == end {
            return Ok(());
        }
        let mut applied = Applied {
            offset: end.offset,
            chain: end.chain,
            ..self.applied
        };
        let mut batch = sled::Batch::default();
        for (key, value) in &self.waiting {
            if let Some(old) = self.db.get(key)? {
                applied.sum = applied.sum.wrapping_sub(hash(key, &old));
            }
            match value {
                Some(value) => {
                    applied.sum = applied.sum.wrapping_add(hash(key, value));
                    batch.insert(key.as_slice(), value.as_slice());
                }
                None => batch.remove(key.as_slice()),
            }
        }
        batch.insert(APPLIED, encode(APPLIED, &applied)?);
        match &mut self.db {
            Entries::Sled(db) => guarded(|| db.apply_batch(batch))?,
            #[cfg(test)]
            Entries::Stuck => return Err(stuck()),
            Entries::Memory(entries) => {
                for (key, value) in std::mem::take(&mut self.waiting) {
                    match value {
                        Some(value) => entries.insert(key, value),
                        None => entries.remove(&key),
                    };
                }
            }
        }
        self.applied = applied;
        self.waiting.clear();
        Ok(())
    }
}

fn hash(key: &[u8], value: &[u8]) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher
        .update(&(key.len() as u64).to_le_bytes())
        .update(key)
        .update(value);
    let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
    u64::from_le_bytes([a, b, c, d, e, f, g, h])
}

/// Calls sled, and returns a panic as an error. On damaged files, sled panics in some places.
fn guarded<T>(call: impl FnOnce() -> sled::Result<T>) -> Result<T, StoreError> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(result) => result.map_err(|e| StoreError::View {
            what: e.to_string(),
        }),
        Err(_) => Err(StoreError::View {
            what: "sled panicked".to_owned(),
        }),
    }
}

#[cfg(test)]
fn stuck() -> StoreError {
    StoreError::View {
        what: "no space left on device".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::disk::SystemDisk;

    /// Checks that a view can be opened while the previous handle of this process is still being closed.
    #[test]
    fn open_waits_for_previous_handle() {
        let folder = tempfile::tempdir().unwrap();
        let (view, journal) = (folder.path().join("view"), folder.path().join("journal"));
        let open = || Live::open(&view, Arc::new(SystemDisk), &journal);
        let previous = open().unwrap();
        let closing = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            drop(previous);
        });
        let next = open();
        closing.join().unwrap();
        assert!(next.is_ok());
    }
}
