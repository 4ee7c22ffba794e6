//! The event log: events of jobs, tiles and workers with their times, for users.
//!
//! The last events are in memory (`recent.rs`). All events are appended to a file whose last one or two
//! pieces are kept, so that events survive a restart. No state is derived from them: a crash may lose the
//! events of the last moment, and a full disk all events from then on.

mod recent;

use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use sightline_records::ids::{JobId, Lease, TileIndex};
use tokio::sync::watch;

use self::recent::Recent;

/// Maximum length of a text, in bytes. Longer texts are cut, because workers send reasons of any length.
const MOST_TEXT: usize = 500;
/// The length at which a piece of the file ends, in bytes.
const PIECE_BYTES: u64 = 16 << 20;
/// Maximum number of bytes that wait to be written. Further events are only in memory.
const MOST_UNWRITTEN: usize = 4 << 20;
/// The names of the growing piece and of the previous piece.
const PIECES: [&str; 2] = ["events.jsonl", "events.1.jsonl"];

/// The kind of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum EventKind {
    Submitted,
    Job,
    Leased,
    Round,
    Done,
    TakenBack,
    Failed,
    SetAside,
    Conflict,
    Worker,
    Coordinator,
    Check,
}

impl EventKind {
    /// All kinds of events, in their order.
    const ALL: [Self; 12] = [
        Self::Submitted,
        Self::Job,
        Self::Leased,
        Self::Round,
        Self::Done,
        Self::TakenBack,
        Self::Failed,
        Self::SetAside,
        Self::Conflict,
        Self::Worker,
        Self::Coordinator,
        Self::Check,
    ];
}

/// An event without a number and a time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct LogEvent {
    pub(crate) kind: EventKind,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) job: Option<JobId>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) tile: Option<TileIndex>,
    /// The name of the worker, or an empty string.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub(crate) worker: String,
    pub(crate) text: String,
}

impl LogEvent {
    /// Creates an event without a job.
    pub(crate) fn new(kind: EventKind, text: impl Into<String>) -> Self {
        Self {
            kind,
            job: None,
            tile: None,
            worker: String::new(),
            text: text.into(),
        }
    }

    /// Creates an event of a job.
    pub(crate) fn of_job(kind: EventKind, job: JobId, text: impl Into<String>) -> Self {
        Self {
            job: Some(job),
            ..Self::new(kind, text)
        }
    }

    /// Creates an event of a leased tile.
    pub(crate) fn of_lease(kind: EventKind, lease: &Lease, text: impl Into<String>) -> Self {
        Self {
            tile: Some(lease.tile),
            ..Self::of_job(kind, lease.job, text)
        }
    }

    /// Returns the event with the name of a worker.
    pub(crate) fn on(self, worker: impl Into<String>) -> Self {
        Self {
            worker: worker.into(),
            ..self
        }
    }
}

/// An event with its number and time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Entry {
    pub(crate) number: u64,
    /// The time in milliseconds since 1970.
    pub(crate) at_ms: u64,
    #[serde(flatten)]
    pub(crate) what: LogEvent,
}

/// The events in memory.
#[derive(Default)]
struct EventMemory {
    recent: Recent,
    /// The lines that are not yet written to the file.
    unwritten: Vec<u8>,
}

/// The event log.
pub(crate) struct EventLog {
    kept: Mutex<EventMemory>,
    /// The number of the last event, for followers.
    grown: watch::Sender<u64>,
    /// The directory of the log file. `None`: events are stored only in memory.
    directory: Option<PathBuf>,
    /// The growing piece of the file, once it is open.
    piece: Mutex<Option<File>>,
}

impl EventLog {
    /// Creates an event log without a file.
    pub(crate) fn in_memory() -> Self {
        Self {
            kept: Mutex::default(),
            grown: watch::Sender::new(0),
            directory: None,
            piece: Mutex::new(None),
        }
    }

    /// Opens the event log in a directory, which is created with the first event. Lines that cannot be read
    /// are skipped and logged.
    pub(crate) fn open(directory: PathBuf) -> Self {
        let mut kept = EventMemory::default();
        for piece in PIECES.iter().rev() {
            read(&directory.join(piece), &mut kept);
        }
        let grown = watch::Sender::new(kept.recent.last());
        Self {
            kept: Mutex::new(kept),
            grown,
            directory: Some(directory),
            piece: Mutex::new(None),
        }
    }

    /// Records an event, without blocking on the disk.
    pub(crate) fn record(&self, at_ms: u64, mut what: LogEvent) {
        cut(&mut what.text);
        let mut kept = self.kept();
        let entry = Entry {
            number: kept.recent.last() + 1,
            at_ms,
            what,
        };
        if self.directory.is_some() && kept.unwritten.len() < MOST_UNWRITTEN {
            // Texts and numbers can always be encoded as JSON.
            if let Ok(line) = serde_json::to_string(&entry) {
                kept.unwritten.extend(line.as_bytes());
                kept.unwritten.push(b'\n');
            }
        }
        kept.recent.push(&entry);
        self.grown.send_replace(entry.number);
    }

    /// Returns at most `most` events with higher numbers than `after`, ascending, of one job or of all jobs.
    /// The second value is the last inspected number.
    pub(crate) fn after(&self, job: Option<JobId>, after: u64, most: usize) -> (Vec<Entry>, u64) {
        self.kept().recent.after(job, after, most)
    }

    /// Returns the number after which a job has its last `most` events.
    pub(crate) fn before_last(&self, job: JobId, most: usize) -> u64 {
        self.kept().recent.before_last(job, most)
    }

    /// Subscribes to the number of the last event.
    pub(crate) fn grown(&self) -> watch::Receiver<u64> {
        self.grown.subscribe()
    }

    /// Returns true if events wait to be written.
    pub(crate) fn has_unwritten(&self) -> bool {
        !self.kept().unwritten.is_empty()
    }

    /// Appends the unwritten events to the file.
    pub(crate) fn write(&self) {
        let Some(directory) = &self.directory else {
            return;
        };
        let mut piece = self.piece.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes = std::mem::take(&mut self.kept().unwritten);
        if bytes.is_empty() {
            return;
        }
        if let Err(e) = append(directory, &mut piece, &bytes) {
            *piece = None;
            tracing::warn!("events are not written to {}: {e}", directory.display());
        }
    }

    fn kept(&self) -> MutexGuard<'_, EventMemory> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Cuts a text to the maximum length.
fn cut(text: &mut String) {
    if text.len() > MOST_TEXT {
        let end = (0..=MOST_TEXT)
            .rev()
            .find(|end| text.is_char_boundary(*end));
        text.truncate(end.unwrap_or(0));
        text.push('…');
    }
}

/// Reads the events of a piece of the file into memory.
fn read(path: &Path, kept: &mut EventMemory) {
    let Ok(file) = File::open(path) else { return };
    let mut unread = 0;
    // A damaged piece may be longer than a written one.
    let mut lines = BufReader::new(std::io::Read::take(file, 2 * PIECE_BYTES)).split(b'\n');
    while let Some(Ok(line)) = lines.next() {
        if line.is_empty() {
            continue;
        }
        match serde_json::from_slice::<Entry>(&line) {
            // If events are missing in the file, `push` drops the events before the gap.
            Ok(entry) => kept.recent.push(&entry),
            Err(_) => unread += 1,
        }
    }
    if unread > 0 {
        tracing::warn!(
            "{}: {unread} lines are not events and are skipped",
            path.display()
        );
    }
}

/// Appends to the growing piece, and starts another piece if the length exceeds the limit.
fn append(directory: &Path, piece: &mut Option<File>, bytes: &[u8]) -> std::io::Result<()> {
    let [growing, before] = PIECES.map(|name| directory.join(name));
    if piece.is_none() {
        std::fs::create_dir_all(directory)?;
        let mut file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&growing)?;
        // The newline ends a line that a crash left unfinished.
        if file.metadata()?.len() > 0 {
            file.write_all(b"\n")?;
        }
        *piece = Some(file);
    }
    let Some(file) = piece else { return Ok(()) };
    file.write_all(bytes)?;
    if file.metadata()?.len() >= PIECE_BYTES {
        *piece = None;
        std::fs::rename(&growing, &before)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(n: u64) -> LogEvent {
        LogEvent::of_job(EventKind::Job, JobId(n % 3), format!("event {n}"))
    }

    #[test]
    fn events_survive_restart_and_numbers_continue() {
        let directory = tempfile::tempdir().unwrap();
        for run in 0..3 {
            let event_log = EventLog::open(directory.path().to_owned());
            (0..10).for_each(|n| event_log.record(run * 100 + n, event(run * 10 + n)));
            event_log.write();
            let (all, last) = event_log.after(None, 0, usize::MAX);
            let numbers: Vec<u64> = all.iter().map(|e| e.number).collect();
            assert_eq!(numbers, (1..=(run + 1) * 10).collect::<Vec<_>>());
            assert_eq!(last, (run + 1) * 10);
            assert!(
                all.iter()
                    .all(|e| e.what.text == format!("event {}", e.number - 1))
            );
        }
    }

    #[test]
    fn torn_line_affects_only_itself() {
        let directory = tempfile::tempdir().unwrap();
        let event_log = EventLog::open(directory.path().to_owned());
        (0..4).for_each(|n| event_log.record(n, event(n)));
        event_log.write();
        let file = directory.path().join(PIECES[0]);
        let mut bytes = std::fs::read(&file).unwrap();
        bytes.truncate(bytes.len() - 9);
        std::fs::write(&file, &bytes).unwrap();
        let again = EventLog::open(directory.path().to_owned());
        again.record(9, event(9));
        again.write();
        let third = EventLog::open(directory.path().to_owned());
        let texts = |c: &EventLog| {
            c.after(None, 0, 99)
                .0
                .iter()
                .map(|e| e.what.text.clone())
                .collect::<Vec<_>>()
        };
        assert_eq!(texts(&third), ["event 0", "event 1", "event 2", "event 9"]);
    }

    #[test]
    fn page_returns_start_of_next_page() {
        let event_log = EventLog::in_memory();
        (0..9).for_each(|n| event_log.record(n, event(n)));
        let (mut after, mut found) = (0, Vec::new());
        loop {
            let (page, next) = event_log.after(Some(JobId(1)), after, 2);
            found.extend(page.iter().map(|e| e.number));
            if next == after {
                break;
            }
            after = next;
        }
        assert_eq!(found, [2, 5, 8]);
        assert_eq!(event_log.after(Some(JobId(7)), 0, 2), (Vec::new(), 9));
        assert_eq!(event_log.after(None, 99, 2), (Vec::new(), 99));
    }

    #[test]
    fn memory_has_last_events_and_file_has_two_pieces() {
        let directory = tempfile::tempdir().unwrap();
        let event_log = EventLog::open(directory.path().to_owned());
        let text = "x".repeat(MOST_TEXT);
        for n in 0..40_000 {
            event_log.record(n, LogEvent::new(EventKind::Coordinator, text.clone()));
            if n % 1000 == 0 {
                event_log.write();
            }
        }
        event_log.write();
        let bytes: u64 = std::fs::read_dir(directory.path())
            .unwrap()
            .map(|e| e.unwrap().metadata().unwrap().len())
            .sum();
        assert!(bytes < 2 * PIECE_BYTES + (2 << 20), "{bytes}");
        let again = EventLog::open(directory.path().to_owned());
        assert_eq!(again.after(None, 0, usize::MAX).1, 40_000);
    }
}
