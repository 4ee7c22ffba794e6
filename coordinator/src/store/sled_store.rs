//! The store on one machine's disk: the journal holds the state, and sled is a view of it that answers
//! queries.
//!
//! A command is acknowledged when the journal is synced. sled is changed after that, in one batch with the
//! offset of the journal that it then contains (`applied`). sled is never synced here: its own `flush` does
//! not sync the data on Linux, and abrupt stops have damaged it, so nothing depends on its files. At the next
//! start the journal is replayed from `applied`. A sled that does not open, whose entries do not match their
//! sum, or that was made from another journal or from a longer one, is moved aside and rebuilt from the
//! journal.
//!
//! One tree, values under 4 KiB, no background flush (sled's space grows otherwise), one writer thread: the
//! commands that arrive while it syncs share the next sync. Blobs are not kept here.

use std::collections::BTreeMap;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::api::{Report, Store as _};
use super::commands::{Pending, pending};
use super::compaction;
use super::engine::Engine;
use super::entries;
use super::error::{JournalError, StoreError};
use super::journal::{HEADER_BYTES, Journal};
use super::lock::{fault, lock};
use super::rules::{self, Decision, Event};
use super::table::{Bytes, Changes, Over, Table, View, decode, encode};

/// A group commit takes no more commands once its events are this long; the journal's bound is far above.
const GROUP_BYTES: usize = 1 << 20;
/// While rebuilding, sled is changed after this many keys.
const REBUILD_KEYS: usize = 4096;
const APPLIED: &[u8] = b"a";
/// Memory of sled for entries; its default is a gigabyte.
const CACHE_BYTES: u64 = 64 << 20;

/// The embedded store.
#[derive(Debug)]
pub struct SledStore {
    live: Arc<RwLock<Live>>,
    /// `None` only while being dropped.
    commands: Mutex<Option<Sender<Box<dyn Pending>>>>,
    writer: Option<JoinHandle<()>>,
    told: Arc<Told>,
    /// Released last: fields are dropped in order.
    lock: File,
}

impl SledStore {
    /// Opens or creates the store in `directory` and brings its view up to date with its journal.
    ///
    /// # Errors
    /// When another process uses the directory, the journal is damaged or missing, or the disk fails.
    pub fn open(directory: &Path) -> Result<Self, StoreError> {
        std::fs::create_dir_all(directory).map_err(fault("create", directory))?;
        let lock = lock(&directory.join("lock"))?;
        let (path, view) = (directory.join("journal"), directory.join("sled"));
        if view.exists() && !path.exists() {
            return Err(JournalError::Missing { path, view }.into());
        }
        let journal = Journal::open(&path)?;
        let live = match Live::open(&view).and_then(|live| live.caught_up(&journal)) {
            Ok(live) => live,
            Err(StoreError::View { what }) => {
                let aside = move_aside(&view)?;
                tracing::warn!(
                    %what, aside = %aside.display(),
                    "the store's view is unusable; it is rebuilt from the journal"
                );
                Live::open(&view)?.caught_up(&journal)?
            }
            Err(other) => return Err(other),
        };
        let (journal, live) = compacted(journal, live, (&path, &view))?;
        let live = Arc::new(RwLock::new(live));
        let (commands, incoming) = channel();
        let told = Arc::<Told>::default();
        let writer = Writer { journal, live: live.clone(), told: Arc::clone(&told) };
        let writer = std::thread::Builder::new()
            .name("store-writer".to_owned())
            .spawn(move || writer.run(&incoming))
            .map_err(fault("start the writer thread for", directory))?;
        Ok(Self { live, commands: Mutex::new(Some(commands)), writer: Some(writer), told, lock })
    }
}

#[cfg(test)]
impl SledStore {
    /// Does what a refused change does: the view goes on in memory.
    pub(super) fn refuse_changes(&self) {
        let mut live = self.live.write().unwrap_or_else(PoisonError::into_inner);
        let entries = live.scan(&[]).unwrap();
        live.db = Entries::Memory(entries.into_iter().collect());
    }
}

/// The lengths of a journal before and after it was compacted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Compacted {
    /// Bytes before.
    pub from: u64,
    /// Bytes after.
    pub to: u64,
}

impl SledStore {
    /// Compacts the journal of the store in `directory`, which nobody uses.
    ///
    /// # Errors
    /// As [`SledStore::open`]; and when there is no store.
    pub fn compact(directory: &Path) -> Result<Compacted, StoreError> {
        let path = directory.join("journal");
        if !path.exists() {
            return Err(JournalError::Missing { path, view: directory.join("sled") }.into());
        }
        let store = Self::open(directory)?;
        let entries = store.entries()?;
        let from = std::fs::metadata(&path).map_err(fault("measure", &path))?.len();
        // The lock stays; the view and the writer go.
        let lock = store.lock.try_clone().map_err(fault("keep the lock of", directory))?;
        drop(store);
        let to = compaction::replace(&path, &entries)?;
        remove_view(&directory.join("sled"))?;
        drop(lock);
        Ok(Compacted { from, to })
    }
}

/// The journal compacted, if that is worth it, and the view of it.
fn compacted(
    journal: Journal,
    live: Live,
    (path, view): (&Path, &Path),
) -> Result<(Journal, Live), StoreError> {
    let entries = entries::all(View(&live))?;
    if !compaction::is_worth(journal.end(), &entries) {
        return Ok((journal, live));
    }
    let from = journal.end();
    drop((journal, live));
    let to = compaction::replace(path, &entries)?;
    remove_view(view)?;
    tracing::info!("the journal was compacted from {from} to {to} bytes");
    let journal = Journal::open(path)?;
    let live = Live::open(view)?.caught_up(&journal)?;
    Ok((journal, live))
}

/// Removes a view; it is made again from the journal.
fn remove_view(view: &Path) -> Result<(), StoreError> {
    match std::fs::remove_dir_all(view) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(fault("remove", view)(e)),
        _ => Ok(()),
    }
}

impl Drop for SledStore {
    fn drop(&mut self) {
        self.commands.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        if self.writer.take().is_some_and(|writer| writer.join().is_err()) {
            tracing::error!("the store's writer thread had panicked; nothing acknowledged is lost");
        }
        let live = self.live.write().unwrap_or_else(PoisonError::into_inner);
        // Not needed for durability; it only shortens the next start's replay.
        if let Entries::Sled(db) = &live.db
            && let Err(error) = guarded(|| db.flush())
        {
            tracing::warn!(
                %error,
                "the store's view could not be flushed; the next start brings it up to date"
            );
        }
    }
}

impl Engine for SledStore {
    fn writable(&self) -> Result<(), StoreError> {
        self.told.trouble.get().map_or(Ok(()), |e| Err(e.clone().into()))
    }

    fn report_syncs(&self, to: Report) {
        drop(self.told.syncs.set(to));
    }

    fn query<A>(&self, ask: impl FnOnce(View<'_>) -> Result<A, StoreError>) -> Result<A, StoreError> {
        // Only whole group commits are applied under this lock, so every answer belongs to one state.
        ask(View(&*self.live.read().unwrap_or_else(PoisonError::into_inner)))
    }

    fn command<A: Send + 'static>(
        &self,
        decide: impl FnOnce(View<'_>) -> Result<Decision<A>, StoreError> + Send + 'static,
    ) -> Result<A, StoreError> {
        let (command, answer) = pending(decide);
        let commands = self.commands.lock().unwrap_or_else(PoisonError::into_inner).clone();
        commands.ok_or(StoreError::Closed)?.send(command).map_err(|_| StoreError::Closed)?;
        answer.recv().map_err(|_| StoreError::Closed)?
    }
}

/// What the writer thread tells of itself.
#[derive(Default)]
struct Told {
    syncs: OnceLock<Report>,
    /// Why the journal can be written no more.
    trouble: OnceLock<JournalError>,
}

impl std::fmt::Debug for Told {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Told").field("trouble", &self.trouble).finish_non_exhaustive()
    }
}

/// The writer thread: the only one that appends to the journal and changes the view.
struct Writer {
    journal: Journal,
    live: Arc<RwLock<Live>>,
    told: Arc<Told>,
}

impl Writer {
    fn run(mut self, incoming: &Receiver<Box<dyn Pending>>) {
        while let Ok(first) = incoming.recv() {
            let mut group = Vec::new();
            let mut staged = Changes::new();
            let mut payload = b"[".to_vec();
            let mut next = Some(first);
            while let Some(mut command) = next {
                match self.stage(command.as_mut(), &mut staged) {
                    Ok(Some(event)) => {
                        if payload.len() > 1 {
                            payload.push(b',');
                        }
                        payload.extend(event);
                    }
                    Ok(None) => {}
                    Err(error) => command.refuse(error),
                }
                group.push(command);
                next = if payload.len() < GROUP_BYTES { incoming.try_recv().ok() } else { None };
            }
            // A command that changed nothing waits, too: its answer may depend on changes of other commands
            // in the group.
            let outcome = if payload.len() > 1 {
                payload.push(b']');
                self.commit(&payload, staged)
            } else {
                Ok(())
            };
            for command in group {
                command.answer(&outcome);
            }
        }
    }

    /// One command's event as it goes to the journal, its changes added to `staged`.
    fn stage(&self, command: &mut dyn Pending, staged: &mut Changes) -> Result<Option<Bytes>, StoreError> {
        let live = self.live.read().unwrap_or_else(PoisonError::into_inner);
        let Some(event) = command.decide(View(&Over { under: &*live, changes: staged })) else {
            return Ok(None);
        };
        let bytes = serde_json::to_vec(&event).map_err(|e| StoreError::View { what: e.to_string() })?;
        rules::stage(&event, &*live, staged)?;
        Ok(Some(bytes))
    }

    fn commit(&mut self, payload: &[u8], staged: Changes) -> Result<(), StoreError> {
        let begun = Instant::now();
        let end = self.journal.append(payload).inspect_err(|e| {
            if matches!(e, JournalError::Unusable { .. }) {
                // Only the first one says what happened.
                let _ = self.told.trouble.set(e.clone());
            }
        })?;
        if let Some(tell) = self.told.syncs.get() {
            tell(begun.elapsed());
        }
        self.live.write().unwrap_or_else(PoisonError::into_inner).take(staged, end, &self.journal);
        Ok(())
    }
}

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
struct Live {
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
    fn open(path: &Path) -> Result<Self, StoreError> {
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
    fn caught_up(mut self, journal: &Journal) -> Result<Self, StoreError> {
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
    fn take(&mut self, changes: Changes, end: u64, journal: &Journal) {
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

/// Moves a broken view aside, for a person to inspect or delete.
fn move_aside(view: &Path) -> Result<PathBuf, StoreError> {
    let mut number = 1_u32;
    let aside = loop {
        let aside = view.with_extension(format!("broken-{number}"));
        if !aside.exists() {
            break aside;
        }
        number += 1;
    };
    std::fs::rename(view, &aside).map_err(fault("move aside", view))?;
    Ok(aside)
}
