//! The journal: an append-only file of all events, from which the store can be rebuilt.
//!
//! ```text
//! header  "SLJOURNL"  version u32  id u64  crc32c u32 of the 20 bytes before      (little-endian throughout)
//! frame   length u32  crc32c u32 of (offset of the frame u64, length u32, payload)  payload
//! ```
//! One frame is one group commit, written and synced as a whole. Its checksum covers its offset, so that old
//! bytes of the file are never taken for a frame elsewhere. A bad frame without a good one after it is an
//! unfinished, unacknowledged write: it is cut off, with a warning. A bad frame with a good one after it is
//! damage, which only a person may repair: the journal is refused.
//!
//! The journal does not interpret payloads. The file grows by a few hundred bytes a tile, and opening it
//! reads all of it; `compaction.rs` replaces one that has grown long.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::JournalError;

const MAGIC: &[u8; 8] = b"SLJOURNL";
const VERSION: u32 = 1;
/// Where the first frame begins.
pub(super) const HEADER_BYTES: u64 = 24;
const FRAME_HEADER: u64 = 8;
/// Longest payload. Also the most a crash can leave behind, so a longer bad end is damage.
pub(super) const MAX_FRAME_BYTES: usize = 16 << 20;

/// The file as the journal writes it; the tests put a full disk in its place.
pub(super) trait LogFile: Send {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
    fn sync(&mut self) -> io::Result<()>;
    /// Cuts the file; the next append goes to its new end.
    fn truncate(&mut self, length: u64) -> io::Result<()>;
}

impl LogFile for File {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.seek(SeekFrom::Start(length)).map(|_| ())
    }
}

/// An open journal.
pub(super) struct Journal {
    path: PathBuf,
    file: Box<dyn LogFile>,
    /// A random number that tells this journal from others.
    id: u64,
    /// The offset of the next frame.
    end: u64,
    /// Set when the content of the file is no longer known.
    unusable: Option<Arc<io::Error>>,
}

impl Journal {
    /// Opens or creates the journal, checks every frame, and removes an unfinished frame at the end.
    pub(super) fn open(path: &Path) -> Result<Self, JournalError> {
        if !path.try_exists().map_err(fault("look for", path))? {
            create(path)?;
        }
        let mut file = OpenOptions::new().read(true).write(true).open(path).map_err(fault("open", path))?;
        let length = file.metadata().map_err(fault("measure", path))?.len();
        let id = read_header(&mut file, path)?;
        let mut frames = Frames { path, reader: BufReader::new(&file), offset: HEADER_BYTES, length };
        let bad = loop {
            match frames.next()? {
                Next::Frame(_) => {}
                Next::End => break None,
                Next::Bad(what) => break Some(what),
            }
        };
        let end = frames.offset;
        if let Some(what) = bad {
            refuse_damage(&mut file, path, end, length, what)?;
        }
        if end < length {
            tracing::warn!(
                path = %path.display(), bytes = length - end, offset = end,
                "the journal ends in an unfinished write, which was never acknowledged; cutting it off"
            );
            file.set_len(end).map_err(fault("truncate", path))?;
            file.sync_all().map_err(fault("sync", path))?;
        }
        file.seek(SeekFrom::Start(end)).map_err(fault("seek in", path))?;
        Ok(Self { path: path.to_owned(), file: Box::new(file), id, end, unusable: None })
    }

    pub(super) fn id(&self) -> u64 {
        self.id
    }

    pub(super) fn end(&self) -> u64 {
        self.end
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Appends a frame; the frame is on the disk when this returns its end. After an error the journal is as
    /// before, or it is unusable and returns that error from then on.
    pub(super) fn append(&mut self, payload: &[u8]) -> Result<u64, JournalError> {
        if let Some(source) = &self.unusable {
            return Err(JournalError::Unusable { path: self.path.clone(), source: source.clone() });
        }
        let Some(length) = u32::try_from(payload.len()).ok().filter(|_| payload.len() <= MAX_FRAME_BYTES)
        else {
            let source = Arc::new(io::Error::new(ErrorKind::InvalidInput, "the frame is too long"));
            return Err(JournalError::Write { path: self.path.clone(), source });
        };
        let mut frame = Vec::with_capacity(payload.len() + FRAME_HEADER as usize);
        frame.extend(length.to_le_bytes());
        frame.extend(checksum(self.end, length, payload).to_le_bytes());
        frame.extend(payload);
        if let Err(source) = self.file.append(&frame) {
            if let Err(undo) = self.file.truncate(self.end).and_then(|()| self.file.sync()) {
                return Err(self.give_up(undo));
            }
            let path = self.path.clone();
            return Err(match source.kind() {
                ErrorKind::StorageFull | ErrorKind::QuotaExceeded => JournalError::NoSpace { path },
                _ => JournalError::Write { path, source: Arc::new(source) },
            });
        }
        // After a failed sync the kernel may have dropped the pages and call the next sync a success.
        if let Err(source) = self.file.sync() {
            return Err(self.give_up(source));
        }
        self.end += frame.len() as u64;
        Ok(self.end)
    }

    fn give_up(&mut self, source: io::Error) -> JournalError {
        let source = Arc::new(source);
        self.unusable = Some(source.clone());
        JournalError::Unusable { path: self.path.clone(), source }
    }
}

/// Calls `visit` for the payloads of all frames from `from` on, each with the offset of the frame's end, in
/// the first `length` bytes of an open journal, which may grow meanwhile. Returns `false` without a call if
/// no frame begins or ends at `from`.
pub(super) fn replay<E: From<JournalError>>(
    path: &Path,
    from: u64,
    length: u64,
    mut visit: impl FnMut(&[u8], u64) -> Result<(), E>,
) -> Result<bool, E> {
    let mut file = File::open(path).map_err(fault("open", path))?;
    file.seek(SeekFrom::Start(HEADER_BYTES)).map_err(fault("seek in", path))?;
    let mut frames = Frames { path, reader: BufReader::new(&file), offset: HEADER_BYTES, length };
    let mut reached = false;
    loop {
        let begins = frames.offset;
        if begins > from && !reached {
            return Ok(false);
        }
        reached |= begins == from;
        match frames.next()? {
            Next::Frame(payload) if begins >= from => visit(&payload, frames.offset)?,
            Next::Frame(_) => {}
            Next::End => return Ok(reached),
            // Every frame was good when the journal was opened.
            Next::Bad(what) => {
                return Err(JournalError::Corrupt { path: path.to_owned(), offset: begins, what }.into());
            }
        }
    }
}

fn fault(doing: &'static str, path: &Path) -> impl Fn(io::Error) -> JournalError {
    let path = path.to_owned();
    move |source| JournalError::Io { doing, path: path.clone(), source: Arc::new(source) }
}

fn checksum(offset: u64, length: u32, payload: &[u8]) -> u32 {
    let crc = crc32c::crc32c(&offset.to_le_bytes());
    crc32c::crc32c_append(crc32c::crc32c_append(crc, &length.to_le_bytes()), payload)
}

/// Writes an empty journal beside its place and moves it there, so that a journal always has a whole header.
fn create(path: &Path) -> Result<(), JournalError> {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let seed = [now.as_nanos().to_le_bytes().as_slice(), &std::process::id().to_le_bytes()].concat();
    let mut header = MAGIC.to_vec();
    header.extend(VERSION.to_le_bytes());
    header.extend(&blake3::hash(&seed).as_bytes()[..8]);
    header.extend(crc32c::crc32c(&header).to_le_bytes());
    let beside = path.with_extension("new");
    let mut file = File::create(&beside).map_err(fault("create", &beside))?;
    file.write_all(&header).and_then(|()| file.sync_all()).map_err(fault("write", &beside))?;
    std::fs::rename(&beside, path).map_err(fault("move into place", path))?;
    if let Some(directory) = path.parent() {
        File::open(directory).and_then(|d| d.sync_all()).map_err(fault("sync", directory))?;
    }
    Ok(())
}

/// Checks the header; returns the journal's id.
fn read_header(file: &mut File, path: &Path) -> Result<u64, JournalError> {
    let bad = |what: &str| JournalError::BadHeader { path: path.to_owned(), what: what.to_owned() };
    let mut header = [0; HEADER_BYTES as usize];
    file.read_exact(&mut header).map_err(|e| match e.kind() {
        ErrorKind::UnexpectedEof => bad("it is shorter than a header"),
        _ => fault("read", path)(e),
    })?;
    let mut at = header.as_slice();
    let mut field = |length| at.split_off(..length).unwrap_or_default().to_vec();
    let (magic, version, id, crc) = (field(8), field(4), field(8), field(4));
    if magic != MAGIC {
        return Err(bad("it begins otherwise"));
    }
    if crc != crc32c::crc32c(&header[..20]).to_le_bytes() {
        return Err(bad("its header's checksum does not match"));
    }
    if version != VERSION.to_le_bytes() {
        return Err(bad("it is of another version"));
    }
    Ok(id.try_into().map(u64::from_le_bytes).unwrap_or_default())
}

enum Next {
    Frame(Vec<u8>),
    End,
    Bad(String),
}

/// Reads the frames in order.
struct Frames<'a> {
    path: &'a Path,
    reader: BufReader<&'a File>,
    offset: u64,
    length: u64,
}

impl Frames<'_> {
    fn next(&mut self) -> Result<Next, JournalError> {
        let left = self.length.saturating_sub(self.offset);
        if left == 0 {
            return Ok(Next::End);
        }
        if left < FRAME_HEADER {
            return Ok(Next::Bad("too short for a frame".to_owned()));
        }
        let (mut length, mut crc) = ([0; 4], [0; 4]);
        self.fill(&mut length)?;
        self.fill(&mut crc)?;
        let length = u32::from_le_bytes(length);
        if length == 0 || length as usize > MAX_FRAME_BYTES || u64::from(length) > left - FRAME_HEADER {
            return Ok(Next::Bad(format!("a frame of {length} bytes where {left} are left")));
        }
        let mut payload = vec![0; length as usize];
        self.fill(&mut payload)?;
        if u32::from_le_bytes(crc) != checksum(self.offset, length, &payload) {
            return Ok(Next::Bad("its checksum does not match".to_owned()));
        }
        self.offset += FRAME_HEADER + u64::from(length);
        Ok(Next::Frame(payload))
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), JournalError> {
        self.reader.read_exact(bytes).map_err(fault("read", self.path))
    }
}

/// Distinguishes an unfinished write at the end, which is removed, from damage, which is an error.
fn refuse_damage(
    file: &mut File,
    path: &Path,
    bad: u64,
    length: u64,
    what: String,
) -> Result<(), JournalError> {
    let damage = || JournalError::Corrupt { path: path.to_owned(), offset: bad, what: what.clone() };
    let left = length.saturating_sub(bad);
    if left > FRAME_HEADER + MAX_FRAME_BYTES as u64 {
        return Err(damage());
    }
    let mut tail = Vec::new();
    file.seek(SeekFrom::Start(bad)).map_err(fault("seek in", path))?;
    file.take(left).read_to_end(&mut tail).map_err(fault("read", path))?;
    for at in 1..tail.len() {
        let Some((length, rest)) = tail[at..].split_first_chunk::<4>() else { break };
        let Some((crc, rest)) = rest.split_first_chunk::<4>() else { break };
        let length = u32::from_le_bytes(*length);
        if length == 0 {
            continue;
        }
        if let Some(payload) = rest.get(..length as usize)
            && u32::from_le_bytes(*crc) == checksum(bad + at as u64, length, payload)
        {
            return Err(damage());
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "journal_tests.rs"]
mod tests;
