//! The observer of a call: it receives progress and notes, and can cancel the call.

use std::time::Duration;

use crate::client::Job;

/// The progress of work.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// The number of finished items.
    pub done: u64,
    /// The total number of items. 0 if it is not known.
    pub total: u64,
    /// The noun of the items, such as `cells` or `frames`.
    pub what: &'static str,
    /// The remaining time.
    pub left: TimeLeft,
    /// The job, if the work belongs to a job.
    pub job: Option<JobProgress<'a>>,
}

impl Progress<'_> {
    /// Returns the state of the job as a word, or `running` for work that belongs to no job.
    pub fn state(&self) -> &'static str {
        self.job.map_or("running", |handle| handle.job.state_name())
    }

    /// Returns the remaining time in seconds, if it is known.
    pub fn seconds_left(&self) -> Option<f64> {
        match self.left {
            TimeLeft::Seconds(seconds) => Some(seconds),
            TimeLeft::Finishing => Some(0.0),
            TimeLeft::Paused | TimeLeft::NoWorkers | TimeLeft::Unknown => None,
        }
    }
}

/// The current state of a job, and its sampling rate.
#[derive(Clone, Copy, Debug)]
pub struct JobProgress<'a> {
    /// The job.
    pub job: &'a Job,
    /// The number of samples per second since the job was first observed.
    pub samples_per_second: f64,
}

/// The remaining time until the work ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeLeft {
    /// Unknown, because the job is paused.
    Paused,
    /// Unknown, because no worker computes tiles of the job.
    NoWorkers,
    /// About zero, because all cells of the job are done and its result is being assembled.
    Finishing,
    /// About this number of seconds, which is at least 0.
    Seconds(f64),
    /// Unknown, because too few items are finished for an estimate.
    Unknown,
}

/// A line for the user that is not an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// True if the note is about input that a part of the library ignores or changes.
    pub is_warning: bool,
    /// The text of the note, in one line. The text of a warning does not contain the word “warning”.
    pub text: String,
}

/// The observer of a call that can take long. Every method has a default, so an observer implements only the
/// methods that it needs. The library calls the methods from any thread.
///
/// ```
/// use sightline::{Note, Observer};
///
/// struct Log;
///
/// impl Observer for Log {
///     fn note(&self, note: &Note) {
///         eprintln!("{}", note.text);
///     }
/// }
/// ```
pub trait Observer: Sync {
    /// Receives the progress.
    fn progress(&self, _progress: &Progress<'_>) {}

    /// Receives a note.
    fn note(&self, _note: &Note) {}

    /// Returns true if the call should stop. The call then ends soon, with [`crate::ErrorKind::Cancelled`].
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// An observer that ignores progress and notes, and never cancels.
///
/// ```
/// use sightline::{Observer as _, Silent};
///
/// assert!(!Silent.is_cancelled());
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}

/// The time between two calls of [`Observer::is_cancelled`].
const ASK_EVERY: Duration = Duration::from_millis(50);

/// Resolves when the observer cancels.
pub(crate) async fn cancelled(observer: &dyn Observer) {
    while !observer.is_cancelled() {
        tokio::time::sleep(ASK_EVERY).await;
    }
}

/// Passes a note to an observer.
pub(crate) fn note(observer: &dyn Observer, text: impl Into<String>) {
    observer.note(&Note {
        is_warning: false,
        text: text.into(),
    });
}

/// Passes a warning to an observer.
pub(crate) fn warn(observer: &dyn Observer, text: impl Into<String>) {
    observer.note(&Note {
        is_warning: true,
        text: text.into(),
    });
}
