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
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::thread::JoinHandle;
use std::time::Instant;

use super::api::{Report, Store as _};
use super::commands::{Pending, pending};
use super::compaction;
use super::engine::Engine;
use super::entries;
use super::error::{JournalError, StoreError};
use super::journal::Journal;
use super::live::Live;
use super::lock::{fault, lock};
use super::rules::{self, Decision};
use super::table::{Bytes, Changes, Over, View};

/// A group commit takes no more commands once its events are this long; the journal's bound is far above.
const GROUP_BYTES: usize = 1 << 20;

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
        let live = match Live::open(&view, &journal).and_then(|live| live.caught_up(&journal)) {
            Ok(live) => live,
            Err(StoreError::View { what }) => {
                let aside = move_aside(&view)?;
                tracing::warn!(
                    %what, aside = %aside.display(),
                    "the store's view is unusable; it is rebuilt from the journal"
                );
                Live::open(&view, &journal)?.caught_up(&journal)?
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
        self.live.write().unwrap_or_else(PoisonError::into_inner).refuse_changes();
    }

    /// Does what sled does on a full disk.
    pub(super) fn get_stuck(&self) {
        self.live.write().unwrap_or_else(PoisonError::into_inner).get_stuck();
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
    let live = Live::open(view, &journal)?.caught_up(&journal)?;
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
        self.live.write().unwrap_or_else(PoisonError::into_inner).flush();
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
        self.live.write().unwrap_or_else(PoisonError::into_inner).take(staged, end);
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
