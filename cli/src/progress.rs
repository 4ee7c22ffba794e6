//! Progress on stderr: a bar on a terminal, otherwise a line every few seconds.

use std::io::{IsTerminal as _, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use sightline_proto::v1;

use crate::pace::{Left, Pace};
use crate::printable;

/// Bars and lines share stderr. Every line has to go through this, because it would break a bar otherwise.
static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Time between two lines when stderr is not a terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Time between two lines for programs.
const EVENT_EVERY: Duration = Duration::from_secs(1);
/// Whether progress is told as JSON Lines.
static AS_JSON: AtomicBool = AtomicBool::new(false);

/// From now on tells progress as JSON Lines, for programs.
pub fn tell_as_json() {
    AS_JSON.store(true, Ordering::Relaxed);
}

/// Where lines go instead of stderr.
type Listener = Box<dyn Fn(&str) + Send + Sync>;
static LISTENER: OnceLock<Listener> = OnceLock::new();

/// Gives the lines that would go to stderr to a function. Only the first call counts.
pub fn say_to(listener: impl Fn(&str) + Send + Sync + 'static) {
    // A second listener is refused.
    let _ = LISTENER.set(Box::new(listener));
}

/// Prints a line to stderr, with control characters escaped.
pub fn say(text: &str) {
    say_as_it_is(&printable::text(text));
}

/// Prints a line to stderr that may have the sequences of colours.
fn say_as_it_is(text: &str) {
    if let Some(listener) = LISTENER.get() {
        listener(text);
    } else if std::io::stderr().is_terminal() {
        // Fails only when stderr is closed; then the error cannot be shown either.
        let _ = BARS.println(text);
    } else {
        let _ = writeln!(std::io::stderr(), "{text}");
    }
}

/// Makes writers of log lines that do not break a bar.
pub struct LogWriter;

impl<'a> tracing_subscriber::fmt::MakeWriter<'a> for LogWriter {
    type Writer = LogLine;
    fn make_writer(&'a self) -> LogLine {
        LogLine(Vec::new())
    }
}

/// One log line, collected and printed when it is dropped.
pub struct LogLine(Vec<u8>);

impl std::io::Write for LogLine {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Drop for LogLine {
    fn drop(&mut self) {
        if !self.0.is_empty() {
            // The log escapes the texts of other programs.
            say_as_it_is(String::from_utf8_lossy(&self.0).trim_end());
        }
    }
}

/// Shows the progress of a job or of a count.
pub struct Progress {
    bar: Option<ProgressBar>,
    start: Instant,
    pace: Mutex<Pace>,
    last_line: Mutex<Option<Instant>>,
    /// The job's state when it was last shown.
    last_state: Mutex<Option<v1::JobState>>,
}

impl Progress {
    /// Shows an empty bar on a terminal, otherwise nothing yet.
    pub fn new() -> Self {
        let for_people = !AS_JSON.load(Ordering::Relaxed);
        let bar = (for_people && std::io::stderr().is_terminal()).then(|| {
            let bar = BARS.add(ProgressBar::new(0));
            // The template is a constant, checked by a test.
            if let Ok(style) = ProgressStyle::with_template(TEMPLATE) {
                bar.set_style(style.progress_chars("█▉▊▋▌▍▎▏ "));
            }
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        Self {
            bar,
            start: Instant::now(),
            pace: Mutex::new(Pace::new()),
            last_line: Mutex::new(None),
            last_state: Mutex::new(None),
        }
    }

    /// Shows a job. `workers_here`: the workers run in this process, so the user need not start any.
    pub fn job(&self, job: &v1::Job, workers_here: bool) {
        let ended = u64::from(job.tiles_done + job.tiles_set_aside);
        let (left, rate) = {
            let mut pace = self.pace.lock().unwrap_or_else(PoisonError::into_inner);
            (pace.left(job, workers_here), pace.samples_per_second(job))
        };
        // A change of state is shown at once, because the next message may come much later.
        let state = Some(job.state());
        if std::mem::replace(
            &mut *self
                .last_state
                .lock()
                .unwrap_or_else(PoisonError::into_inner),
            state,
        ) != state
        {
            *self
                .last_line
                .lock()
                .unwrap_or_else(PoisonError::into_inner) = None;
        }
        let what = counted(job);
        let cells = match job.cells_total {
            0 => format!("{} {what}", job.cells_done),
            total => format!("{}/{total} {what}", job.cells_done),
        };
        let seconds_left = match left {
            Left::Seconds(seconds) => Some(seconds),
            _ => None,
        };
        let left = match left {
            Left::Paused => format!("PAUSED: `sightline resume {}` continues it", job.id),
            Left::NoWorkers => "NO WORKERS: start some with `sightline worker`".to_owned(),
            Left::Finishing => "finishing".to_owned(),
            Left::Seconds(seconds) => about(seconds),
            Left::NotKnown => "time left not known yet".to_owned(),
        };
        let samples = if job.spec.as_ref().is_some_and(is_decided) {
            // Rays come first and queries later; one rate for both would mean nothing.
            format!("{} rays and queries", job.samples)
        } else {
            format!("{} samples ({rate:.0}/s)", job.samples)
        };
        let aside = match job.tiles_set_aside {
            0 => String::new(),
            n => format!(", {n} SET ASIDE"),
        };
        let text = format!("{cells}, {samples}{aside}, {left}");
        let state = job
            .state()
            .as_str_name()
            .trim_start_matches("JOB_STATE_")
            .to_ascii_lowercase();
        let more = json!({
            "job": job.id, "state": state, "cells_done": job.cells_done, "cells_total": job.cells_total,
            "samples": job.samples, "tiles_set_aside": job.tiles_set_aside, "seconds_left": seconds_left,
        });
        self.show([ended, u64::from(job.tiles_total)], "tiles", &text, more);
    }

    /// Shows a count of things that take about the same time each, with the time left.
    pub fn count(&self, done: u64, total: u64, what: &str) {
        let seconds = self.start.elapsed().as_secs_f64();
        let left = total.saturating_sub(done) as f64;
        let left = (done > 0).then(|| seconds / done as f64 * left);
        self.show(
            [done, total],
            what,
            &left.map(about).unwrap_or_default(),
            json!({"seconds_left": left}),
        );
    }

    /// Shows a count whose total still grows, without a time left.
    pub fn count_so_far(&self, done: u64, total: u64, what: &str) {
        self.show([done, total], what, "", json!({}));
    }

    /// Shows text to people, or an event with more fields to programs.
    fn show(&self, [done, total]: [u64; 2], what: &str, text: &str, more: Value) {
        if let Some(bar) = &self.bar {
            bar.set_length(total);
            bar.set_position(done);
            bar.set_message(format!("{what}  {text}"));
            return;
        }
        let mut last = self
            .last_line
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let for_programs = AS_JSON.load(Ordering::Relaxed);
        let every = if for_programs {
            EVENT_EVERY
        } else {
            LINE_EVERY
        };
        if last.is_none_or(|t| t.elapsed() >= every) {
            *last = Some(Instant::now());
            if for_programs {
                let mut event =
                    json!({"event": "progress", "what": what, "done": done, "total": total});
                if let (Some(event), Value::Object(more)) = (event.as_object_mut(), more) {
                    event.extend(more);
                }
                say(&event.to_string());
                return;
            }
            let comma = if text.is_empty() { "" } else { ", " };
            say(&format!("{done}/{total} {what}{comma}{text}"));
        }
    }

    /// Removes the bar.
    pub fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// What a job counts as its cells, in a word.
pub fn counted(job: &v1::Job) -> &'static str {
    if has_receivers(job) {
        "receivers"
    } else {
        "cells"
    }
}

/// Returns true if exact queries or portals decide about triangles.
fn is_decided(spec: &v1::JobSpec) -> bool {
    use v1::visibility::Method;
    match &spec.task {
        Some(v1::job_spec::Task::Visibility(task)) => {
            matches!(task.method, Some(Method::Exact(_) | Method::Portals(_)))
        }
        Some(v1::job_spec::Task::Ambient(_)) | None => false,
    }
}

/// Whether a job computes ambient occlusion at receivers.
pub fn has_receivers(job: &v1::Job) -> bool {
    let task = job.spec.as_ref().and_then(|spec| spec.task.as_ref());
    matches!(task, Some(v1::job_spec::Task::Ambient(_)))
}

const TEMPLATE: &str = "{elapsed_precise} [{bar:24}] {pos}/{len} {msg}";

/// The time left, in words.
fn about(seconds: f64) -> String {
    format!(
        "about {} left",
        human(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
    )
}

/// A duration with a unit that suits its length.
pub fn human(d: Duration) -> String {
    let s = d.as_secs_f64();
    match s {
        s if s < 10.0 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_template_is_one() {
        ProgressStyle::with_template(TEMPLATE).unwrap();
    }
}
