//! Notes and progress on stderr: a bar on a terminal, and otherwise a line every few seconds.

use std::io::IsTerminal as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use sightline::words::human;
use sightline::{JobProgress, Note, Observer, Progress, TimeLeft};
use sightline_proto::v1;

use crate::terminal::interrupt;
use crate::terminal::stderr::{BARS, say};

/// The time between two lines if stderr is not a terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// The time between two JSON lines.
const EVENT_EVERY: Duration = Duration::from_secs(1);
/// True if progress is printed as JSON Lines.
static AS_JSON: AtomicBool = AtomicBool::new(false);

/// Prints progress as JSON Lines from now on, for programs.
pub fn tell_as_json() {
    AS_JSON.store(true, Ordering::Relaxed);
}

/// The observer of a command. It prints notes and progress to stderr, and cancels at Ctrl-C and SIGTERM.
pub struct Terminal {
    /// The bar, from the first progress on. `None` if stderr is not a terminal.
    bar: OnceLock<Option<ProgressBar>>,
    last_line: Mutex<Option<Instant>>,
    /// The job's state when it was last shown.
    last_state: Mutex<Option<v1::JobState>>,
    start: Instant,
}

impl Observer for Terminal {
    fn progress(&self, progress: &Progress<'_>) {
        match &progress.job {
            Some(job) => self.job(job, progress),
            None => self.counted(progress.done, progress.total, progress.what, progress.left),
        }
    }

    fn note(&self, note: &Note) {
        let mark = if note.is_warning { "warning: " } else { "" };
        say(&format!("{mark}{}", note.text));
    }

    fn is_cancelled(&self) -> bool {
        interrupt::is_interrupted()
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.end();
    }
}

/// Creates an empty bar if stderr is a terminal and progress is not printed as JSON Lines.
fn bar() -> Option<ProgressBar> {
    let for_people = !AS_JSON.load(Ordering::Relaxed);
    (for_people && std::io::stderr().is_terminal()).then(|| {
        let bar = BARS.add(ProgressBar::new(0));
        // The template is a constant that a test checks.
        if let Ok(style) = ProgressStyle::with_template(TEMPLATE) {
            bar.set_style(style.progress_chars("█▉▊▋▌▍▎▏ "));
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    })
}

impl Terminal {
    /// Creates an observer that has printed nothing.
    pub fn new() -> Self {
        Self {
            bar: OnceLock::new(),
            last_line: Mutex::new(None),
            last_state: Mutex::new(None),
            start: Instant::now(),
        }
    }

    /// Shows the progress of a job: counts of tiles, cells and samples, and the remaining time.
    fn job(&self, progress: &JobProgress<'_>, parts: &Progress<'_>) {
        let (job, rate) = (progress.job.message(), progress.samples_per_second);
        let ended = u64::from(job.tiles_done + job.tiles_set_aside);
        // A change of state is shown immediately, because the next message may arrive much later.
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
        let what = progress.job.cell_noun();
        let cells = match job.cells_total {
            0 => format!("{} {what}", job.cells_done),
            total => format!("{}/{total} {what}", job.cells_done),
        };
        let seconds_left = match parts.left {
            TimeLeft::Seconds(seconds) => Some(seconds),
            _ => None,
        };
        let left = match parts.left {
            TimeLeft::Paused => format!("PAUSED: `sightline resume {}` continues it", job.id),
            TimeLeft::NoWorkers => "NO WORKERS: start some with `sightline worker`".to_owned(),
            TimeLeft::Finishing => "finishing".to_owned(),
            TimeLeft::Seconds(seconds) => about(seconds),
            TimeLeft::Unknown => "time left not known yet".to_owned(),
        };
        let samples = if job.spec.as_ref().is_some_and(is_decided) {
            // Rays come first and queries later, so a common rate would have no meaning.
            format!("{} rays and queries", job.samples)
        } else {
            format!("{} samples ({rate:.0}/s)", job.samples)
        };
        let aside = match job.tiles_set_aside {
            0 => String::new(),
            n => format!(", {n} SET ASIDE"),
        };
        let text = format!("{cells}, {samples}{aside}, {left}");
        let state = progress.job.state_name();
        let more = json!({
            "job": job.id, "state": state, "cells_done": job.cells_done, "cells_total": job.cells_total,
            "samples": job.samples, "tiles_set_aside": job.tiles_set_aside, "seconds_left": seconds_left,
        });
        self.show([ended, u64::from(job.tiles_total)], "tiles", &text, more);
    }

    /// Shows a count of items that take about the same time each, with the remaining time.
    pub fn count(&self, done: u64, total: u64, what: &str) {
        let seconds = self.start.elapsed().as_secs_f64();
        let left = total.saturating_sub(done) as f64;
        let left = (done > 0).then(|| seconds / done as f64 * left);
        let left = left.map_or(TimeLeft::Unknown, TimeLeft::Seconds);
        self.counted(done, total, what, left);
    }

    fn counted(&self, done: u64, total: u64, what: &str, left: TimeLeft) {
        let left = match left {
            TimeLeft::Seconds(seconds) => Some(seconds),
            _ => None,
        };
        self.show(
            [done, total],
            what,
            &left.map(about).unwrap_or_default(),
            json!({"seconds_left": left}),
        );
    }

    /// Shows a count whose total still grows, without a remaining time.
    pub fn count_so_far(&self, done: u64, total: u64, what: &str) {
        self.show([done, total], what, "", json!({}));
    }

    /// Shows text to users, or an event with more fields to programs.
    fn show(&self, [done, total]: [u64; 2], what: &str, text: &str, more: Value) {
        if let Some(bar) = self.bar.get_or_init(bar) {
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
        if let Some(Some(bar)) = self.bar.get() {
            bar.finish_and_clear();
        }
    }
}

/// Returns true if exact queries or portals decide the visibility of triangles.
fn is_decided(spec: &v1::JobSpec) -> bool {
    use v1::visibility::Method;
    match &spec.task {
        Some(v1::job_spec::Task::Visibility(task)) => {
            matches!(task.method, Some(Method::Exact(_) | Method::Portals(_)))
        }
        Some(v1::job_spec::Task::Ambient(_)) | None => false,
    }
}

const TEMPLATE: &str = "{elapsed_precise} [{bar:24}] {pos}/{len} {msg}";

/// Formats the remaining time, given in seconds.
fn about(seconds: f64) -> String {
    format!(
        "about {} left",
        human(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn template_is_valid() {
        ProgressStyle::with_template(TEMPLATE).unwrap();
    }
}
