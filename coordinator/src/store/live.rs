//! The view of the embedded store that answers queries: sled, or, once sled has refused a change, the same
//! entries in memory.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::error::StoreError;
use super::journal::{HEADER_BYTES, Journal};
use super::rules::{self, Event};
use super::table::{Bytes, Changes, Over, Table, decode, encode};

/// While rebuilding, sled is changed after this many keys.
const REBUILD_KEYS: usize = 4096;
const APPLIED: &[u8] = b"a";
/// Memory of sled for entries; its default is a gigabyte.
const CACHE_BYTES: u64 = 64 << 20;

/// The part of the journal that the view contains; stored in the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Applied {
    /// The journal's id.
    journal: u64,
    /// The end of the last frame applied.
    offset: u64,
    /// Sum of the hashes of all other entries: a lost, stale or damaged one is found at the next start.
    sum: u64,
}

/// The state as queries see it: sled, and changes that sled has not accepted yet.
///
/// A sled that has refused a change once, on a full disk, refuses all later ones, and its reads may fail. So
/// the entries then go on in memory alone until the next start, at which sled is brought up to date.
pub(super) struct Live {
    db: Entries,
    applied: Applied,
    /// Changes of frames that are not applied yet.
    waiting: Changes,
}

/// Where the entries of a view are.
enum Entries {
    Sled(sled::Db),
    Memory(BTreeMap<Bytes, Bytes>),
}

impl Table for Entries {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        match self {
            Self::Sled(db) => db.get(key),
            Self::Memory(entries) => Table::get(entries, key),
        }
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        match self {
            Self::Sled(db) => db.scan(prefix),
            Self::Memory(entries) => entries.scan(prefix),
        }
    }
}

impl std::fmt::Debug for Live {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Live").field("applied", &self.applied).finish_non_exhaustive()
    }
}

impl Table for Live {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        Over { under: &self.db, changes: &self.waiting }.get(key)
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        Over { under: &self.db, changes: &self.waiting }.scan(prefix)
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
    /// Opens sled and checks the sum of its entries' hashes.
    pub(super) fn open(path: &Path) -> Result<Self, StoreError> {
        let mut tries = 0;
        let db = loop {
            match guarded(|| {
                sled::Config::new().path(path).flush_every_ms(None).cache_capacity(CACHE_BYTES).open()
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
            None => Applied { journal: 0, offset: 0, sum: 0 },
        };
        let live = Self { db: Entries::Sled(db), applied, waiting: Changes::new() };
        let sum =
            live.db.scan(&[])?.iter().fold(0, |sum: u64, (key, value)| sum.wrapping_add(hash(key, value)));
        if sum != applied.sum {
            return Err(StoreError::View { what: "its entries do not add up".to_owned() });
        }
        Ok(live)
    }

    /// Applies the frames of the journal that the view lacks.
    pub(super) fn caught_up(mut self, journal: &Journal) -> Result<Self, StoreError> {
        if self.applied == (Applied { journal: 0, offset: 0, sum: 0 }) {
            self.applied = Applied { journal: journal.id(), offset: HEADER_BYTES, sum: 0 };
        }
        if self.applied.journal != journal.id() {
            return Err(StoreError::View { what: "it was made from another journal".to_owned() });
        }
        let mut end = self.applied.offset;
        let reached = journal.replay(self.applied.offset, |payload, frame_end| {
            let events: Vec<Event> = serde_json::from_slice(payload)
                .map_err(|e| StoreError::Unreadable { before: frame_end, what: e.to_string() })?;
            let mut staged = std::mem::take(&mut self.waiting);
            for event in &events {
                rules::stage(event, &self.db, &mut staged)?;
            }
            end = frame_end;
            self.waiting = staged;
            if self.waiting.len() >= REBUILD_KEYS { self.apply(end) } else { Ok(()) }
        })?;
        if !reached {
            let what =
                format!("it stands for {} bytes of a journal of {}", self.applied.offset, journal.end());
            return Err(StoreError::View { what });
        }
        self.apply(end)?;
        Ok(self)
    }

    /// Applies the changes of a frame of the journal that ends at `end`. When sled refuses them, the entries
    /// go on in memory.
    pub(super) fn take(&mut self, changes: Changes, end: u64, journal: &Journal) {
        self.waiting.extend(changes);
        let Err(error) = self.apply(end) else { return };
        match self.in_memory(journal) {
            Ok(entries) => {
                tracing::warn!(
                    %error, entries = entries.len(),
                    "the store's view refused a change, which is durable in the journal; until the next \
                     start the view is kept in memory"
                );
                let old = std::mem::replace(&mut self.db, Entries::Memory(entries));
                // On a disk in trouble sled panics when it is closed.
                let closed = guarded(|| {
                    drop(old);
                    Ok(())
                });
                if let Err(error) = closed {
                    tracing::warn!(%error, "the store's view could not be closed");
                }
                self.applied.offset = end;
                self.waiting.clear();
            }
            // The change stays where queries look, and is tried again with the next one.
            Err(unread) => tracing::warn!(
                %error, %unread, keys = self.waiting.len(),
                "the store's view refused a change, which is durable in the journal, and cannot be read"
            ),
        }
    }

    /// All entries with the waiting changes; from the journal where sled cannot be read.
    fn in_memory(&self, journal: &Journal) -> Result<BTreeMap<Bytes, Bytes>, StoreError> {
        match self.scan(&[]) {
            Ok(entries) => Ok(entries.into_iter().collect()),
            Err(_) => {
                let entries = Entries::Memory(BTreeMap::new());
                let applied = Applied { journal: 0, offset: 0, sum: 0 };
                let anew = Self { db: entries, applied, waiting: Changes::new() }.caught_up(journal)?;
                Ok(anew.scan(&[])?.into_iter().collect())
            }
        }
    }

    /// Syncs sled's files. Not needed for durability; it only shortens the next start's replay.
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

    /// Does what a refused change does: the view goes on in memory.
    #[cfg(test)]
    pub(super) fn refuse_changes(&mut self) {
        let entries = self.scan(&[]).unwrap();
        self.db = Entries::Memory(entries.into_iter().collect());
    }

    /// Gives the waiting changes to sled, in one batch with the offset that the view then contains.
    fn apply(&mut self, end: u64) -> Result<(), StoreError> {
        if self.waiting.is_empty() && self.applied.offset == end {
            return Ok(());
        }
        let mut applied = Applied { offset: end, ..self.applied };
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
    hasher.update(&(key.len() as u64).to_le_bytes()).update(key).update(value);
    let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
    u64::from_le_bytes([a, b, c, d, e, f, g, h])
}

/// Calls sled. On damaged files it panics in places where it should return an error.
fn guarded<T>(call: impl FnOnce() -> sled::Result<T>) -> Result<T, StoreError> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(result) => result.map_err(|e| StoreError::View { what: e.to_string() }),
        Err(_) => Err(StoreError::View { what: "sled panicked".to_owned() }),
    }
}
