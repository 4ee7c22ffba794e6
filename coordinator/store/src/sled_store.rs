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

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::api::{Queries as _, Report};
use super::commands::{Pending, pending};
use super::compaction;
use super::disk::{self, Disk, SystemDisk};
use super::engine::Engine;
use super::entries;
use super::error::{JournalError, StoreError};
use super::journal::{Journal, Numbers};
use super::live::Live;
use super::lock::{self, fault, lock};
use super::memory::MemoryStore;
use super::rules::{self, Decision};
use super::salvage::{self, Damage, ViewEntries};
use super::table::{Bytes, Changes, Over, View};

/// A group commit takes no more commands once its events are this long; the journal's bound is far above.
const GROUP_BYTES: usize = 1 << 20;

/// The watermark is synced when no command came for this long.
const IDLE: Duration = Duration::from_millis(50);
/// The watermark is synced after this many commits, even if commands keep coming.
const WATERMARK_COMMITS: u32 = 64;

/// The embedded store.
#[derive(Debug)]
pub struct SledStore {
    live: Arc<RwLock<Live>>,
    /// `None` only while being dropped.
    commands: Mutex<Option<Sender<Box<dyn Pending>>>>,
    writer: Option<JoinHandle<()>>,
    told: Arc<Told>,
    /// Released last: fields are dropped in order. `None` on a disk of a test.
    lock: Option<File>,
}

impl SledStore {
    /// Opens or creates the store in `directory` and brings its view up to date with its journal.
    ///
    /// # Errors
    /// When another process uses the directory, the journal is damaged or missing, or the disk fails.
    pub fn open(directory: &Path) -> Result<Self, StoreError> {
        let disk: Arc<dyn Disk> = Arc::new(SystemDisk);
        disk::create_folder(&*disk, directory).map_err(fault("create", directory))?;
        let lock = lock(&directory.join("lock"))?;
        let (path, view) = (directory.join("journal"), directory.join("sled"));
        if view.exists() && !path.exists() {
            return Err(JournalError::Missing { path }.into());
        }
        // A new store has its journal first: a view without one stands for lost data.
        let existing = path
            .exists()
            .then(|| Live::open(&view, Arc::clone(&disk), &path));
        let seen = match &existing {
            Some(Ok(live)) => live.watermark()?,
            Some(Err(_)) | None => None,
        };
        let journal = match Journal::open(&*disk, &path, seen) {
            Err(JournalError::Damaged {
                path, offset, what, ..
            }) => {
                let of_view = existing
                    .and_then(Result::ok)
                    .map(|live| live.entries())
                    .transpose()?
                    .flatten();
                let damage = salvage::read(&*disk, &path, of_view)?.damage;
                let lost = damage.map_or_else(String::new, |damage| damage.loss());
                return Err(JournalError::Damaged {
                    path,
                    offset,
                    what,
                    lost,
                }
                .into());
            }
            Err(JournalError::Io {
                doing: "read",
                path,
                source,
            }) if disk::is_unreadable(&source) => {
                return Err(JournalError::Unreadable { path, source }.into());
            }
            other => other?,
        };
        let fresh = || Live::open(&view, Arc::clone(&disk), &path);
        let live = match existing
            .unwrap_or_else(fresh)
            .and_then(|live| live.caught_up(&journal))
        {
            Ok(live) => live,
            Err(StoreError::View { what }) => {
                let aside = move_aside(&view)?;
                tracing::warn!(
                    %what, aside = %aside.display(),
                    "the store's view is unusable; it is rebuilt from the journal"
                );
                fresh()?.caught_up(&journal)?
            }
            Err(other) => return Err(other),
        };
        let (journal, live) = compacted(&disk, journal, live, (&path, &view))?;
        Self::start(journal, live, Some(IDLE), Some(lock))
    }

    /// Opens or creates the store on another disk, with its view in memory.
    #[cfg(any(test, feature = "simulation"))]
    pub(crate) fn open_on(disk: Arc<dyn Disk>, directory: &Path) -> Result<Self, StoreError> {
        disk::create_folder(&*disk, directory).map_err(fault("create", directory))?;
        let path = directory.join("journal");
        let journal = Journal::open(&*disk, &path, None)?;
        let live = Live::in_memory(disk, &path).caught_up(&journal)?;
        Self::start(journal, live, None, None)
    }

    fn start(
        mut journal: Journal,
        live: Live,
        idle: Option<Duration>,
        lock: Option<File>,
    ) -> Result<Self, StoreError> {
        journal.acknowledge(View(&live).numbers()?)?;
        let live = Arc::new(RwLock::new(live));
        let (commands, incoming) = channel();
        let told = Arc::<Told>::default();
        let (writer_view, writer_told) = (Arc::clone(&live), Arc::clone(&told));
        let writer = SledWriter {
            journal,
            idle,
            since_sync: 0,
            live: writer_view,
            told: writer_told,
        };
        let writer = std::thread::Builder::new()
            .name("store-writer".to_owned())
            .spawn(move || writer.run(&incoming))
            .map_err(|e| StoreError::Thread {
                what: e.to_string(),
            })?;
        Ok(Self {
            live,
            commands: Mutex::new(Some(commands)),
            writer: Some(writer),
            told,
            lock,
        })
    }
}

#[cfg(test)]
impl SledStore {
    /// Does what a refused change does: the view goes on in memory.
    pub(super) fn refuse_changes(&self) {
        self.live
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .refuse_changes();
    }

    /// Does what sled does on a full disk.
    pub(super) fn get_stuck(&self) {
        self.live
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .get_stuck();
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
            return Err(JournalError::Missing { path }.into());
        }
        let store = Self::open(directory)?;
        let (entries, numbers) = (store.entries()?, store.numbers()?);
        let from = std::fs::metadata(&path)
            .map_err(fault("measure", &path))?
            .len();
        // The lock stays; the view and the writer go.
        let lock = store.lock.as_ref().map(File::try_clone).transpose();
        let lock = lock.map_err(fault("keep the lock of", directory))?;
        drop(store);
        let to = compaction::replace(&SystemDisk, &path, &entries, numbers)?;
        remove_view(&directory.join("sled"))?;
        drop(lock);
        Ok(Compacted { from, to })
    }

    fn numbers(&self) -> Result<Numbers, StoreError> {
        self.query(|view| view.numbers())
    }

    /// Reads the store in `directory` without changing any file in it.
    ///
    /// # Errors
    /// When a coordinator uses the directory, there is no store, or the disk fails. Damage is not an error.
    pub fn inspect(directory: &Path) -> Result<StoreInspection, StoreError> {
        let lock = lock::probe(&directory.join("lock"))?;
        let (disk, path) = (SystemDisk, directory.join("journal"));
        // Opening sled changes its files, so a copy of them is opened.
        let salvage = match view_of_copy(&directory.join("sled"), &path) {
            Ok(view) => salvage::read(&disk, &path, view)?,
            Err(e) => {
                let alone = salvage::read(&disk, &path, None)?;
                if alone.damage.is_some() {
                    return Err(e);
                }
                tracing::warn!("the view was not compared with the journal, which is whole: {e}");
                alone
            }
        };
        drop(lock);
        let salvage::Salvage {
            entries,
            damage,
            is_marked,
            ..
        } = salvage;
        Ok(StoreInspection {
            store: MemoryStore::with(entries),
            damage,
            is_marked,
        })
    }

    /// Repairs the journal of the store in `directory`, if acknowledged frames of it are damaged.
    ///
    /// # Errors
    /// When a coordinator uses the directory, or the disk fails.
    pub fn repair(directory: &Path) -> Result<Option<Repaired>, StoreError> {
        let _lock = lock(&directory.join("lock"))?;
        let disk: Arc<dyn Disk> = Arc::new(SystemDisk);
        let (path, view) = (directory.join("journal"), directory.join("sled"));
        let of_view = view_of_copy(&view, &path)?;
        let salvage = salvage::read(&*disk, &path, of_view)?;
        let Some(damage) = salvage.damage.clone() else {
            return Ok(None);
        };
        let damaged = salvage::replace(&*disk, &path, salvage)?;
        remove_view(&view)?;
        Ok(Some(Repaired { damage, damaged }))
    }
}

/// The content of a store that was read without changing it.
#[derive(Debug)]
pub struct StoreInspection {
    /// The readable records.
    pub store: MemoryStore,
    /// The damage to the journal, if there is any.
    pub damage: Option<Damage>,
    /// Whether the journal's watermark could be read. Without it a lost end of the journal may look whole.
    pub is_marked: bool,
}

/// The outcome of a repair.
#[derive(Clone, Debug)]
pub struct Repaired {
    /// The damage, with the changes that the repair could not recover.
    pub damage: Damage,
    /// The path of the damaged journal's copy; `None` if the journal was missing.
    pub damaged: Option<PathBuf>,
}

/// Reads a view from a copy of its files, so that they stay as they are. Returns `None` if it is unusable.
fn view_of_copy(view: &Path, journal: &Path) -> Result<Option<ViewEntries>, StoreError> {
    if !view.is_dir() {
        return Ok(None);
    }
    let copy = tempfile::tempdir().map_err(fault("create a folder for a copy of", view))?;
    copy_folder(view, copy.path()).map_err(fault("copy", view))?;
    match Live::open(copy.path(), Arc::new(SystemDisk), journal).and_then(|live| live.entries()) {
        Ok(found) => Ok(found),
        Err(StoreError::View { what }) => {
            tracing::warn!(%what, "the store's view is unusable, so that only its journal counts");
            Ok(None)
        }
        Err(other) => Err(other),
    }
}

fn copy_folder(from: &Path, to: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)? {
        let entry = entry?;
        let to = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_folder(&entry.path(), &to)?;
        } else {
            std::fs::copy(entry.path(), to)?;
        }
    }
    Ok(())
}

/// The journal compacted, if that is worth it, and the view of it.
fn compacted(
    disk: &Arc<dyn Disk>,
    journal: Journal,
    live: Live,
    (path, view): (&Path, &Path),
) -> Result<(Journal, Live), StoreError> {
    let (entries, numbers) = (entries::all(View(&live))?, View(&live).numbers()?);
    let from = journal.end().offset;
    if !compaction::is_worth(from, &entries) {
        return Ok((journal, live));
    }
    drop((journal, live));
    let to = compaction::replace(&**disk, path, &entries, numbers)?;
    remove_view(view)?;
    tracing::info!("the journal was compacted from {from} to {to} bytes");
    let journal = Journal::open(&**disk, path, None)?;
    let live = Live::open(view, Arc::clone(disk), path)?.caught_up(&journal)?;
    Ok((journal, live))
}

/// Removes a view; it is made again from the journal.
pub(super) fn remove_view(view: &Path) -> Result<(), StoreError> {
    match std::fs::remove_dir_all(view) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(fault("remove", view)(e)),
        _ => Ok(()),
    }
}

impl Drop for SledStore {
    fn drop(&mut self) {
        self.commands
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if self
            .writer
            .take()
            .is_some_and(|writer| writer.join().is_err())
        {
            tracing::error!("the store's writer thread had panicked; nothing acknowledged is lost");
        }
        self.live
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .flush();
    }
}

impl Engine for SledStore {
    fn writable(&self) -> Result<(), StoreError> {
        self.told
            .trouble
            .get()
            .map_or(Ok(()), |e| Err(e.clone().into()))
    }

    fn report_syncs(&self, to: Report) {
        drop(self.told.syncs.set(to));
    }

    fn query<A>(
        &self,
        ask: impl FnOnce(View<'_>) -> Result<A, StoreError>,
    ) -> Result<A, StoreError> {
        // Only whole group commits are applied under this lock, so every answer belongs to one state.
        ask(View(
            &*self.live.read().unwrap_or_else(PoisonError::into_inner),
        ))
    }

    fn command<A: Send + 'static>(
        &self,
        decide: impl FnOnce(View<'_>) -> Result<Decision<A>, StoreError> + Send + 'static,
    ) -> Result<A, StoreError> {
        let (command, answer) = pending(decide);
        let commands = self
            .commands
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        commands
            .ok_or(StoreError::Closed)?
            .send(command)
            .map_err(|_| StoreError::Closed)?;
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
        f.debug_struct("Told")
            .field("trouble", &self.trouble)
            .finish_non_exhaustive()
    }
}

/// The writer thread: the only one that appends to the journal and changes the view.
struct SledWriter {
    journal: Journal,
    /// The watermark is synced when no command came for this long; `None` for a count of commits only.
    idle: Option<Duration>,
    /// Commits since the watermark was synced.
    since_sync: u32,
    live: Arc<RwLock<Live>>,
    told: Arc<Told>,
}

impl SledWriter {
    fn run(mut self, incoming: &Receiver<Box<dyn Pending>>) {
        while let Some(first) = self.next(incoming) {
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
                next = if payload.len() < GROUP_BYTES {
                    incoming.try_recv().ok()
                } else {
                    None
                };
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
        self.sync_watermark();
    }

    /// Waits for a command. While none comes, the watermark is made durable: no caller waits for that sync.
    fn next(&mut self, incoming: &Receiver<Box<dyn Pending>>) -> Option<Box<dyn Pending>> {
        let is_due = self.since_sync >= WATERMARK_COMMITS;
        let waited = match self.idle {
            _ if is_due => Err(RecvTimeoutError::Timeout),
            Some(idle) => incoming.recv_timeout(idle),
            None => incoming.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match waited {
            Ok(command) => Some(command),
            Err(RecvTimeoutError::Disconnected) => None,
            Err(RecvTimeoutError::Timeout) => {
                self.sync_watermark();
                incoming.recv().ok()
            }
        }
    }

    fn sync_watermark(&mut self) {
        if let Err(error) = self.journal.sync_watermark() {
            tracing::warn!(%error, "the journal's watermark is not durable yet");
        }
        self.since_sync = 0;
    }

    /// One command's event as it goes to the journal, its changes added to `staged`.
    fn stage(
        &self,
        command: &mut dyn Pending,
        staged: &mut Changes,
    ) -> Result<Option<Bytes>, StoreError> {
        let live = self.live.read().unwrap_or_else(PoisonError::into_inner);
        let Some(event) = command.decide(View(&Over {
            under: &*live,
            changes: staged,
        })) else {
            return Ok(None);
        };
        let bytes = serde_json::to_vec(&event).map_err(|e| StoreError::View {
            what: e.to_string(),
        })?;
        rules::stage(&event, &*live, staged)?;
        Ok(Some(bytes))
    }

    fn commit(&mut self, payload: &[u8], staged: Changes) -> Result<(), StoreError> {
        let begun = Instant::now();
        let numbers = {
            let live = self.live.read().unwrap_or_else(PoisonError::into_inner);
            View(&Over {
                under: &*live,
                changes: &staged,
            })
            .numbers()?
        };
        let end = self.journal.append(payload, numbers).inspect_err(|e| {
            if matches!(e, JournalError::Unusable { .. }) {
                // Only the first one says what happened.
                let _ = self.told.trouble.set(e.clone());
            }
        })?;
        if let Some(tell) = self.told.syncs.get() {
            tell(begun.elapsed());
        }
        self.since_sync += 1;
        self.live
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .take(staged, end);
        Ok(())
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
