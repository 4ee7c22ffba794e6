//! What happened: events of jobs, tiles and workers with their times, for people.
//!
//! The last events are in memory (`recent.rs`). All are appended to a file, of which the last one or two
//! pieces are kept, so that events outlive a restart. No state is derived from them: a crash may lose those
//! of the last moment, and a full disk those since.

mod recent;

use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use sightline_records::ids::{JobId, Lease, TileIndex};
use tokio::sync::watch;

use self::recent::Recent;

/// Bytes of a text; longer ones are cut. Workers send reasons of any length.
const MOST_TEXT: usize = 500;
/// Length at which a piece of the file ends.
const PIECE_BYTES: u64 = 16 << 20;
/// Most bytes that wait to be written; further events are in memory alone.
const MOST_UNWRITTEN: usize = 4 << 20;
/// The piece that grows, and the one before.
const PIECES: [&str; 2] = ["events.jsonl", "events.1.jsonl"];

/// The kind of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Kind {
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

impl Kind {
    /// All of them, in their order.
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

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct LogEvent {
    pub(crate) kind: Kind,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) job: Option<JobId>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) tile: Option<TileIndex>,
    /// The worker's name, if one is concerned.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub(crate) worker: String,
    pub(crate) text: String,
}

impl LogEvent {
    /// An event of no job.
    pub(crate) fn of(kind: Kind, text: impl Into<String>) -> Self {
        Self {
            kind,
            job: None,
            tile: None,
            worker: String::new(),
            text: text.into(),
        }
    }

    /// An event of a job.
    pub(crate) fn of_job(kind: Kind, job: JobId, text: impl Into<String>) -> Self {
        Self {
            job: Some(job),
            ..Self::of(kind, text)
        }
    }

    /// An event of a leased tile.
    pub(crate) fn of_lease(kind: Kind, lease: &Lease, text: impl Into<String>) -> Self {
        Self {
            tile: Some(lease.tile),
            ..Self::of_job(kind, lease.job, text)
        }
    }

    /// The event as one about a worker.
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
    /// Milliseconds since 1970.
    pub(crate) at_ms: u64,
    #[serde(flatten)]
    pub(crate) what: LogEvent,
}

/// What is in memory.
#[derive(Default)]
struct Kept {
    recent: Recent,
    /// Lines for the file.
    unwritten: Vec<u8>,
}

/// All events.
pub(crate) struct EventLog {
    kept: Mutex<Kept>,
    /// The number of the last event.
    grown: watch::Sender<u64>,
    /// The directory of the file; `None` to write none.
    directory: Option<PathBuf>,
    /// The piece that grows, once it is open.
    piece: Mutex<Option<File>>,
}

impl EventLog {
    /// Events in memory alone.
    pub(crate) fn nowhere() -> Self {
        Self {
            kept: Mutex::default(),
            grown: watch::Sender::new(0),
            directory: None,
            piece: Mutex::new(None),
        }
    }

    /// The events of a directory, which is created with the first event. What cannot be read is left out, and
    /// the log says so.
    pub(crate) fn of(directory: PathBuf) -> Self {
        let mut kept = Kept::default();
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

    /// Notes an event. Does not block on the disk.
    pub(crate) fn record(&self, at_ms: u64, mut what: LogEvent) {
        cut(&mut what.text);
        let mut kept = self.kept();
        let entry = Entry {
            number: kept.recent.last() + 1,
            at_ms,
            what,
        };
        if self.directory.is_some() && kept.unwritten.len() < MOST_UNWRITTEN {
            // Texts and numbers can always be written as JSON.
            if let Ok(line) = serde_json::to_string(&entry) {
                kept.unwritten.extend(line.as_bytes());
                kept.unwritten.push(b'\n');
            }
        }
        kept.recent.push(&entry);
        self.grown.send_replace(entry.number);
    }

    /// At most `most` events with greater numbers than `after`, ascending, of one job or of all; and the
    /// number up to which was looked.
    pub(crate) fn after(&self, job: Option<JobId>, after: u64, most: usize) -> (Vec<Entry>, u64) {
        self.kept().recent.after(job, after, most)
    }

    /// The number after which a job has its last `most` events.
    pub(crate) fn before_last(&self, job: JobId, most: usize) -> u64 {
        self.kept().recent.before_last(job, most)
    }

    /// The number of the last event, from now on.
    pub(crate) fn grown(&self) -> watch::Receiver<u64> {
        self.grown.subscribe()
    }

    /// Whether there is something to write.
    pub(crate) fn has_unwritten(&self) -> bool {
        !self.kept().unwritten.is_empty()
    }

    /// Appends to the file what is not in it yet.
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

    fn kept(&self) -> MutexGuard<'_, Kept> {
        // Each change is whole before anything can panic.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Cuts a text that is too long.
fn cut(text: &mut String) {
    if text.len() > MOST_TEXT {
        let end = (0..=MOST_TEXT)
            .rev()
            .find(|end| text.is_char_boundary(*end));
        text.truncate(end.unwrap_or(0));
        text.push('…');
    }
}

/// Reads a piece of the file.
fn read(path: &Path, kept: &mut Kept) {
    let Ok(file) = File::open(path) else { return };
    let mut unread = 0;
    // A piece that was damaged may be longer than one that was written.
    let mut lines = BufReader::new(std::io::Read::take(file, 2 * PIECE_BYTES)).split(b'\n');
    while let Some(Ok(line)) = lines.next() {
        if line.is_empty() {
            continue;
        }
        match serde_json::from_slice::<Entry>(&line) {
            // Where some were not written, those before them are forgotten.
            Ok(entry) => kept.recent.push(&entry),
            Err(_) => unread += 1,
        }
    }
    if unread > 0 {
        tracing::warn!(
            "{}: {unread} lines are no events and are left out",
            path.display()
        );
    }
}

/// Appends to the growing piece, and begins another one when it is long.
fn append(directory: &Path, piece: &mut Option<File>, bytes: &[u8]) -> std::io::Result<()> {
    let [growing, before] = PIECES.map(|name| directory.join(name));
    if piece.is_none() {
        std::fs::create_dir_all(directory)?;
        let mut file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&growing)?;
        // Ends a line that a crash left unfinished.
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
        LogEvent::of_job(Kind::Job, JobId(n % 3), format!("event {n}"))
    }

    #[test]
    fn events_outlive_a_restart_and_go_on() {
        let directory = tempfile::tempdir().unwrap();
        for run in 0..3 {
            let event_log = EventLog::of(directory.path().to_owned());
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
    fn a_torn_line_costs_itself_alone() {
        let directory = tempfile::tempdir().unwrap();
        let event_log = EventLog::of(directory.path().to_owned());
        (0..4).for_each(|n| event_log.record(n, event(n)));
        event_log.write();
        let file = directory.path().join(PIECES[0]);
        let mut bytes = std::fs::read(&file).unwrap();
        bytes.truncate(bytes.len() - 9);
        std::fs::write(&file, &bytes).unwrap();
        let again = EventLog::of(directory.path().to_owned());
        again.record(9, event(9));
        again.write();
        let third = EventLog::of(directory.path().to_owned());
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
    fn a_page_says_where_the_next_begins() {
        let event_log = EventLog::nowhere();
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
    fn memory_holds_the_last_events_and_the_file_two_pieces() {
        let directory = tempfile::tempdir().unwrap();
        let event_log = EventLog::of(directory.path().to_owned());
        let text = "x".repeat(MOST_TEXT);
        for n in 0..40_000 {
            event_log.record(n, LogEvent::of(Kind::Coordinator, text.clone()));
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
        let again = EventLog::of(directory.path().to_owned());
        assert_eq!(again.after(None, 0, usize::MAX).1, 40_000);
    }
}
