//! The exit codes of commands (the table of `docs/interfaces.md`).

use std::process::ExitCode;

use sightline::{Error, ErrorKind};

use crate::terminal::exhaustion::Exhausted;

/// The exit code for a fault of the program or the machine.
pub const INTERNAL: u8 = 1;

/// Returns the exit code of an error. The coordinator of a bake is part of the process, so an error of that
/// coordinator is a fault of the machine.
pub fn exit_code(e: &Error, is_bake: bool) -> ExitCode {
    ExitCode::from(match e.kind() {
        ErrorKind::Internal => INTERNAL,
        ErrorKind::Usage => 2,
        ErrorKind::Input => 3,
        ErrorKind::Coordinator if is_bake => INTERNAL,
        ErrorKind::Coordinator => 4,
        ErrorKind::Job => 5,
        ErrorKind::Different => 6,
        ErrorKind::Cancelled => 130,
    })
}

/// Returns the resource of this process that was exhausted, if the error names one. Such an error is not a
/// fault of the command's input.
pub fn exhausted(e: &Error, is_bake: bool) -> Option<Exhausted> {
    let text = e.to_string();
    match e.kind() {
        // A thread cannot start, and the error reports no other cause.
        ErrorKind::Internal if text.starts_with("Resource temporarily unavailable") => {
            Some(Exhausted::Threads)
        }
        ErrorKind::Internal | ErrorKind::Input | ErrorKind::Usage => Exhausted::in_error(&text),
        ErrorKind::Coordinator if is_bake || !e.is_answer_of_coordinator() => {
            Exhausted::in_error(&text)
        }
        ErrorKind::Job if is_bake => Exhausted::in_error(&text),
        _ => None,
    }
}

/// Treats the interruption of a command as success, because its output is complete up to then.
pub fn unless_cancelled(done: Result<(), Error>) -> Result<(), Error> {
    match done {
        Err(e) if e.kind() == ErrorKind::Cancelled => Ok(()),
        done => done,
    }
}
