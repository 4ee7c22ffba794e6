//! The observer of a call: it receives progress and notes, and can cancel the call.

use std::time::Duration;

use crate::client::Job;

/// The progress of work.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// The number of finished things.
    pub done: u64,
    /// The number of all things; 0 while it is unknown.
    pub total: u64,
    /// The things that are counted, such as `cells` or `frames`.
    pub what: &'static str,
    /// The time left.
    pub left: TimeLeft,
    /// The job, for the work of a job.
    pub job: Option<JobProgress<'a>>,
}

impl Progress<'_> {
    /// Returns the state of the job as a word; `running` for other work.
    pub fn state(&self) -> &'static str {
        self.job.map_or("running", |of| of.job.state_name())
    }

    /// Returns the time left in seconds, where it is known.
    pub fn seconds_left(&self) -> Option<f64> {
        match self.left {
            TimeLeft::Seconds(seconds) => Some(seconds),
            TimeLeft::Finishing => Some(0.0),
            TimeLeft::Paused | TimeLeft::NoWorkers | TimeLeft::Unknown => None,
        }
    }
}

/// A job as it is now, and its rate since it was first observed.
#[derive(Clone, Copy, Debug)]
pub struct JobProgress<'a> {
    /// The job.
    pub job: &'a Job,
    /// Samples per second since the job was first observed.
    pub samples_per_second: f64,
}

/// The time until work ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeLeft {
    /// The job is paused.
    Paused,
    /// No worker computes tiles of the job.
    NoWorkers,
    /// All cells of the job are done, and its result is assembled.
    Finishing,
    /// About this number of seconds.
    Seconds(f64),
    /// Too little is done to estimate a time.
    Unknown,
}

/// A line for the user that is not an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// True for a note about input that a part of the library ignores or changes.
    pub is_warning: bool,
    /// The line. The text of a warning has no mark of its kind.
    pub text: String,
}

/// The observer of a call that can take long. Every method has a default, so that an observer implements only
/// the methods that it needs. The library calls the methods from any thread.
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

    /// Returns true if the call should stop. It then ends soon, with [`crate::ErrorKind::Cancelled`].
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// An observer that ignores everything and never cancels.
///
/// ```
/// use sightline::{Observer as _, Silent};
///
/// assert!(!Silent.is_cancelled());
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}

/// Time between two questions whether to stop.
const ASK_EVERY: Duration = Duration::from_millis(50);

/// Resolves when the observer cancels.
pub(crate) async fn cancelled(observer: &dyn Observer) {
    while !observer.is_cancelled() {
        tokio::time::sleep(ASK_EVERY).await;
    }
}

/// Gives an observer a note.
pub(crate) fn note(observer: &dyn Observer, text: impl Into<String>) {
    observer.note(&Note {
        is_warning: false,
        text: text.into(),
    });
}

/// Gives an observer a warning.
pub(crate) fn warn(observer: &dyn Observer, text: impl Into<String>) {
    observer.note(&Note {
        is_warning: true,
        text: text.into(),
    });
}
