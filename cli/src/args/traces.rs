//! The options of all commands that send traces of jobs.

use std::path::PathBuf;

use clap::Args;
use sightline::TraceOptions;

#[derive(Args, Debug, Clone, Default)]
pub struct TraceArgs {
    /// Send traces of jobs to this collector of OpenTelemetry, by OTLP over gRPC, such as
    /// http://127.0.0.1:4317. One that is away delays nothing: spans are lost, and the log says so. Off by
    /// default.
    #[arg(
        long,
        value_name = "URL",
        env = "SIGHTLINE_TRACES",
        hide_env_values = true
    )]
    pub traces: Option<String>,
    /// The authority of the collector's certificate, as PEM. Default: those of the system.
    #[arg(
        long,
        value_name = "FILE",
        env = "SIGHTLINE_TRACES_CA",
        hide_env_values = true
    )]
    pub traces_ca: Option<PathBuf>,
}

impl TraceArgs {
    /// Returns the options for the library.
    pub fn options(&self) -> TraceOptions {
        TraceOptions {
            url: self.traces.clone(),
            ca: self.traces_ca.clone(),
        }
    }
}
