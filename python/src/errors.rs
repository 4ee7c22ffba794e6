//! Errors of the program as exceptions of the package, in words of Python.

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use sightline_cli::calls::CliError;
use sightline_pvs::PvsError;

pyo3::import_exception!(sightline._errors, SightlineError);
pyo3::import_exception!(sightline._errors, OptionError);
pyo3::import_exception!(sightline._errors, InputError);
pyo3::import_exception!(sightline._errors, Error);
pyo3::import_exception!(sightline._errors, CoordinatorError);
pyo3::import_exception!(sightline._errors, JobError);

/// The exception of a result that is refused, or of a look-up in it.
pub fn of_pvs(e: PvsError) -> PyErr {
    match e {
        PvsError::NoCell { .. } => PyIndexError::new_err(e.to_string()),
        e => Error::new_err(e.to_string()),
    }
}

/// The exception of a failed command.
pub fn of_command(e: CliError) -> PyErr {
    let text = in_python(&e.to_string());
    match e {
        CliError::Usage(_) => OptionError::new_err(text),
        CliError::Input(_) => InputError::new_err(text),
        CliError::Coordinator(_) => CoordinatorError::new_err(text),
        CliError::Job(_) => JobError::new_err(text),
        CliError::Internal(_) | CliError::Different(_) | CliError::Interrupted(_) => {
            SightlineError::new_err(text)
        }
    }
}

/// A message with options as Python writes them: `max_error` for `--max-error`.
fn in_python(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("--") {
        let (before, flag) = rest.split_at(at);
        let name = flag.trim_start_matches('-');
        let end = name
            .find(|c: char| !c.is_ascii_lowercase() && c != '-')
            .unwrap_or(name.len());
        out.push_str(before);
        // Only a word is an option.
        out.push_str(&if end > 0 {
            name[..end].replace('-', "_")
        } else {
            "--".to_owned()
        });
        rest = &name[end..];
    }
    out.push_str(rest);
    out.replace("give -o ", "give output ")
}
