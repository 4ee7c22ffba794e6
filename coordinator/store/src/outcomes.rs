//! The outcomes of the phases of unfinished tiles. Another worker continues a tile from them after its worker
//! is lost.
//!
//! Each tile has a file of frames: length, BLAKE3 hash, bytes. Files are not synced and frames are not
//! acknowledged. If an outcome is lost or damaged, a worker computes it and all later outcomes again. The
//! outcome of a phase does not depend on the worker, so frames are only appended.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek as _, SeekFrom, Take, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sightline_numbers::ids::PhaseIndex;
use sightline_records::ids::{JobId, TileIndex};

/// Length of a frame's header (length and hash), in bytes.
const HEADER: u64 = 8 + 32;
/// Maximum length of an outcome, in bytes.
pub const MAX_OUTCOME_BYTES: u64 = 1 << 30;

type Tile = (JobId, TileIndex);

/// The stored outcomes of all unfinished tiles.
pub struct Outcomes {
    /// The directory of the files, or `None` to store no outcomes.
    directory: Option<PathBuf>,
    /// The files of the tiles with outcomes. Each file has its own lock, so that a slow disk delays the crew
    /// of only one tile at a time.
    files: Mutex<BTreeMap<Tile, Arc<Mutex<Ends>>>>,
}

/// The ends of a file's frames as offsets in bytes; `None` before the file is read. The last offset is the
/// end of the last complete frame.
type Ends = Option<Vec<u64>>;

/// The length and the hash of an outcome, which precede it in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutcomeHeader {
    /// The length in bytes.
    pub length: u64,
    /// The BLAKE3 hash.
    pub hash: blake3::Hash,
}

impl Outcomes {
    /// Creates outcomes in a directory. The first stored outcome creates the directory.
    pub fn in_directory(directory: PathBuf) -> Self {
        Self {
            directory: Some(directory),
            files: Mutex::default(),
        }
    }

    /// Creates outcomes that are never stored.
    pub fn nowhere() -> Self {
        Self {
            directory: None,
            files: Mutex::default(),
        }
    }

    /// Returns the number of stored outcomes of a tile.
    pub fn count(&self, tile: Tile) -> u32 {
        let Some(path) = self.path(tile) else {
            return 0;
        };
        let file = self.file(tile);
        let count = read(&mut lock(&file), &path).len() as u32;
        if count == 0 {
            self.let_go(tile, &file);
        }
        count
    }

    /// Stores the outcome of a tile's next phase or of an earlier phase. Returns true if it is stored.
    ///
    /// A different outcome of an earlier phase replaces the stored one and removes the outcomes of later
    /// phases. If the disk is full, the function returns false.
    pub fn push(&self, tile: Tile, phase: PhaseIndex, bytes: &[u8]) -> bool {
        self.push_from(
            tile,
            phase,
            OutcomeHeader {
                length: bytes.len() as u64,
                hash: blake3::hash(bytes),
            },
            &mut &*bytes,
        )
    }

    /// Stores an outcome as [`Outcomes::push`] does, from a reader of bytes with this length and hash.
    pub fn push_from(
        &self,
        tile: Tile,
        phase: PhaseIndex,
        header: OutcomeHeader,
        bytes: &mut dyn Read,
    ) -> bool {
        if phase.0 < self.count(tile) && self.is_stored(tile, phase, header) {
            return true;
        }
        let Some(path) = self.path(tile) else {
            return false;
        };
        let file = self.file(tile);
        let kept = append(&mut lock(&file), tile, &path, phase, header, bytes);
        if !kept {
            self.let_go(tile, &file);
        }
        kept
    }

    /// Opens an outcome of a tile and checks its hash. Returns `None` if it is missing or damaged.
    pub fn open(&self, tile: Tile, phase: PhaseIndex) -> Option<(u64, Take<File>)> {
        let mut file = self.at(tile, phase)?;
        let header = read_header(&mut file)?;
        let start = file.stream_position().ok()?;
        if !is_whole(&mut file, header) {
            return None;
        }
        file.seek(SeekFrom::Start(start)).ok()?;
        Some((header.length, file.take(header.length)))
    }

    /// Returns true if the stored outcome of a phase has this length and hash.
    fn is_stored(&self, tile: Tile, phase: PhaseIndex, header: OutcomeHeader) -> bool {
        let Some(mut file) = self.at(tile, phase) else {
            return false;
        };
        read_header(&mut file) == Some(header) && is_whole(&mut file, header)
    }

    /// Opens the file of a tile at the beginning of a phase's frame.
    fn at(&self, tile: Tile, phase: PhaseIndex) -> Option<File> {
        if phase.0 >= self.count(tile) {
            return None;
        }
        let start = match phase.at() {
            0 => 0,
            at => {
                let file = lock(&self.files).get(&tile).cloned()?;
                *lock(&file).as_ref()?.get(at - 1)?
            }
        };
        let mut file = File::open(self.path(tile)?).ok()?;
        file.seek(SeekFrom::Start(start)).ok()?;
        Some(file)
    }

    /// Removes the outcomes of a tile.
    pub fn remove(&self, tile: Tile) {
        // A crew that still uses the tile finds no file and stores no further outcomes.
        let file = lock(&self.files).remove(&tile);
        let mut ends = file.as_deref().map(lock);
        ends.iter_mut().for_each(|ends| **ends = None);
        if let Some(path) = self.path(tile)
            && let Err(e) = std::fs::remove_file(&path)
            && e.kind() != std::io::ErrorKind::NotFound
        {
            tracing::warn!("{} cannot be removed: {e}", path.display());
        }
    }

    /// Removes the outcomes of all tiles for which `is_needed` returns false.
    pub fn sweep(&self, is_needed: impl Fn(JobId, TileIndex) -> bool) {
        let Some(directory) = &self.directory else {
            return;
        };
        // The directory does not exist before the first outcome.
        let Ok(entries) = std::fs::read_dir(directory) else {
            return;
        };
        for entry in entries.flatten() {
            let name = entry.file_name();
            let numbers = name.to_str().and_then(|name| name.split_once('.'));
            let tile = numbers.and_then(|(job, tile)| {
                Some((JobId(job.parse().ok()?), TileIndex(tile.parse().ok()?)))
            });
            if let Some(tile) = tile.filter(|&(job, tile)| !is_needed(job, tile)) {
                self.remove(tile);
            }
        }
    }

    /// Evicts a tile without outcomes from the map unless another thread holds its entry.
    fn let_go(&self, tile: Tile, file: &Arc<Mutex<Ends>>) {
        let mut files = lock(&self.files);
        // The map and the caller hold the two references. Other threads can get one only through the map.
        if Arc::strong_count(file) == 2 && lock(file).as_ref().is_none_or(Vec::is_empty) {
            files.remove(&tile);
        }
    }

    fn file(&self, tile: Tile) -> Arc<Mutex<Ends>> {
        Arc::clone(lock(&self.files).entry(tile).or_default())
    }

    fn path(&self, tile: Tile) -> Option<PathBuf> {
        let (job, index) = tile;
        self.directory
            .as_ref()
            .map(|d| d.join(format!("{job}.{index}")))
    }
}

/// Appends an outcome to a tile's file after the outcome of the preceding phase. Returns true if the outcome
/// is stored.
fn append(
    ends: &mut Ends,
    tile: Tile,
    path: &Path,
    phase: PhaseIndex,
    header: OutcomeHeader,
    bytes: &mut dyn Read,
) -> bool {
    let OutcomeHeader { length, hash } = header;
    let ends = read(ends, path);
    if phase.at() > ends.len() || length > MAX_OUTCOME_BYTES {
        return false;
    }
    ends.truncate(phase.at());
    let start = ends.last().copied().unwrap_or(0);
    let written = path
        .parent()
        .map_or(Ok(()), std::fs::create_dir_all)
        .and_then(|()| {
            let mut file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(false)
                .open(path)?;
            // An unfinished frame may follow the last complete frame.
            file.set_len(start)?;
            file.seek(SeekFrom::Start(start))?;
            file.write_all(&length.to_le_bytes())?;
            file.write_all(hash.as_bytes())?;
            std::io::copy(&mut bytes.take(length), &mut file)
        });
    match written {
        Ok(written) if written == length => {
            ends.push(start + HEADER + length);
            true
        }
        Ok(written) => {
            tracing::warn!(
                "the outcome of phase {phase} of tile {} of job {} ended after {written} bytes",
                tile.1,
                tile.0
            );
            false
        }
        Err(e) => {
            tracing::warn!(
                "the outcome of phase {phase} of tile {} of job {} cannot be stored: {e}",
                tile.1,
                tile.0
            );
            false
        }
    }
}

/// Returns the ends of a file's frames. The first call reads the file.
fn read<'a>(ends: &'a mut Ends, path: &Path) -> &'a mut Vec<u64> {
    ends.get_or_insert_with(|| File::open(path).map_or_else(|_| Vec::new(), whole_frames))
}

/// Locks a mutex, even after a panic: changes under the locks are complete before any code can panic.
fn lock<T>(what: &Mutex<T>) -> MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads the length and the hash of the frame that begins at the position of a file.
fn read_header(file: &mut File) -> Option<OutcomeHeader> {
    let (mut length, mut hash) = ([0; 8], [0; 32]);
    file.read_exact(&mut length).ok()?;
    file.read_exact(&mut hash).ok()?;
    let length = u64::from_le_bytes(length);
    (length <= MAX_OUTCOME_BYTES).then(|| OutcomeHeader {
        length,
        hash: blake3::Hash::from_bytes(hash),
    })
}

/// Reads the bytes of a frame, buffer by buffer. Returns true if they have this length and hash.
fn is_whole(file: &mut File, header: OutcomeHeader) -> bool {
    let OutcomeHeader { length, hash } = header;
    let mut hasher = blake3::Hasher::new();
    let read = hasher.update_reader(file.take(length));
    read.is_ok() && hasher.count() == length && hasher.finalize() == hash
}

/// Returns the ends of the complete frames at the beginning of a file.
fn whole_frames(mut file: File) -> Vec<u64> {
    let (mut ends, mut end) = (Vec::new(), 0);
    while let Some(header) = read_header(&mut file)
        && is_whole(&mut file, header)
    {
        end += HEADER + header.length;
        ends.push(end);
    }
    ends
}

#[cfg(test)]
mod tests {
    use super::*;

    const TILE: Tile = (JobId(3), TileIndex(7));

    impl Outcomes {
        /// Reads an outcome.
        fn get(&self, tile: Tile, phase: PhaseIndex) -> Option<Vec<u8>> {
            let (length, mut from) = self.open(tile, phase)?;
            let mut bytes = Vec::new();
            from.read_to_end(&mut bytes).unwrap();
            assert_eq!(bytes.len() as u64, length);
            Some(bytes)
        }
    }

    #[test]
    fn outcomes_are_restored_up_to_first_damaged_one() {
        let directory = tempfile::tempdir().unwrap();
        let open = || Outcomes::in_directory(directory.path().join("crews"));
        let outcomes = open();
        assert_eq!(outcomes.count(TILE), 0);
        assert!(!outcomes.push(TILE, PhaseIndex(1), b"not the next one"));
        assert!(
            outcomes.push(TILE, PhaseIndex(0), b"wrong")
                && outcomes.push(TILE, PhaseIndex(1), b"behind it")
        );
        assert!(outcomes.push(TILE, PhaseIndex(0), b"first"));
        assert_eq!(outcomes.count(TILE), 1);
        assert!(
            outcomes.push(TILE, PhaseIndex(1), b"")
                && outcomes.push(TILE, PhaseIndex(1), b"")
                && outcomes.push(TILE, PhaseIndex(0), b"first")
        );
        assert!(outcomes.push(TILE, PhaseIndex(2), b"third"));
        let path = directory.path().join("crews").join("3.7");
        let all = std::fs::read(&path).unwrap();
        for kept in 0..=all.len() {
            std::fs::write(&path, &all[..kept]).unwrap();
            let again = open();
            let whole = [45, 85, 130].iter().filter(|end| **end <= kept).count() as u32;
            assert_eq!(again.count(TILE), whole, "{kept} bytes");
            let expected = [&b"first"[..], b"", b"third"];
            for phase in 0..4 {
                let here = (phase < whole).then(|| expected[phase as usize].to_vec());
                assert_eq!(again.get(TILE, PhaseIndex(phase)), here);
            }
            assert!(again.push(TILE, PhaseIndex(whole), b"next"));
            assert_eq!(
                open().get(TILE, PhaseIndex(whole)).as_deref(),
                Some(&b"next"[..])
            );
        }
        std::fs::write(&path, &all).unwrap();
        let mut damaged = all.clone();
        damaged[60] ^= 1;
        std::fs::write(&path, &damaged).unwrap();
        assert_eq!(open().count(TILE), 1);
        // A length above the maximum must not cause an allocation.
        damaged[..8].fill(0xff);
        std::fs::write(&path, &damaged).unwrap();
        assert_eq!(open().count(TILE), 0);
    }

    #[test]
    fn sweep_removes_outcomes_of_unneeded_tiles() {
        let directory = tempfile::tempdir().unwrap();
        let outcomes = Outcomes::in_directory(directory.path().to_owned());
        outcomes.sweep(|_, _| false);
        for (job, tile) in [(1, 0), (2, 0), (2, 1), (3, 0)] {
            assert!(outcomes.push((JobId(job), TileIndex(tile)), PhaseIndex(0), b"x"));
        }
        std::fs::write(directory.path().join("a note of a person"), b"stays").unwrap();
        outcomes.sweep(|job, tile| job == JobId(2) && tile == TileIndex(0));
        let mut left: Vec<String> = std::fs::read_dir(directory.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        left.sort();
        assert_eq!(left, ["2.0", "a note of a person"]);
        outcomes.remove((JobId(2), TileIndex(0)));
        assert_eq!(outcomes.count((JobId(2), TileIndex(0))), 0);
        // Tiles without outcomes use no memory.
        assert!(!outcomes.push(TILE, PhaseIndex(1), b"not the next one"));
        assert_eq!(
            (outcomes.count(TILE), outcomes.get(TILE, PhaseIndex(0))),
            (0, None)
        );
        assert!(lock(&outcomes.files).is_empty());
        assert!(!Outcomes::nowhere().push(TILE, PhaseIndex(0), b"x"));
    }
}
