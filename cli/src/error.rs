//! The errors that end a command, and their exit codes (the table of `docs/interfaces.md`).

use std::path::Path;
use std::process::ExitCode;

use sightline_scene::SceneError;

use crate::exhaustion::Exhausted;

/// The first words of an error that the coordinator has reported.
const ANSWERED: &str = "the coordinator answered";

/// The exit code of a fault of the program or the machine.
pub const INTERNAL: u8 = 1;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// Exit code 1: a fault of the program or the machine.
    #[error("{0}")]
    Internal(String),
    /// Exit code 2: wrong arguments.
    #[error("{0}")]
    Usage(String),
    /// Exit code 3: a file or stored data that cannot be used.
    #[error("{0}")]
    Input(String),
    /// Exit code 4: the coordinator is unreachable or refuses.
    #[error("{0}")]
    Coordinator(String),
    /// Exit code 5: the job ended without a result.
    #[error("{0}")]
    Job(String),
    /// Exit code 6: two results differ by more than was allowed.
    #[error("{0}")]
    Different(String),
    /// Exit code 130: Ctrl-C or SIGTERM.
    #[error("{0}")]
    Interrupted(String),
}

impl From<sightline_bench::BenchError> for CliError {
    fn from(e: sightline_bench::BenchError) -> Self {
        use sightline_bench::BenchError as B;
        match e {
            B::Usage(m) => Self::Usage(m),
            B::Input(m) => Self::Input(m),
            B::Coordinator(m) => Self::Coordinator(m),
            B::Job(m) => Self::Job(m),
            B::Interrupted(m) => Self::Interrupted(m),
            B::Internal(m) => Self::Internal(m),
        }
    }
}

impl CliError {
    /// The exit code.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Self::Internal(_) => INTERNAL,
            Self::Usage(_) => 2,
            Self::Input(_) => 3,
            Self::Coordinator(_) => 4,
            Self::Job(_) => 5,
            Self::Different(_) => 6,
            Self::Interrupted(_) => 130,
        })
    }

    /// Finds the resource of this process that was exhausted, which is not a fault of the command's input.
    /// The coordinator of a bake is part of the process.
    pub fn exhausted(&self, is_bake: bool) -> Option<Exhausted> {
        match self {
            // A thread that cannot start, where the error reports nothing else.
            Self::Internal(text) if text.starts_with("Resource temporarily unavailable") => {
                Some(Exhausted::Threads)
            }
            Self::Internal(text) | Self::Input(text) | Self::Usage(text) => {
                Exhausted::in_error(text)
            }
            Self::Coordinator(text) if is_bake || !text.starts_with(ANSWERED) => {
                Exhausted::in_error(text)
            }
            Self::Job(text) if is_bake => Exhausted::in_error(text),
            _ => None,
        }
    }

    /// Returns the exit code of a bake, whose coordinator is part of the process. A coordinator that does not
    /// answer is a fault of the machine then.
    pub fn exit_code_of_bake(&self) -> ExitCode {
        match self {
            Self::Coordinator(_) => ExitCode::from(INTERNAL),
            _ => self.exit_code(),
        }
    }

    /// A fault of the program or the machine.
    pub fn internal(e: impl std::fmt::Display) -> Self {
        Self::Internal(e.to_string())
    }

    /// An output file that cannot be written.
    pub fn writing(path: &Path, e: &std::io::Error) -> Self {
        Self::Internal(format!(
            "{} cannot be written: {e}; check the folder and the space left",
            path.display()
        ))
    }

    /// Standard output that cannot be written.
    pub fn stdout(e: &std::io::Error) -> Self {
        Self::Internal(format!(
            "stdout cannot be written: {e}; check the space left where it is redirected to"
        ))
    }

    /// A gRPC status: an answer of the coordinator, or an error of the connection to it.
    pub fn status(s: &tonic::Status) -> Self {
        if let Some(reason) = sightline_proto::connecting::broken(s) {
            return Self::Coordinator(format!(
                "the connection to the coordinator failed ({reason}); submitted jobs continue there, and \
                 the same command connects again"
            ));
        }
        match s.code() {
            tonic::Code::InvalidArgument => Self::Input(s.message().to_owned()),
            tonic::Code::DataLoss => Self::Internal(s.message().to_owned()),
            code if s.message().is_empty() => Self::Coordinator(format!("{ANSWERED}: {code}")),
            _ => Self::Coordinator(format!("{ANSWERED}: {}", s.message())),
        }
    }
}

impl From<SceneError> for CliError {
    fn from(e: SceneError) -> Self {
        Self::Input(e.to_string())
    }
}

impl From<sightline_pvs::PvsError> for CliError {
    fn from(e: sightline_pvs::PvsError) -> Self {
        match e {
            sightline_pvs::PvsError::Memory { .. } => Self::Internal(e.to_string()),
            e => Self::Input(e.to_string()),
        }
    }
}
