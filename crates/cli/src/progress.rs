//! Progress on stderr: a bar on a terminal, otherwise a line every few seconds.

use std::io::{IsTerminal as _, Write as _};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use sightline_proto::v1;

/// Bars and lines share stderr. Every line has to go through this, because it would break a bar otherwise.
static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Time between two lines when stderr is not a terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// The cells of a tile do not take the same time: the first take long, and most end together. Of few tiles
/// the time left is told when a fifth of the cells is done.
const FEW_TILES: u32 = 8;

/// Prints a line to stderr.
pub fn say(text: &str) {
    if std::io::stderr().is_terminal() {
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
            say(String::from_utf8_lossy(&self.0).trim_end());
        }
    }
}

/// The counts of a job when it was first shown.
#[derive(Clone, Copy)]
struct AtStart {
    tiles: u64,
    cells: u64,
    samples: u64,
}

/// Shows the progress of a job or of a count.
pub struct Progress {
    bar: Option<ProgressBar>,
    start: Instant,
    /// The counts at the start: what earlier runs had done already.
    first: Mutex<Option<AtStart>>,
    last_line: Mutex<Option<Instant>>,
    /// The job's state when it was last shown.
    last_state: Mutex<Option<v1::JobState>>,
}

impl Progress {
    /// Shows an empty bar on a terminal, otherwise nothing yet.
    pub fn new() -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
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
            first: Mutex::new(None),
            last_line: Mutex::new(None),
            last_state: Mutex::new(None),
        }
    }

    /// Shows a job. `workers_here`: the workers run in this process, so the user need not start any.
    pub fn job(&self, job: &v1::Job, workers_here: bool) {
        let ended = u64::from(job.tiles_done + job.tiles_set_aside);
        let mut first = self.first.lock().unwrap_or_else(PoisonError::into_inner);
        let start =
            *first.get_or_insert(AtStart { tiles: ended, cells: job.cells_done, samples: job.samples });
        drop(first);
        // A change of state is shown at once, because the next message may come much later.
        let state = Some(job.state());
        if std::mem::replace(&mut *self.last_state.lock().unwrap_or_else(PoisonError::into_inner), state)
            != state
        {
            *self.last_line.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
        let seconds = self.start.elapsed().as_secs_f64();
        let cells = match job.cells_total {
            0 => format!("{} cells", job.cells_done),
            total => format!("{}/{total} cells", job.cells_done),
        };
        // Cells are counted if their total is known, because a small job may be a single tile.
        let (here, left) = match job.cells_total {
            0 => (ended.saturating_sub(start.tiles), u64::from(job.tiles_total).saturating_sub(ended)),
            total => (job.cells_done.saturating_sub(start.cells), total.saturating_sub(job.cells_done)),
        };
        let open = matches!(job.state(), v1::JobState::Queued | v1::JobState::Running);
        let waits = open && job.workers == 0 && !workers_here;
        let left = if job.state() == v1::JobState::Paused {
            format!("PAUSED: `sightline resume {}` continues it", job.id)
        } else if waits {
            "NO WORKERS: start some with `sightline worker`".to_owned()
        } else if left == 0 {
            "finishing".to_owned()
        } else if here > 0 && (job.tiles_total > FEW_TILES || here * 4 >= left) {
            // No job runs much longer than its time budget.
            let budget = job.spec.as_ref().map_or(0.0, |s| s.time_budget_ms as f64 * 1e-3);
            match seconds / here as f64 * left as f64 {
                _ if budget > 0.0 && seconds >= budget => "finishing".to_owned(),
                left if budget > 0.0 => about(left.min(budget - seconds)),
                left => about(left),
            }
        } else {
            "time left not known yet".to_owned()
        };
        let samples = if job.spec.as_ref().is_some_and(|s| s.method() != v1::Method::Aggressive) {
            // Rays come first and queries later; one rate for both would mean nothing.
            format!("{} rays and queries", job.samples)
        } else {
            let rate = job.samples.saturating_sub(start.samples) as f64 / seconds.max(1e-3);
            format!("{} samples ({rate:.0}/s)", job.samples)
        };
        let aside = match job.tiles_set_aside {
            0 => String::new(),
            n => format!(", {n} SET ASIDE"),
        };
        let text = format!("{cells}, {samples}{aside}, {left}");
        self.show(ended, u64::from(job.tiles_total), "tiles", &text);
    }

    /// Shows a count of things that take about the same time each, with the time left.
    pub fn count(&self, done: u64, total: u64, what: &str) {
        let seconds = self.start.elapsed().as_secs_f64();
        let left = total.saturating_sub(done) as f64;
        let text = if done > 0 { about(seconds / done as f64 * left) } else { String::new() };
        self.show(done, total, what, &text);
    }

    /// Shows a count whose total still grows, without a time left.
    pub fn count_so_far(&self, done: u64, total: u64, what: &str) {
        self.show(done, total, what, "");
    }

    fn show(&self, done: u64, total: u64, what: &str, text: &str) {
        if let Some(bar) = &self.bar {
            bar.set_length(total);
            bar.set_position(done);
            bar.set_message(format!("{what}  {text}"));
            return;
        }
        let mut last = self.last_line.lock().unwrap_or_else(PoisonError::into_inner);
        if last.is_none_or(|t| t.elapsed() >= LINE_EVERY) {
            *last = Some(Instant::now());
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

const TEMPLATE: &str = "{elapsed_precise} [{bar:24}] {pos}/{len} {msg}";

/// The time left, in words.
fn about(seconds: f64) -> String {
    format!("about {} left", human(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)))
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
