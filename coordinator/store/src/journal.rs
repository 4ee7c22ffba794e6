//! The journal: an append-only file of all events, from which the store can be rebuilt.
//!
//! ```text
//! header  "SLJOURNL"  version u32  id u64  crc32c u32 of the 20 bytes before      (little-endian throughout)
//! frame   length u32  previous u64  check u64  payload
//! ```
//! One frame is one group commit, which is written and synced as a whole. A frame is *good* if its check
//! matches, and *bad* otherwise. The check of a frame is the first eight bytes of the BLAKE3 digest of
//! (offset of the frame u64, length, previous, payload). `previous` is the check of the preceding frame, or
//! the journal's id for the first frame. So all frames form one chain, and old bytes of the file are never
//! accepted as a frame of another position or another history.
//!
//! The watermark (`watermark.rs`) records the acknowledged length and the check of the last frame before this
//! length. A bad frame behind the watermark that no good frame follows is an unfinished write, which was
//! never acknowledged. The journal removes it and logs a warning. Any other bad frame, and a file shorter
//! than the watermark, is damage: opening the journal fails and leaves the file unchanged (`salvage.rs`
//! repairs it on demand).
//!
//! The journal does not interpret payloads. The file grows by a few hundred bytes per tile, and opening it
//! reads all of it. `compaction.rs` replaces a long journal.

use std::io::{self, BufReader, ErrorKind, Read, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::disk::{self, Access, Disk, DiskFile};
use super::error::JournalError;
pub(super) use super::place::{JournalPosition, Numbers};
use super::watermark::{self, Watermark, WatermarkFile};

const MAGIC: &[u8; 8] = b"SLJOURNL";
const VERSION: u32 = 3;
/// The offset of the first frame.
pub(super) const HEADER_BYTES: u64 = 24;
const FRAME_HEADER: u64 = 20;
/// Maximum length of a payload, in bytes. A crash leaves at most one unfinished frame, so a longer unreadable
/// end of the file is damage.
pub(super) const MAX_FRAME_BYTES: usize = 16 << 20;

/// An open journal.
pub(super) struct Journal {
    path: PathBuf,
    file: Box<dyn DiskFile>,
    /// A random number that distinguishes this journal from others.
    id: u64,
    /// The position of the next frame.
    end: JournalPosition,
    /// The watermark file, or `None` for a journal that is not in its place yet.
    marks: Option<WatermarkFile>,
    /// The error after which the content of the file is no longer known.
    unusable: Option<Arc<io::Error>>,
}

impl Journal {
    /// Opens or creates the journal, checks every frame, and removes an unfinished frame at the end.
    ///
    /// `view` is the acknowledged part that the view records. The longer of `view` and the watermark counts.
    ///
    /// # Errors
    /// [`JournalError::Damaged`] if acknowledged frames are damaged or missing. The file then stays
    /// unchanged.
    pub(super) fn open(
        disk: &dyn Disk,
        path: &Path,
        view: Option<Watermark>,
    ) -> Result<Self, JournalError> {
        let mark_path = watermark::path_of(path);
        let marks = watermark::read(disk, &mark_path)?;
        if disk
            .attributes(path)
            .map_err(fault("look for", path))?
            .is_none()
        {
            if marks
                .iter()
                .chain(&view)
                .any(|mark| mark.length > HEADER_BYTES)
            {
                return Err(JournalError::Missing {
                    path: path.to_owned(),
                });
            }
            create(disk, path)?;
            return Self::open(disk, path, None);
        }
        let opened = inspect(disk, path, &marks, view, |_, _| Ok::<_, JournalError>(()))?;
        let Inspected {
            id,
            end,
            length,
            acknowledged,
            damage,
            ..
        } = opened;
        if let Some((offset, what)) = damage {
            return Err(JournalError::Damaged {
                path: path.to_owned(),
                offset,
                what,
                lost: String::new(),
            });
        }
        if end.offset > HEADER_BYTES && !marks.iter().any(|mark| mark.journal == id) {
            tracing::warn!(
                path = %mark_path.display(),
                "the watermark of the journal cannot be read, so a lost end of the journal cannot \
                 be detected; compare the list of jobs with a backup. A new watermark is written"
            );
        }
        let mut file = disk
            .open(path, Access::Update)
            .map_err(fault("open", path))?;
        if end.offset < length {
            tracing::warn!(
                path = %path.display(), bytes = length - end.offset, offset = end.offset,
                "the journal ends in an unfinished write, which was never acknowledged; cutting it \
                 off"
            );
            file.set_length(end.offset)
                .map_err(fault("truncate", path))?;
        }
        let measured = acknowledged.map_or(HEADER_BYTES, |mark| mark.length);
        rewrite(&mut *file, measured, end.offset).map_err(fault("write", path))?;
        let marks = Some(WatermarkFile::open(disk, &mark_path)?);
        let mut this = Self {
            path: path.to_owned(),
            file,
            id,
            end,
            marks,
            unusable: None,
        };
        this.file
            .seek(SeekFrom::Start(end.offset))
            .map_err(fault("seek in", path))?;
        Ok(this)
    }

    /// Begins a new journal at `path`, without a watermark, because the journal is not in its place yet.
    pub(super) fn begin(disk: &dyn Disk, path: &Path) -> Result<Self, JournalError> {
        disk::remove_if_present(disk, path).map_err(fault("remove", path))?;
        let id = random_id(path)?;
        let mut file = disk
            .open(path, Access::Create)
            .map_err(fault("create", path))?;
        file.write_all(&header(id)).map_err(fault("write", path))?;
        let end = JournalPosition {
            offset: HEADER_BYTES,
            chain: id,
        };
        Ok(Self {
            path: path.to_owned(),
            file,
            id,
            end,
            marks: None,
            unusable: None,
        })
    }

    pub(super) fn id(&self) -> u64 {
        self.id
    }

    pub(super) fn end(&self) -> JournalPosition {
        self.end
    }

    /// Appends a frame and returns its end. On success, the frame is durable and the watermark records it.
    ///
    /// After an error, the journal is unchanged, or it is unusable and returns that error for all later
    /// calls.
    pub(super) fn append(
        &mut self,
        payload: &[u8],
        numbers: Numbers,
    ) -> Result<JournalPosition, JournalError> {
        if let Some(source) = &self.unusable {
            return Err(JournalError::Unusable {
                path: self.path.clone(),
                source: source.clone(),
            });
        }
        let Some(length) = u32::try_from(payload.len())
            .ok()
            .filter(|_| payload.len() <= MAX_FRAME_BYTES)
        else {
            let source = Arc::new(io::Error::new(
                ErrorKind::InvalidInput,
                "the frame is too long",
            ));
            return Err(JournalError::Write {
                path: self.path.clone(),
                source,
            });
        };
        let chain = check(self.end, length, payload);
        let mut frame = Vec::with_capacity(payload.len() + FRAME_HEADER as usize);
        frame.extend(length.to_le_bytes());
        frame.extend(self.end.chain.to_le_bytes());
        frame.extend(chain.to_le_bytes());
        frame.extend(payload);
        if let Err(source) = self.file.write_all(&frame) {
            return Err(self.undo(source));
        }
        // After a failed sync the kernel may have dropped the pages and call the next sync a success.
        if let Err(source) = self.file.sync() {
            return Err(self.give_up(source));
        }
        let end = JournalPosition {
            offset: self.end.offset + frame.len() as u64,
            chain,
        };
        if let Err(JournalError::Io { source, .. }) = self.record(end, numbers) {
            // The slot may count although its write failed. So the frame may be removed only after the slot
            // durably records the previous end again: the disk may have any of the slot's contents since the
            // last sync.
            let recorded = self.record(self.end, numbers);
            return Err(match recorded.and_then(|()| self.sync_watermark()) {
                Ok(()) => self.undo(io::Error::new(source.kind(), source)),
                Err(_) => self.give_up(source),
            });
        }
        self.end = end;
        Ok(end)
    }

    fn record(&mut self, end: JournalPosition, numbers: Numbers) -> Result<(), JournalError> {
        let mark = Watermark::new(self.id, end, numbers);
        self.marks
            .as_mut()
            .map_or(Ok(()), |marks| marks.record(&mark))
    }

    /// Records the whole journal as acknowledged. The store calls this after its start, with the numbers of
    /// its state.
    pub(super) fn acknowledge(&mut self, numbers: Numbers) -> Result<(), JournalError> {
        self.record(self.end, numbers)?;
        self.sync_watermark()
    }

    /// Makes the watermark durable. The writer thread calls this while no caller waits.
    pub(super) fn sync_watermark(&mut self) -> Result<(), JournalError> {
        self.marks.as_mut().map_or(Ok(()), WatermarkFile::sync)
    }

    /// Removes a frame that was not written completely, and returns the error of the append.
    fn undo(&mut self, source: io::Error) -> JournalError {
        let at = self.end.offset;
        let undone = self
            .file
            .set_length(at)
            .and_then(|()| self.file.seek(SeekFrom::Start(at)));
        if let Err(undo) = undone.and_then(|_| self.file.sync()) {
            return self.give_up(undo);
        }
        let path = self.path.clone();
        match source.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => JournalError::NoSpace { path },
            _ => JournalError::Write {
                path,
                source: Arc::new(source),
            },
        }
    }

    fn give_up(&mut self, source: impl Into<Arc<io::Error>>) -> JournalError {
        let source = source.into();
        self.unusable = Some(source.clone());
        JournalError::Unusable {
            path: self.path.clone(),
            source,
        }
    }

    /// Moves a journal that [`Journal::begin`] began into its place, over an older one, and records its
    /// watermark.
    ///
    /// A crash leaves one of the two journals, and a watermark of each.
    pub(super) fn install(
        self,
        disk: &dyn Disk,
        place: &Path,
        numbers: Numbers,
    ) -> Result<u64, JournalError> {
        let Self {
            path,
            file,
            id,
            end,
            ..
        } = self;
        file.sync().map_err(fault("sync", &path))?;
        drop(file);
        let mark = Watermark::new(id, end, numbers);
        let mut marks = WatermarkFile::open(disk, &watermark::path_of(place))?;
        marks.record(&mark)?;
        marks.sync()?;
        disk.rename(&path, place)
            .map_err(fault("move into place", place))?;
        if let Some(folder) = place.parent() {
            disk.sync_folder(folder).map_err(fault("sync", folder))?;
        }
        // The other slot still contains the watermark of the older journal.
        marks.record(&mark)?;
        marks.sync()?;
        Ok(end.offset)
    }
}

/// The outcome of reading a whole journal.
pub(super) struct Inspected {
    /// The journal's id.
    pub(super) id: u64,
    /// The end of the good frames.
    pub(super) end: JournalPosition,
    /// The length of the file in bytes.
    pub(super) length: u64,
    /// The acknowledged part, if a watermark or the view records it.
    pub(super) acknowledged: Option<Watermark>,
    /// True if the good frames contain the acknowledged part.
    pub(super) is_met: bool,
    /// The offset and the description of the damage; `None` if the journal is intact.
    pub(super) damage: Option<(u64, String)>,
}

impl Inspected {
    /// Returns the outcome for a missing journal file. If frames of the journal were acknowledged, the
    /// outcome contains damage.
    pub(super) fn missing(marks: &[Watermark], view: Option<Watermark>) -> Self {
        let acknowledged = marks
            .iter()
            .copied()
            .chain(view)
            .max_by_key(|mark| mark.length);
        let acknowledged = acknowledged.filter(|mark| mark.length > HEADER_BYTES);
        let id = acknowledged.map_or(0, |mark| mark.journal);
        let damage = acknowledged.map(|_| (0, "the file is missing".to_owned()));
        let end = JournalPosition {
            offset: HEADER_BYTES,
            chain: id,
        };
        Self {
            id,
            end,
            length: 0,
            acknowledged,
            is_met: false,
            damage,
        }
    }
}

/// Reads a journal without changing it, and calls `visit` for each good frame before the first bad frame.
///
/// `visit` receives the payload and the end of the frame. `marks` are the watermarks of the file, and `view`
/// is the acknowledged part that the view records.
pub(super) fn inspect<E: From<JournalError>>(
    disk: &dyn Disk,
    path: &Path,
    marks: &[Watermark],
    view: Option<Watermark>,
    mut visit: impl FnMut(&[u8], JournalPosition) -> Result<(), E>,
) -> Result<Inspected, E> {
    let mut file = disk.open(path, Access::Read).map_err(fault("open", path))?;
    let length = file
        .seek(SeekFrom::End(0))
        .map_err(fault("measure", path))?;
    file.rewind().map_err(fault("seek in", path))?;
    let header = read_header(&mut *file, path)?;
    // If the header is unreadable, the watermarks still contain the id.
    let id = header
        .as_ref()
        .copied()
        .unwrap_or(marks.first().or(view.as_ref()).map_or(0, |m| m.journal));
    let ours = marks
        .iter()
        .copied()
        .chain(view)
        .filter(|mark| mark.journal == id);
    let acknowledged = ours.max_by_key(|mark| mark.length);
    let mut damage = header.err().map(|what| (0, what));
    let start = JournalPosition {
        offset: HEADER_BYTES,
        chain: id,
    };
    let mut frames = Frames {
        path,
        reader: BufReader::new(file),
        at: start,
        length: length.max(HEADER_BYTES),
    };
    let is_acknowledged =
        |end: JournalPosition| acknowledged.is_some_and(|mark| mark.place() == end);
    let mut is_met = is_acknowledged(start);
    let bad = loop {
        match frames.next()? {
            Next::Frame(payload) => {
                visit(&payload, frames.at)?;
                is_met |= is_acknowledged(frames.at);
            }
            Next::End => break None,
            Next::Bad(what) => break Some(what),
        }
    };
    let end = frames.at;
    let mut damaged = |what: String| {
        damage.get_or_insert((end.offset, what));
    };
    match acknowledged {
        // A journal gets its watermark before its name, so a missing watermark is damage.
        None => damaged("the watermark of the journal is missing".to_owned()),
        Some(mark) if mark.length > end.offset => {
            damaged(
                bad.clone()
                    .unwrap_or_else(|| format!("the file ends before byte {}", mark.length)),
            );
        }
        Some(_) if !is_met => damaged("the frames differ from the acknowledged frames".to_owned()),
        Some(_) => {}
    }
    if let Some(what) = bad
        && is_followed_by_frame(disk, path, end.offset, length)?
    {
        damaged(what);
    }
    Ok(Inspected {
        id,
        end,
        length,
        acknowledged,
        is_met,
        damage,
    })
}

/// Calls `visit` for each frame at or after `from` in an open journal. Only the first `length` bytes of the
/// journal are read.
///
/// The file may be longer than `length`. `visit` also receives the end of the frame. Returns false without a
/// call if no frame of this journal begins or ends at `from`.
pub(super) fn replay<E: From<JournalError>>(
    disk: &dyn Disk,
    path: &Path,
    from: JournalPosition,
    length: u64,
    mut visit: impl FnMut(&[u8], JournalPosition) -> Result<(), E>,
) -> Result<bool, E> {
    let mut file = disk.open(path, Access::Read).map_err(fault("open", path))?;
    let id = read_header(&mut *file, path)?;
    let damaged = |offset, what| JournalError::Damaged {
        path: path.to_owned(),
        offset,
        what,
        lost: String::new(),
    };
    let id = id.map_err(|what| damaged(0, what))?;
    let at = JournalPosition {
        offset: HEADER_BYTES,
        chain: id,
    };
    let mut frames = Frames {
        path,
        reader: BufReader::new(file),
        at,
        length,
    };
    let mut reached = false;
    loop {
        let begins = frames.at;
        if begins.offset > from.offset && !reached {
            return Ok(false);
        }
        reached |= begins == from;
        match frames.next()? {
            Next::Frame(payload) if reached => visit(&payload, frames.at)?,
            Next::Frame(_) => {}
            Next::End => return Ok(reached),
            // Every frame was good when the journal was opened.
            Next::Bad(what) => return Err(damaged(begins.offset, what).into()),
        }
    }
}

/// Calls `visit` for every good frame that begins at or after the offset `from`.
///
/// `visit` receives the payload, the beginning and the end of the frame. Bytes between good frames are
/// skipped.
pub(super) fn scattered_frames<E: From<JournalError>>(
    disk: &dyn Disk,
    path: &Path,
    from: u64,
    mut visit: impl FnMut(&[u8], JournalPosition, JournalPosition) -> Result<(), E>,
) -> Result<(), E> {
    let mut file = disk.open(path, Access::Read).map_err(fault("open", path))?;
    file.seek(SeekFrom::Start(from))
        .map_err(fault("seek in", path))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(fault("read", path))?;
    let mut at = 0;
    while at < bytes.len() {
        match frame_at(&bytes[at..], from + at as u64) {
            Some((payload, begins, end)) => {
                visit(payload, begins, end)?;
                at = (end.offset - from) as usize;
            }
            None => at += 1,
        }
    }
    Ok(())
}

/// Returns the frame that begins at `offset`, if it is good: its payload, its beginning and its end.
fn frame_at(bytes: &[u8], offset: u64) -> Option<(&[u8], JournalPosition, JournalPosition)> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (previous, rest) = rest.split_first_chunk::<8>()?;
    let (found, rest) = rest.split_first_chunk::<8>()?;
    let length = u32::from_le_bytes(*length);
    let payload = rest
        .get(..length as usize)
        .filter(|_| length > 0 && length as usize <= MAX_FRAME_BYTES)?;
    let begins = JournalPosition {
        offset,
        chain: u64::from_le_bytes(*previous),
    };
    let chain = check(begins, length, payload);
    let end = JournalPosition {
        offset: offset + FRAME_HEADER + u64::from(length),
        chain,
    };
    (chain == u64::from_le_bytes(*found)).then_some((payload, begins, end))
}

/// Writes the bytes of a file between two offsets again, and syncs the file.
///
/// After a failed sync, the page cache still contains the bytes, but the system treats their pages as clean,
/// so no later sync writes them. A frame behind the watermark may have been left so by an earlier process.
fn rewrite(file: &mut dyn DiskFile, from: u64, to: u64) -> io::Result<()> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(from))?;
    file.take(to.saturating_sub(from)).read_to_end(&mut bytes)?;
    file.seek(SeekFrom::Start(from))?;
    file.write_all(&bytes)?;
    file.sync()
}

fn fault(doing: &'static str, path: &Path) -> impl Fn(io::Error) -> JournalError {
    let path = path.to_owned();
    move |source| JournalError::Io {
        doing,
        path: path.clone(),
        source: Arc::new(source),
    }
}

/// Computes the check of a frame that begins at this position.
fn check(begins: JournalPosition, length: u32, payload: &[u8]) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher
        .update(&begins.offset.to_le_bytes())
        .update(&length.to_le_bytes());
    hasher.update(&begins.chain.to_le_bytes()).update(payload);
    let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
    u64::from_le_bytes([a, b, c, d, e, f, g, h])
}

fn random_id(path: &Path) -> Result<u64, JournalError> {
    getrandom::u64()
        .map_err(|e| fault("draw a random id for", path)(io::Error::other(e.to_string())))
}

fn header(id: u64) -> Vec<u8> {
    let mut header = MAGIC.to_vec();
    header.extend(VERSION.to_le_bytes());
    header.extend(id.to_le_bytes());
    header.extend(crc32c::crc32c(&header).to_le_bytes());
    header
}

/// Creates an empty journal with its watermark. The watermark comes first: a journal without one is damaged.
fn create(disk: &dyn Disk, path: &Path) -> Result<(), JournalError> {
    let journal = Journal::begin(disk, &path.with_extension("new"))?;
    journal.install(
        disk,
        path,
        Numbers {
            next_job: 1,
            epoch: 0,
        },
    )?;
    Ok(())
}

/// Reads the header, and returns the journal's id or the description of the header's fault.
///
/// # Errors
/// [`JournalError::BadHeader`] if another version wrote the file.
fn read_header(file: &mut dyn DiskFile, path: &Path) -> Result<Result<u64, String>, JournalError> {
    let mut bytes = Vec::new();
    file.take(HEADER_BYTES)
        .read_to_end(&mut bytes)
        .map_err(fault("read", path))?;
    let Some((magic, rest)) = bytes
        .split_first_chunk::<8>()
        .filter(|_| bytes.len() as u64 == HEADER_BYTES)
    else {
        return Ok(Err("the file is shorter than a header".to_owned()));
    };
    let field = |at: usize| {
        rest.get(at..)
            .and_then(|rest| rest.first_chunk::<4>())
            .copied()
            .unwrap_or_default()
    };
    if field(12) != crc32c::crc32c(&bytes[..20]).to_le_bytes() {
        return Ok(Err("the checksum of the header does not match".to_owned()));
    }
    if magic != MAGIC || field(0) != VERSION.to_le_bytes() {
        let what = format!(
            "expected version {VERSION}, found {}",
            u32::from_le_bytes(field(0))
        );
        return Err(JournalError::BadHeader {
            path: path.to_owned(),
            what,
        });
    }
    Ok(Ok(rest
        .get(4..)
        .and_then(|rest| rest.first_chunk::<8>())
        .copied()
        .map_or(0, u64::from_le_bytes)))
}

enum Next {
    Frame(Vec<u8>),
    End,
    Bad(String),
}

/// A reader of the frames of one chain, in order.
struct Frames<'a> {
    path: &'a Path,
    reader: BufReader<Box<dyn DiskFile>>,
    at: JournalPosition,
    length: u64,
}

impl Frames<'_> {
    fn next(&mut self) -> Result<Next, JournalError> {
        let left = self.length.saturating_sub(self.at.offset);
        if left == 0 {
            return Ok(Next::End);
        }
        if left < FRAME_HEADER {
            return Ok(Next::Bad(format!(
                "the last {left} bytes are too few for a frame"
            )));
        }
        let mut frame = vec![0; FRAME_HEADER as usize];
        self.fill(&mut frame)?;
        let length = frame
            .first_chunk::<4>()
            .copied()
            .map_or(0, u32::from_le_bytes);
        if length == 0
            || length as usize > MAX_FRAME_BYTES
            || u64::from(length) > left - FRAME_HEADER
        {
            return Ok(Next::Bad(format!(
                "the frame header announces {length} bytes, but the file has {left} more bytes"
            )));
        }
        frame.resize(FRAME_HEADER as usize + length as usize, 0);
        self.fill(&mut frame[FRAME_HEADER as usize..])?;
        match frame_at(&frame, self.at.offset) {
            Some((_, begins, end)) if begins == self.at => self.at = end,
            Some(_) => {
                return Ok(Next::Bad(
                    "the frame does not continue the one before".to_owned(),
                ));
            }
            None => {
                return Ok(Next::Bad(
                    "the check of the frame does not match".to_owned(),
                ));
            }
        }
        frame.drain(..FRAME_HEADER as usize);
        Ok(Next::Frame(frame))
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), JournalError> {
        self.reader
            .read_exact(bytes)
            .map_err(fault("read", self.path))
    }
}

/// Returns true if the bad frame at the offset `bad` was written completely before: a good frame follows the
/// bad frame, or the file is longer than one unfinished write leaves it.
fn is_followed_by_frame(
    disk: &dyn Disk,
    path: &Path,
    bad: u64,
    length: u64,
) -> Result<bool, JournalError> {
    // One unfinished write leaves at most this number of bytes.
    if length.saturating_sub(bad) > FRAME_HEADER + MAX_FRAME_BYTES as u64 {
        return Ok(true);
    }
    let mut found = false;
    scattered_frames(disk, path, bad + 1, |_, _, _| {
        found = true;
        Ok::<_, JournalError>(())
    })?;
    Ok(found)
}

#[cfg(test)]
#[path = "journal_tests.rs"]
mod tests;
