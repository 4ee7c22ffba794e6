//! A simulated disk for tests: a power failure loses, reorders or tears unsynced writes. Writes can fail,
//! fill the disk, or reach another place.
//!
//! A file has durable bytes and operations that are not synced yet. At a power failure each sector of an
//! unsynced write and each unsynced name survives or is lost, by the random numbers of the seed. A failed
//! sync drops operations permanently, as Linux does. All decisions come from one generator, so that a
//! schedule is a function of its seed.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use sightline_numbers::random::SplitMix64;

use super::api::{Access, Attributes, Disk, DiskFile};

const SECTOR: usize = 512;

/// The frequency of each fault: one in the given number of operations fails, at random. 0 means never.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// The mean number of reads per read that fails with EIO.
    pub read: u64,
    /// The mean number of writes per write that fails with EIO after a part was written.
    pub write: u64,
    /// The mean number of syncs per sync that fails with EIO.
    pub sync: u64,
    /// The mean number of writes per write that reaches another place of the same or of another file, and
    /// reports success. At most one happens, because two can erase a frame together with every record of it.
    pub misdirected: u64,
}

/// The numbers of faults that happened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// The number of reads that failed.
    pub failed_reads: u64,
    /// The number of writes that failed.
    pub failed_writes: u64,
    /// The number of syncs that failed.
    pub failed_syncs: u64,
    /// The number of writes that met a full disk.
    pub full: u64,
    /// The number of misdirected writes.
    pub misdirected: u64,
    /// The number of power failures.
    pub power_failures: u64,
    /// The number of lost unsynced operations: sectors of writes, changes of lengths, and names.
    pub lost: u64,
}

impl Counts {
    /// Adds the counts of another disk.
    pub fn add(&mut self, other: &Self) {
        self.failed_reads += other.failed_reads;
        self.failed_writes += other.failed_writes;
        self.failed_syncs += other.failed_syncs;
        self.full += other.full;
        self.misdirected += other.misdirected;
        self.power_failures += other.power_failures;
        self.lost += other.lost;
    }
}

#[derive(Clone, Debug)]
enum Change {
    Write(usize, Vec<u8>),
    Length(usize),
}

impl Change {
    fn apply(&self, to: &mut Vec<u8>) {
        match self {
            Self::Write(at, bytes) => {
                if to.len() < at + bytes.len() {
                    to.resize(at + bytes.len(), 0);
                }
                to[*at..at + bytes.len()].copy_from_slice(bytes);
            }
            Self::Length(length) => to.resize(*length, 0),
        }
    }
}

#[derive(Clone, Debug, Default)]
struct Content {
    /// The bytes after a power failure that loses everything unsynced.
    durable: Vec<u8>,
    /// The bytes that programs see.
    seen: Vec<u8>,
    /// The changes that lead from `durable` to `seen`.
    unsynced: Vec<Change>,
    modified: u64,
    /// The offset of a sector that cannot be read.
    unreadable: Option<usize>,
}

/// The target of a name: a file, by its number, or a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Node {
    File(usize),
    Folder,
}

#[derive(Clone, Debug)]
enum NameChange {
    Set(PathBuf, Node),
    Remove(PathBuf),
    Move(PathBuf, PathBuf, Node),
}

impl NameChange {
    fn apply(&self, names: &mut BTreeMap<PathBuf, Node>) {
        match self {
            Self::Set(path, node) => drop(names.insert(path.clone(), *node)),
            Self::Remove(path) => drop(names.remove(path)),
            Self::Move(from, to, node) => {
                names.remove(from);
                names.insert(to.clone(), *node);
            }
        }
    }

    fn is_in(&self, folder: &Path) -> bool {
        let (Self::Set(path, _) | Self::Remove(path) | Self::Move(_, path, _)) = self;
        path.parent() == Some(folder)
    }
}

struct State {
    random: SplitMix64,
    files: Vec<Content>,
    durable: BTreeMap<PathBuf, Node>,
    seen: BTreeMap<PathBuf, Node>,
    unsynced: Vec<NameChange>,
    faults: Faults,
    /// The number of bytes that still fit; `None` for no limit.
    room: Option<u64>,
    off: bool,
    clock: u64,
    counts: Counts,
}

/// A simulated disk. Clones share it.
#[derive(Clone)]
pub struct SimulatedDisk(Arc<Mutex<State>>);

impl std::fmt::Debug for SimulatedDisk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SimulatedDisk")
    }
}

fn io_error() -> io::Error {
    // EIO.
    io::Error::from_raw_os_error(5)
}

impl State {
    fn one_in(&mut self, n: u64) -> bool {
        n > 0 && self.random.bits().is_multiple_of(n)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.random.bits() % n.max(1) as u64) as usize
    }

    fn on(&self) -> io::Result<()> {
        if self.off { Err(io_error()) } else { Ok(()) }
    }

    fn file(&self, path: &Path) -> io::Result<usize> {
        match self.seen.get(path) {
            Some(Node::File(number)) => Ok(*number),
            Some(Node::Folder) => Err(ErrorKind::IsADirectory.into()),
            None => Err(ErrorKind::NotFound.into()),
        }
    }

    fn change_name(&mut self, change: NameChange) {
        change.apply(&mut self.seen);
        self.unsynced.push(change);
    }

    fn change(&mut self, file: usize, change: Change) {
        self.clock += 1;
        let content = &mut self.files[file];
        change.apply(&mut content.seen);
        content.unsynced.push(change);
        content.modified = self.clock;
    }

    fn write(&mut self, file: usize, at: usize, bytes: &[u8]) -> io::Result<usize> {
        self.on()?;
        let mut bytes = bytes.to_vec();
        let mut error = None;
        let rate = self.faults.write;
        if self.one_in(rate) {
            self.counts.failed_writes += 1;
            bytes.truncate(self.random.bits() as usize % (bytes.len() + 1));
            error = Some(io_error());
        }
        let grows = (at + bytes.len()).saturating_sub(self.files[file].seen.len()) as u64;
        if let Some(room) = self.room.filter(|room| *room < grows) {
            self.counts.full += 1;
            bytes.truncate(bytes.len() - (grows - room) as usize);
            error = Some(ErrorKind::StorageFull.into());
        }
        let grows = (at + bytes.len()).saturating_sub(self.files[file].seen.len()) as u64;
        self.room = self.room.map(|room| room - grows);
        let rate = self.faults.misdirected;
        if error.is_none() && self.counts.misdirected == 0 && self.one_in(rate) {
            // The page cache is correct, but the disk writes the bytes to another place.
            self.counts.misdirected += 1;
            let victim = if self.one_in(2) {
                file
            } else {
                self.below(self.files.len())
            };
            let length = self.files[victim].durable.len();
            let elsewhere = self.below(length.max(1)) / SECTOR * SECTOR;
            let end = (elsewhere + bytes.len()).min(length);
            self.files[victim].durable[elsewhere.min(end)..end]
                .copy_from_slice(&bytes[..end - elsewhere.min(end)]);
            self.clock += 1;
            let length = self.files[file].seen.len().max(at + bytes.len());
            let content = &mut self.files[file];
            Change::Write(at, bytes.clone()).apply(&mut content.seen);
            // Only the length of the file reaches the disk.
            content.unsynced.push(Change::Length(length));
            content.modified = self.clock;
            return Ok(bytes.len());
        }
        let length = bytes.len();
        if length > 0 {
            self.change(file, Change::Write(at, bytes));
        }
        error.map_or(Ok(length), Err)
    }

    fn sync(&mut self, file: usize) -> io::Result<()> {
        self.on()?;
        let changes = std::mem::take(&mut self.files[file].unsynced);
        let rate = self.faults.sync;
        let fails = self.one_in(rate);
        for change in changes {
            // The kernel drops the pages of a failed sync and marks them clean.
            if !fails || self.one_in(2) {
                change.apply(&mut self.files[file].durable);
            }
        }
        if fails {
            self.counts.failed_syncs += 1;
            return Err(io_error());
        }
        Ok(())
    }

    /// Makes every unsynced operation durable or drops it.
    fn power_failure(&mut self) {
        self.counts.power_failures += 1;
        // Depending on the mood, a failure loses all unsynced operations, none, or a part.
        let mood = self.below(4);
        for file in 0..self.files.len() {
            for change in std::mem::take(&mut self.files[file].unsynced) {
                let pieces = match change {
                    Change::Write(at, bytes) => sectors(at, &bytes),
                    length @ Change::Length(_) => vec![length],
                };
                for piece in pieces {
                    if mood == 1 || mood > 1 && self.one_in(2) {
                        piece.apply(&mut self.files[file].durable);
                    } else {
                        self.counts.lost += 1;
                    }
                }
            }
            self.files[file].seen = self.files[file].durable.clone();
        }
        for change in std::mem::take(&mut self.unsynced) {
            if mood == 1 || mood > 1 && self.one_in(2) {
                change.apply(&mut self.durable);
            } else {
                self.counts.lost += 1;
            }
        }
        // A name in a lost folder is lost, too.
        let folders: Vec<PathBuf> = self
            .durable
            .iter()
            .filter(|(_, node)| **node == Node::Folder)
            .map(|(p, _)| p.clone())
            .collect();
        self.durable.retain(|path, _| {
            path.ancestors()
                .skip(1)
                .all(|a| a.parent().is_none() || folders.iter().any(|f| f == a))
        });
        self.seen = self.durable.clone();
    }
}

/// Splits a write at the boundaries of sectors.
fn sectors(mut at: usize, mut bytes: &[u8]) -> Vec<Change> {
    let mut pieces = Vec::new();
    while !bytes.is_empty() {
        let (piece, rest) = bytes.split_at((SECTOR - at % SECTOR).min(bytes.len()));
        pieces.push(Change::Write(at, piece.to_vec()));
        at += piece.len();
        bytes = rest;
    }
    pieces
}

impl SimulatedDisk {
    /// Creates an empty disk without faults.
    pub fn new(seed: u64) -> Self {
        Self(Arc::new(Mutex::new(State {
            random: SplitMix64::named(&[seed, 2]),
            files: Vec::new(),
            durable: BTreeMap::new(),
            seen: BTreeMap::new(),
            unsynced: Vec::new(),
            faults: Faults::default(),
            room: None,
            off: false,
            clock: 0,
            counts: Counts::default(),
        })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the frequency of each fault from now on.
    pub fn set_faults(&self, faults: Faults) {
        self.state().faults = faults;
    }

    /// Limits the number of bytes that can still be written; `None` for no limit.
    pub fn set_room(&self, room: Option<u64>) {
        self.state().room = room;
    }

    /// Returns the counts of faults so far.
    pub fn counts(&self) -> Counts {
        self.state().counts
    }

    /// Makes the content of a file durable, as an idle store does with its watermark.
    pub fn settle(&self, path: &Path) {
        let mut state = self.state();
        if let Some(Node::File(number)) = state.seen.get(path).copied() {
            let content = &mut state.files[number];
            content.durable.clone_from(&content.seen);
            content.unsynced.clear();
        }
    }

    /// Makes the sector that contains the byte at `at` unreadable.
    #[cfg(test)]
    pub fn spoil(&self, path: &Path, at: usize) {
        let mut state = self.state();
        if let Some(Node::File(number)) = state.seen.get(path).copied() {
            state.files[number].unreadable = Some(at / SECTOR * SECTOR);
        }
    }

    /// Switches the power off: every operation fails until [`SimulatedDisk::power_on`].
    pub fn power_off(&self) {
        let mut state = self.state();
        state.off = true;
        state.power_failure();
    }

    /// Switches the power on.
    pub fn power_on(&self) {
        self.state().off = false;
    }

    /// Changes one bit of a nonempty durable file. Returns false if no such file exists.
    pub fn flip_bit(&self) -> bool {
        let mut state = self.state();
        let files: Vec<usize> = (0..state.files.len())
            .filter(|f| {
                !state.files[*f].durable.is_empty()
                    && state.seen.values().any(|n| *n == Node::File(*f))
            })
            .collect();
        if files.is_empty() {
            return false;
        }
        let file = files[state.below(files.len())];
        let length = state.files[file].durable.len();
        let (at, bit) = (state.below(length), state.below(8));
        state.files[file].durable[at] ^= 1 << bit;
        if let Some(byte) = state.files[file].seen.get_mut(at) {
            *byte ^= 1 << bit;
        }
        true
    }
}

struct SimulatedFile {
    disk: SimulatedDisk,
    number: usize,
    at: u64,
    writes: bool,
}

impl Read for SimulatedFile {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let mut state = self.disk.state();
        state.on()?;
        let rate = state.faults.read;
        if state.one_in(rate) {
            state.counts.failed_reads += 1;
            return Err(io_error());
        }
        let Content {
            seen, unreadable, ..
        } = &state.files[self.number];
        let at = self.at as usize;
        let rest = seen.get(at..).unwrap_or_default();
        let mut length = rest.len().min(to.len());
        if let Some(bad) = *unreadable
            && bad < at + length
            && at < bad + SECTOR
        {
            length = bad.saturating_sub(at);
            if length == 0 {
                return Err(io_error());
            }
        }
        to[..length].copy_from_slice(&rest[..length]);
        self.at += length as u64;
        Ok(length)
    }
}

impl Write for SimulatedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if !self.writes {
            return Err(ErrorKind::PermissionDenied.into());
        }
        let written = self
            .disk
            .state()
            .write(self.number, self.at as usize, bytes)?;
        self.at += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for SimulatedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let length = self.disk.state().files[self.number].seen.len() as u64;
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::End(by) => length.saturating_add_signed(by),
            SeekFrom::Current(by) => self.at.saturating_add_signed(by),
        };
        Ok(self.at)
    }
}

impl DiskFile for SimulatedFile {
    fn sync(&self) -> io::Result<()> {
        self.disk.state().sync(self.number)
    }

    fn set_length(&self, length: u64) -> io::Result<()> {
        let mut state = self.disk.state();
        state.on()?;
        state.change(self.number, Change::Length(length as usize));
        Ok(())
    }
}

impl Disk for SimulatedDisk {
    fn open(&self, path: &Path, access: Access) -> io::Result<Box<dyn DiskFile>> {
        let mut state = self.state();
        state.on()?;
        let number = match (state.file(path), access) {
            (Ok(_), Access::Create) => return Err(ErrorKind::AlreadyExists.into()),
            (Err(e), Access::Create) if e.kind() == ErrorKind::NotFound => {
                if path
                    .parent()
                    .is_some_and(|p| state.seen.get(p) != Some(&Node::Folder))
                {
                    return Err(ErrorKind::NotFound.into());
                }
                if state.room == Some(0) {
                    state.counts.full += 1;
                    return Err(ErrorKind::StorageFull.into());
                }
                state.files.push(Content::default());
                let number = state.files.len() - 1;
                state.change_name(NameChange::Set(path.to_owned(), Node::File(number)));
                number
            }
            (found, _) => found?,
        };
        drop(state);
        Ok(Box::new(SimulatedFile {
            disk: self.clone(),
            number,
            at: 0,
            writes: access != Access::Read,
        }))
    }

    fn attributes(&self, path: &Path) -> io::Result<Option<Attributes>> {
        let state = self.state();
        state.on()?;
        match state.file(path) {
            Ok(number) => {
                let content = &state.files[number];
                let modified = SystemTime::UNIX_EPOCH + Duration::from_secs(content.modified);
                Ok(Some(Attributes {
                    length: content.seen.len() as u64,
                    modified,
                }))
            }
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            Err(e) => Err(e),
        }
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.on()?;
        let folders: Vec<PathBuf> = path.ancestors().map(Path::to_owned).collect();
        for folder in folders
            .into_iter()
            .rev()
            .filter(|folder| folder.parent().is_some())
        {
            if !state.seen.contains_key(&folder) {
                state.change_name(NameChange::Set(folder, Node::Folder));
            }
        }
        Ok(())
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let state = self.state();
        state.on()?;
        if state.seen.get(folder) != Some(&Node::Folder) {
            return Err(ErrorKind::NotFound.into());
        }
        Ok(state
            .seen
            .keys()
            .filter(|path| path.parent() == Some(folder))
            .cloned()
            .collect())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.on()?;
        let node = Node::File(state.file(from)?);
        state.change_name(NameChange::Move(from.to_owned(), to.to_owned(), node));
        Ok(())
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.on()?;
        let node = Node::File(state.file(from)?);
        state.change_name(NameChange::Set(to.to_owned(), node));
        Ok(())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.on()?;
        let number = state.file(path)?;
        let freed = state.files[number].seen.len() as u64;
        state.room = state.room.map(|room| room.saturating_add(freed));
        state.change_name(NameChange::Remove(path.to_owned()));
        Ok(())
    }

    fn date(&self, path: &Path, time: SystemTime) -> io::Result<()> {
        let mut state = self.state();
        state.on()?;
        let number = state.file(path)?;
        let since = time
            .duration_since(SystemTime::UNIX_EPOCH)
            .unwrap_or_default();
        state.files[number].modified = since.as_secs();
        Ok(())
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.on()?;
        let rate = state.faults.sync;
        let fails = state.one_in(rate);
        let (synced, rest): (Vec<_>, Vec<_>) = std::mem::take(&mut state.unsynced)
            .into_iter()
            .partition(|change| change.is_in(folder));
        state.unsynced = rest;
        for change in synced {
            if fails && state.one_in(2) {
                state.unsynced.push(change);
            } else {
                change.apply(&mut state.durable);
            }
        }
        if fails {
            state.counts.failed_syncs += 1;
            return Err(io_error());
        }
        Ok(())
    }
}
