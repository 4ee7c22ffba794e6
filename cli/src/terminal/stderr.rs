//! Lines on stderr, which share the terminal with a progress bar.

use std::io::{IsTerminal as _, Write as _};
use std::sync::LazyLock;

use indicatif::MultiProgress;

use crate::terminal::printable;

/// The progress bars on stderr. Every line has to be printed through this, because it would break a bar
/// otherwise.
pub static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Prints a line to stderr, with control characters escaped.
pub fn say(text: &str) {
    say_as_it_is(&printable::text(text));
}

/// Prints a line to stderr without escapes, so that it may contain colour sequences.
fn say_as_it_is(text: &str) {
    if std::io::stderr().is_terminal() {
        // The print fails only if stderr is closed, and then the error cannot be shown either.
        let _ = BARS.println(text);
    } else {
        let _ = writeln!(std::io::stderr(), "{text}");
    }
}

/// A factory of log writers that do not break a bar.
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
            // The log has already escaped the texts of other programs.
            say_as_it_is(String::from_utf8_lossy(&self.0).trim_end());
        }
    }
}
