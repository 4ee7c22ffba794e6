//! The store on one machine's disk. The journal contains the state, and sled is a view of the journal that
//! answers queries.
//!
//! A command is acknowledged once the journal is synced. sled is changed after that, in one batch with the
//! offset of the journal that it then contains (`applied`). The store never syncs sled: the `flush` of sled
//! does not sync the data on Linux, and abrupt stops have damaged its files, so no guarantee depends on them.
//! At the next start the journal is replayed from `applied`. If sled does not open, if its entries do not
//! match their sum, or if sled was made from another or a longer journal, the store moves sled aside and
//! rebuilds it from the journal.
//!
//! sled has one tree with values under 4 KiB and without background flushes, because otherwise its space
//! grows. There is one writer thread: commands that arrive while it syncs share the next sync. Blobs are not
//! stored in sled.

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
use super::table::{Bytes, ChangedTable, Changes, View};

/// Maximum length of a group commit's events, in bytes, before later commands wait for the next group. The
/// journal's limit is far higher.
const GROUP_BYTES: usize = 1 << 20;

/// The time without commands after which the watermark is synced.
const IDLE: Duration = Duration::from_millis(50);
/// The number of commits after which the watermark is synced, even if further commands arrive.
const WATERMARK_COMMITS: u32 = 64;

/// The embedded store.
#[derive(Debug)]
pub struct SledStore {
    live: Arc<RwLock<Live>>,
    /// The queue of the writer thread; `None` only during the drop.
    commands: Mutex<Option<Sender<Box<dyn Pending>>>>,
    writer: Option<JoinHandle<()>>,
    status: Arc<WriterStatus>,
    /// The lock file; `None` on a disk of a test. Fields are dropped in order, so it is released last.
    lock: Option<File>,
}

impl SledStore {
    /// Opens or creates the store in `directory`, and brings its view up to date with its journal.
    ///
    /// # Errors
    /// An error if another process uses the directory, the journal is damaged or missing, or the disk fails.
    pub fn open(directory: &Path) -> Result<Self, StoreError> {
        let disk: Arc<dyn Disk> = Arc::new(SystemDisk);
        disk::create_folder(&*disk, directory).map_err(fault("create", directory))?;
        let lock = lock(&directory.join("lock"))?;
        let (path, view) = (directory.join("journal"), directory.join("sled"));
        if view.exists() && !path.exists() {
            return Err(JournalError::Missing { path }.into());
        }
        // A new store creates its journal first, so a view without a journal indicates lost data.
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
        let (journal, live) = compacted(&disk, journal, live, &path, &view)?;
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
        let status = Arc::<WriterStatus>::default();
        let (writer_view, writer_status) = (Arc::clone(&live), Arc::clone(&status));
        let writer = SledWriter {
            journal,
            idle,
            since_sync: 0,
            live: writer_view,
            status: writer_status,
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
            status,
            lock,
        })
    }
}

#[cfg(test)]
impl SledStore {
    /// Simulates a change that sled rejects: moves the view into memory.
    pub(super) fn refuse_changes(&self) {
        self.live
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .refuse_changes();
    }

    /// Simulates sled on a full disk.
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
    /// The length before the compaction, in bytes.
    pub from: u64,
    /// The length after the compaction, in bytes.
    pub to: u64,
}

impl SledStore {
    /// Compacts the journal of the store in `directory`, which no other process may use.
    ///
    /// # Errors
    /// The errors of [`SledStore::open`], and an error if the store does not exist.
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
        // The lock is kept; the view and the writer thread end.
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

    /// Reads the store in `directory` without changing any file in it. Damage is not an error.
    ///
    /// # Errors
    /// An error if a coordinator uses the directory, the store does not exist, or the disk fails.
    pub fn inspect(directory: &Path) -> Result<StoreInspection, StoreError> {
        let lock = lock::probe(&directory.join("lock"))?;
        let (disk, path) = (SystemDisk, directory.join("journal"));
        // Opening sled changes its files, so open a copy of them.
        let salvage = match view_of_copy(&directory.join("sled"), &path) {
            Ok(view) => salvage::read(&disk, &path, view)?,
            Err(e) => {
                let alone = salvage::read(&disk, &path, None)?;
                if alone.damage.is_some() {
                    return Err(e);
                }
                tracing::warn!(
                    "the view could not be compared with the journal, which is intact: {e}"
                );
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

    /// Repairs the journal of the store in `directory` if acknowledged frames are damaged.
    ///
    /// # Errors
    /// An error if a coordinator uses the directory, or if the disk fails.
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
    /// The damage to the journal, or `None` if the journal is intact.
    pub damage: Option<Damage>,
    /// True if the journal's watermark was readable. Without it, a journal with a lost end may look complete.
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

/// Reads a view from a copy of its files, so that the files stay unchanged. Returns `None` if it is unusable.
fn view_of_copy(view: &Path, journal: &Path) -> Result<Option<ViewEntries>, StoreError> {
    if !view.is_dir() {
        return Ok(None);
    }
    let copy = tempfile::tempdir().map_err(fault("create a folder for a copy of", view))?;
    copy_folder(view, copy.path()).map_err(fault("copy", view))?;
    match Live::open(copy.path(), Arc::new(SystemDisk), journal).and_then(|live| live.entries()) {
        Ok(found) => Ok(found),
        Err(StoreError::View { what }) => {
            tracing::warn!(%what, "the store's view is unusable, so only the journal is read");
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

/// Compacts the journal if the journal is much longer than its entries. Returns the journal and its view.
fn compacted(
    disk: &Arc<dyn Disk>,
    journal: Journal,
    live: Live,
    path: &Path,
    view: &Path,
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

/// Removes a view. The next start rebuilds it from the journal.
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
            tracing::error!(
                "the store's writer thread had panicked; no acknowledged change is lost"
            );
        }
        self.live
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .flush();
    }
}

impl Engine for SledStore {
    fn writable(&self) -> Result<(), StoreError> {
        self.status
            .trouble
            .get()
            .map_or(Ok(()), |e| Err(e.clone().into()))
    }

    fn report_syncs(&self, to: Report) {
        drop(self.status.syncs.set(to));
    }

    fn query<A>(
        &self,
        ask: impl FnOnce(View<'_>) -> Result<A, StoreError>,
    ) -> Result<A, StoreError> {
        // Only complete group commits are applied under this lock, so every answer belongs to one state.
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

/// The status that the writer thread shares with callers.
#[derive(Default)]
struct WriterStatus {
    syncs: OnceLock<Report>,
    /// The error after which the journal can no longer be written.
    trouble: OnceLock<JournalError>,
}

impl std::fmt::Debug for WriterStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WriterStatus")
            .field("trouble", &self.trouble)
            .finish_non_exhaustive()
    }
}

/// The writer thread, the only thread that appends to the journal and changes the view.
struct SledWriter {
    journal: Journal,
    /// The time without commands after which the watermark is synced; `None` to count only commits.
    idle: Option<Duration>,
    /// The number of commits since the watermark was synced.
    since_sync: u32,
    live: Arc<RwLock<Live>>,
    status: Arc<WriterStatus>,
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
            // A command without changes waits, too: its answer may depend on changes of other commands in the
            // group.
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

    /// Waits for a command, and returns `None` once all senders are dropped. If no command arrives for a
    /// while, makes the watermark durable, because no caller waits for that sync.
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

    /// Returns the encoded event of one command, and adds the event's changes to `staged`.
    fn stage(
        &self,
        command: &mut dyn Pending,
        staged: &mut Changes,
    ) -> Result<Option<Bytes>, StoreError> {
        let live = self.live.read().unwrap_or_else(PoisonError::into_inner);
        let Some(event) = command.decide(View(&ChangedTable {
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
            View(&ChangedTable {
                under: &*live,
                changes: &staged,
            })
            .numbers()?
        };
        let end = self.journal.append(payload, numbers).inspect_err(|e| {
            if matches!(e, JournalError::Unusable { .. }) {
                // Only the first error describes the cause.
                let _ = self.status.trouble.set(e.clone());
            }
        })?;
        if let Some(tell) = self.status.syncs.get() {
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

/// Moves a damaged view aside, so that a user can inspect or delete it.
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
