//! The outcomes of the phases of unfinished tiles, so that a tile goes on where its worker was lost.
//!
//! Each tile has a file of frames: length, BLAKE3 hash, bytes. Files are not synced and frames are not
//! acknowledged: an outcome that is lost or damaged is computed again, and so are those behind it. The
//! outcomes of a phase are equal whoever computed them, so frames are only ever appended.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek as _, SeekFrom, Take, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sightline_records::ids::{JobId, TileIndex};

/// Length and hash before the bytes of a frame.
const HEADER: u64 = 8 + 32;
/// Most bytes of an outcome.
pub const MAX_OUTCOME_BYTES: u64 = 1 << 30;

type Tile = (JobId, TileIndex);

/// The outcomes of tiles.
pub struct Outcomes {
    /// `None` keeps nothing.
    directory: Option<PathBuf>,
    /// The files of the tiles that have outcomes. Each has its own lock, so that a slow disk delays one
    /// tile's crew at a time.
    files: Mutex<BTreeMap<Tile, Arc<Mutex<Ends>>>>,
}

/// Where the frames of a file end, once it was read. The last number is the end of the file.
type Ends = Option<Vec<u64>>;

impl Outcomes {
    /// The outcomes in a directory, which is created when the first one is kept.
    pub fn of(directory: PathBuf) -> Self {
        Self {
            directory: Some(directory),
            files: Mutex::default(),
        }
    }

    /// Keeps nothing.
    pub fn nowhere() -> Self {
        Self {
            directory: None,
            files: Mutex::default(),
        }
    }

    /// Number of outcomes of a tile.
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

    /// Stores the outcome of a tile's next phase, or of an earlier one, which replaces another one and those
    /// behind it. Returns true if the outcome is stored now; a full disk returns false.
    pub fn push(&self, tile: Tile, phase: u32, bytes: &[u8]) -> bool {
        self.push_from(
            tile,
            phase,
            (bytes.len() as u64, blake3::hash(bytes)),
            &mut &*bytes,
        )
    }

    /// Stores an outcome as [`Outcomes::push`] does, from a reader of bytes with this length and this hash.
    pub fn push_from(
        &self,
        tile: Tile,
        phase: u32,
        of: (u64, blake3::Hash),
        bytes: &mut dyn Read,
    ) -> bool {
        if phase < self.count(tile) && self.is_stored(tile, phase, of) {
            return true;
        }
        let (Some(path), Some(directory)) = (self.path(tile), &self.directory) else {
            return false;
        };
        let file = self.file(tile);
        let kept = append(&mut lock(&file), tile, (directory, &path), phase, of, bytes);
        if !kept {
            self.let_go(tile, &file);
        }
        kept
    }

    /// Opens an outcome of a tile, whose hash was checked; `None` when it is not there or damaged.
    pub fn open(&self, tile: Tile, phase: u32) -> Option<(u64, Take<File>)> {
        let mut file = self.at(tile, phase)?;
        let (length, hash) = header(&mut file)?;
        let start = file.stream_position().ok()?;
        if !is_whole(&mut file, length, hash) {
            return None;
        }
        file.seek(SeekFrom::Start(start)).ok()?;
        Some((length, file.take(length)))
    }

    /// Returns true if a stored outcome has this length and this hash.
    fn is_stored(&self, tile: Tile, phase: u32, of: (u64, blake3::Hash)) -> bool {
        let Some(mut file) = self.at(tile, phase) else {
            return false;
        };
        header(&mut file) == Some(of) && is_whole(&mut file, of.0, of.1)
    }

    /// Opens the file of a tile where the frame of a phase begins.
    fn at(&self, tile: Tile, phase: u32) -> Option<File> {
        if phase >= self.count(tile) {
            return None;
        }
        let start = match phase {
            0 => 0,
            _ => {
                let file = lock(&self.files).get(&tile).cloned()?;
                *lock(&file).as_ref()?.get(phase as usize - 1)?
            }
        };
        let mut file = File::open(self.path(tile)?).ok()?;
        file.seek(SeekFrom::Start(start)).ok()?;
        Some(file)
    }

    /// Forgets the outcomes of a tile.
    pub fn remove(&self, tile: Tile) {
        // A crew that is at it finds the file gone and keeps nothing more.
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

    /// Forgets the outcomes of all jobs for which `is_needed` says no.
    pub fn sweep(&self, is_needed: impl Fn(JobId) -> bool) {
        let Some(directory) = &self.directory else {
            return;
        };
        // There is no directory before the first outcome.
        let Ok(entries) = std::fs::read_dir(directory) else {
            return;
        };
        for entry in entries.flatten() {
            let name = entry.file_name();
            let numbers = name.to_str().and_then(|name| name.split_once('.'));
            let tile = numbers.and_then(|(job, tile)| {
                Some((JobId(job.parse().ok()?), TileIndex(tile.parse().ok()?)))
            });
            if let Some(tile) = tile.filter(|(job, _)| !is_needed(*job)) {
                self.remove(tile);
            }
        }
    }

    /// Keeps nothing in memory of a tile without outcomes that nobody else is at: tiles come and go.
    fn let_go(&self, tile: Tile, file: &Arc<Mutex<Ends>>) {
        let mut files = lock(&self.files);
        // The list's and the caller's. Others can come to it by the list alone.
        if Arc::strong_count(file) == 2 && lock(file).as_ref().is_none_or(Vec::is_empty) {
            files.remove(&tile);
        }
    }

    fn file(&self, tile: Tile) -> Arc<Mutex<Ends>> {
        Arc::clone(lock(&self.files).entry(tile).or_default())
    }

    fn path(&self, (job, tile): Tile) -> Option<PathBuf> {
        self.directory
            .as_ref()
            .map(|d| d.join(format!("{job}.{tile}")))
    }
}

/// Puts an outcome into the file of a tile, behind that of the phase before; returns whether it is there now.
fn append(
    ends: &mut Ends,
    tile: Tile,
    (directory, path): (&Path, &Path),
    phase: u32,
    (length, hash): (u64, blake3::Hash),
    bytes: &mut dyn Read,
) -> bool {
    let ends = read(ends, path);
    if phase as usize > ends.len() || length > MAX_OUTCOME_BYTES {
        return false;
    }
    ends.truncate(phase as usize);
    let start = ends.last().copied().unwrap_or(0);
    let written = std::fs::create_dir_all(directory).and_then(|()| {
        let mut file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)?;
        // Behind the last whole frame there may be a part of one.
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
                "phase {phase} of tile {} of job {} ended after {written} bytes",
                tile.1,
                tile.0
            );
            false
        }
        Err(e) => {
            tracing::warn!(
                "phase {phase} of tile {} of job {} is not kept: {e}",
                tile.1,
                tile.0
            );
            false
        }
    }
}

/// Where the frames of a file end, which is read the first time.
fn read<'a>(ends: &'a mut Ends, path: &Path) -> &'a mut Vec<u64> {
    ends.get_or_insert_with(|| File::open(path).map_or_else(|_| Vec::new(), whole_frames))
}

/// Locks something whose changes are whole before anything can panic.
fn lock<T>(what: &Mutex<T>) -> MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads the length and the hash of the frame that begins at the position of a file.
fn header(file: &mut File) -> Option<(u64, blake3::Hash)> {
    let (mut length, mut hash) = ([0; 8], [0; 32]);
    file.read_exact(&mut length).ok()?;
    file.read_exact(&mut hash).ok()?;
    let length = u64::from_le_bytes(length);
    (length <= MAX_OUTCOME_BYTES).then(|| (length, blake3::Hash::from_bytes(hash)))
}

/// Reads the bytes of a frame, one buffer at a time, and returns true if they have this length and this hash.
fn is_whole(file: &mut File, length: u64, hash: blake3::Hash) -> bool {
    let mut hasher = blake3::Hasher::new();
    let read = hasher.update_reader(file.take(length));
    read.is_ok() && hasher.count() == length && hasher.finalize() == hash
}

/// The ends of the whole frames at the beginning of a file.
fn whole_frames(mut file: File) -> Vec<u64> {
    let (mut ends, mut end) = (Vec::new(), 0);
    while let Some((length, hash)) = header(&mut file)
        && is_whole(&mut file, length, hash)
    {
        end += HEADER + length;
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
        fn get(&self, tile: Tile, phase: u32) -> Option<Vec<u8>> {
            let (length, mut from) = self.open(tile, phase)?;
            let mut bytes = Vec::new();
            from.read_to_end(&mut bytes).unwrap();
            assert_eq!(bytes.len() as u64, length);
            Some(bytes)
        }
    }

    #[test]
    fn outcomes_are_there_again_up_to_the_first_damaged_one() {
        let directory = tempfile::tempdir().unwrap();
        let open = || Outcomes::of(directory.path().join("crews"));
        let outcomes = open();
        assert_eq!(outcomes.count(TILE), 0);
        assert!(!outcomes.push(TILE, 1, b"not the next one"));
        assert!(outcomes.push(TILE, 0, b"wrong") && outcomes.push(TILE, 1, b"behind it"));
        assert!(outcomes.push(TILE, 0, b"first"));
        assert_eq!(outcomes.count(TILE), 1);
        assert!(
            outcomes.push(TILE, 1, b"")
                && outcomes.push(TILE, 1, b"")
                && outcomes.push(TILE, 0, b"first")
        );
        assert!(outcomes.push(TILE, 2, b"third"));
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
                assert_eq!(again.get(TILE, phase), here);
            }
            assert!(again.push(TILE, whole, b"next"));
            assert_eq!(open().get(TILE, whole).as_deref(), Some(&b"next"[..]));
        }
        std::fs::write(&path, &all).unwrap();
        let mut damaged = all.clone();
        damaged[60] ^= 1;
        std::fs::write(&path, &damaged).unwrap();
        assert_eq!(open().count(TILE), 1);
        // A length that nothing can have is no reason to allocate.
        damaged[..8].fill(0xff);
        std::fs::write(&path, &damaged).unwrap();
        assert_eq!(open().count(TILE), 0);
    }

    #[test]
    fn what_no_job_needs_is_removed() {
        let directory = tempfile::tempdir().unwrap();
        let outcomes = Outcomes::of(directory.path().to_owned());
        outcomes.sweep(|_| false);
        for job in 1..4 {
            assert!(outcomes.push((JobId(job), TileIndex(0)), 0, b"x"));
        }
        std::fs::write(directory.path().join("a note of a person"), b"stays").unwrap();
        outcomes.sweep(|job| job == JobId(2));
        let mut left: Vec<String> = std::fs::read_dir(directory.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        left.sort();
        assert_eq!(left, ["2.0", "a note of a person"]);
        outcomes.remove((JobId(2), TileIndex(0)));
        assert_eq!(outcomes.count((JobId(2), TileIndex(0))), 0);
        // Tiles without outcomes leave nothing in memory.
        assert!(!outcomes.push(TILE, 1, b"not the next one"));
        assert_eq!((outcomes.count(TILE), outcomes.get(TILE, 0)), (0, None));
        assert!(lock(&outcomes.files).is_empty());
        assert!(!Outcomes::nowhere().push(TILE, 0, b"x"));
    }
}
