//! Conversions of library errors into exceptions of the package, with Python's names of options.

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use sightline::{Error as LibraryError, ErrorKind};
use sightline_pvs::PvsError;

pyo3::import_exception!(sightline._errors, SightlineError);
pyo3::import_exception!(sightline._errors, OptionError);
pyo3::import_exception!(sightline._errors, InputError);
pyo3::import_exception!(sightline._errors, Error);
pyo3::import_exception!(sightline._errors, CoordinatorError);
pyo3::import_exception!(sightline._errors, JobError);

/// Creates the exception of a rejected result, or of a failed look-up in a result.
pub fn of_pvs(e: PvsError) -> PyErr {
    match e {
        PvsError::NoCell { .. } => PyIndexError::new_err(e.to_string()),
        e => Error::new_err(e.to_string()),
    }
}

/// Creates the exception of an error of the library.
pub fn from_library(e: LibraryError) -> PyErr {
    let text = in_python(&e.to_string());
    match e.kind() {
        ErrorKind::Usage => {
            let option = e.option().map(|option| option.replace('-', "_"));
            OptionError::new_err((text, option))
        }
        ErrorKind::Input => InputError::new_err(text),
        ErrorKind::Coordinator => CoordinatorError::new_err(text),
        ErrorKind::Job => JobError::new_err(text),
        ErrorKind::Internal | ErrorKind::Different | ErrorKind::Cancelled => {
            SightlineError::new_err(text)
        }
    }
}

/// Reads options from JSON text.
pub fn parse<T: DeserializeOwned>(text: &str) -> PyResult<T> {
    serde_json::from_str(text).map_err(|e| OptionError::new_err(e.to_string()))
}

/// Returns a message with Python's names of options: `max_error` for `--max-error`.
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
        // Two dashes without a word are not an option.
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
