//! The output of commands on stdout.

use std::io::{BufWriter, Write as _};

use sightline::Error;

use crate::terminal::printable;

/// Prints a result to stdout, with control characters escaped.
pub fn print(text: &str) -> Result<(), Error> {
    let text = printable::text(text);
    print_with(|out| writeln!(out, "{text}"))
}

/// Prints a result to stdout as one line of JSON, without keeping the whole line in memory.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), Error> {
    print_with(|out| {
        printable::json(&mut *out, value)?;
        writeln!(out)
    })
}

/// Calls `write` with buffered stdout.
pub fn print_with(
    write: impl FnOnce(&mut BufWriter<std::io::StdoutLock<'_>>) -> std::io::Result<()>,
) -> Result<(), Error> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    match write(&mut out).and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        // The reader has closed the pipe, as in `sightline dump … | head`.
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        Err(e) => Err(unwritable(&e)),
    }
}

/// Returns the error for a stdout that cannot be written.
pub fn unwritable(e: &std::io::Error) -> Error {
    Error::internal(format!(
        "stdout cannot be written: {e}; check the space left where it is redirected to"
    ))
}
