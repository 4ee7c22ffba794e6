//! The error of every function of the library: its kind, the responsible option, and a sentence with the
//! reason and the remedy.

use std::path::Path;

use sightline_model::{OutOfRange, SpecError};
use sightline_pvs::PvsError;
use sightline_scene::SceneError;
use sightline_viewcells::DivisionError;

/// The kind of an error. The command maps each kind to an exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    /// An option, or a combination of options, is invalid.
    Usage,
    /// A file, or stored data, cannot be used.
    Input,
    /// A coordinator cannot be reached, or rejects a request.
    Coordinator,
    /// A job ended without a result.
    Job,
    /// Two results differ by more than permitted.
    Different,
    /// The observer cancelled the work ([`crate::Observer::is_cancelled`]).
    Cancelled,
    /// The program or the machine has a fault.
    Internal,
}

/// The error of a function of this library.
///
/// ```
/// use sightline::{ErrorKind, JobOptions, LoadOptions, SceneSource, Silent, read_scene};
///
/// let source = SceneSource::File("absent.glb".into());
/// let error = read_scene(&source, &LoadOptions::default(), &Silent).unwrap_err();
/// assert_eq!(error.kind(), ErrorKind::Input);
/// assert!(error.to_string().contains("absent.glb"));
/// ```
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Error {
    kind: ErrorKind,
    option: Option<&'static str>,
    /// True if the error is about the scene, and the text does not contain the scene's name.
    is_about_scene: bool,
    text: String,
}

impl Error {
    /// Creates an error of a kind.
    pub fn new(kind: ErrorKind, text: impl Into<String>) -> Self {
        Self {
            kind,
            option: None,
            is_about_scene: false,
            text: text.into(),
        }
    }

    /// Creates an error about options.
    pub fn usage(text: impl Into<String>) -> Self {
        Self::new(ErrorKind::Usage, text)
    }

    /// Creates an error about a file or stored data.
    pub fn input(text: impl Into<String>) -> Self {
        Self::new(ErrorKind::Input, text)
    }

    /// Creates an error about a coordinator.
    pub fn coordinator(text: impl Into<String>) -> Self {
        Self::new(ErrorKind::Coordinator, text)
    }

    /// Creates an error about a job that ended without a result.
    pub fn job(text: impl Into<String>) -> Self {
        Self::new(ErrorKind::Job, text)
    }

    /// Creates an error about results that differ.
    pub fn different(text: impl Into<String>) -> Self {
        Self::new(ErrorKind::Different, text)
    }

    /// Creates the error of cancelled work.
    pub fn cancelled(text: impl Into<String>) -> Self {
        Self::new(ErrorKind::Cancelled, text)
    }

    /// Creates an error about a fault of the program or the machine.
    pub fn internal(e: impl std::fmt::Display) -> Self {
        Self::new(ErrorKind::Internal, e.to_string())
    }

    /// Creates the error of an input file that cannot be read.
    pub fn reading(path: &Path, e: &std::io::Error) -> Self {
        Self::input(format!(
            "{} cannot be read: {e}; check the path and its permissions",
            path.display()
        ))
    }

    /// Creates the error of an output file that cannot be written.
    pub fn writing(path: &Path, e: &std::io::Error) -> Self {
        Self::internal(format!(
            "{} cannot be written: {e}; check the folder and the free disk space",
            path.display()
        ))
    }

    /// Returns the error with the responsible option, as the command line spells it, without dashes.
    pub fn about(self, option: &'static str) -> Self {
        Self {
            option: Some(option),
            ..self
        }
    }

    /// Creates an error about a scene whose file is not known here.
    pub(crate) fn scene(text: impl Into<String>) -> Self {
        Self {
            is_about_scene: true,
            ..Self::input(text)
        }
    }

    /// Returns the error with `path` in front of the text if the error is about the scene, and otherwise the
    /// unchanged error.
    #[must_use]
    pub fn naming_scene(self, path: &Path) -> Self {
        match self.is_about_scene {
            true => Self {
                is_about_scene: false,
                text: format!("{}: {}", path.display(), self.text),
                ..self
            },
            false => self,
        }
    }

    /// Returns the kind of the error.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// Returns the option that the error is about, as the command line spells it, without dashes.
    pub fn option(&self) -> Option<&'static str> {
        self.option
    }

    /// Replaces the text of an error about cancelled work. Other errors stay unchanged.
    pub(crate) fn or_cancelled(self, text: impl FnOnce() -> String) -> Self {
        match self.kind {
            ErrorKind::Cancelled => Self::cancelled(text()),
            _ => self,
        }
    }

    /// Converts a gRPC status, which is either an answer of the coordinator or a connection error.
    pub fn status(s: &tonic::Status) -> Self {
        if let Some(reason) = sightline_proto::connection::broken(s) {
            return Self::coordinator(format!(
                "the connection to the coordinator failed ({reason}); submitted jobs continue on the \
                 farm; run the same command again to reconnect"
            ));
        }
        match s.code() {
            tonic::Code::InvalidArgument => Self::input(s.message()),
            tonic::Code::DataLoss => Self::internal(s.message()),
            code if s.message().is_empty() => Self::coordinator(format!("{ANSWERED}: {code}")),
            _ => Self::coordinator(format!("{ANSWERED}: {}", s.message())),
        }
    }

    /// Returns true if the coordinator reported the error, and false for connection errors.
    pub fn is_answer_of_coordinator(&self) -> bool {
        self.kind == ErrorKind::Coordinator && self.text.starts_with(ANSWERED)
    }
}

/// The first words of an error that the coordinator reported.
const ANSWERED: &str = "the coordinator answered";

impl From<SceneError> for Error {
    fn from(e: SceneError) -> Self {
        Self::input(e.to_string())
    }
}

impl From<PvsError> for Error {
    fn from(e: PvsError) -> Self {
        match e {
            PvsError::Memory { .. } => Self::internal(e),
            e => Self::input(e.to_string()),
        }
    }
}

impl From<OutOfRange> for Error {
    fn from(e: OutOfRange) -> Self {
        Self::usage(e.to_string()).about(e.option)
    }
}

impl From<SpecError> for Error {
    fn from(e: SpecError) -> Self {
        let error = Self::usage(e.to_string());
        match e.option() {
            Some(option) => error.about(option),
            None => error,
        }
    }
}

impl From<DivisionError> for Error {
    fn from(e: DivisionError) -> Self {
        SpecError::from(e).into()
    }
}
