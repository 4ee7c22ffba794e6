//! What ends the program early, and the exit code for it (the contract's table).

use std::path::Path;
use std::process::ExitCode;

use sightline_scene::SceneError;

/// Why a command did not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// 1: a fault of the program or the machine.
    #[error("{0}")]
    Internal(String),
    /// 2: the arguments.
    #[error("{0}")]
    Usage(String),
    /// 3: a file or stored thing that cannot be used.
    #[error("{0}")]
    Input(String),
    /// 4: the coordinator is not there or refuses.
    #[error("{0}")]
    Coordinator(String),
    /// 5: the job ended without a result.
    #[error("{0}")]
    Job(String),
    /// 130: Ctrl-C.
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
            Self::Internal(_) => 1,
            Self::Usage(_) => 2,
            Self::Input(_) => 3,
            Self::Coordinator(_) => 4,
            Self::Job(_) => 5,
            Self::Interrupted(_) => 130,
        })
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

    /// What a coordinator answered.
    pub fn status(s: &tonic::Status) -> Self {
        // Only what the transport itself says has a source.
        if std::error::Error::source(s).is_some() {
            return Self::Coordinator(format!(
                "the connection to the coordinator failed ({}); what was submitted goes on there, and the \
                    same command asks again",
                s.message()
            ));
        }
        match s.code() {
            tonic::Code::InvalidArgument => Self::Input(s.message().to_owned()),
            tonic::Code::DataLoss => Self::Internal(s.message().to_owned()),
            code if s.message().is_empty() => Self::Coordinator(format!("the coordinator answered: {code}")),
            _ => Self::Coordinator(format!("the coordinator answered: {}", s.message())),
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
        Self::Input(e.to_string())
    }
}
