//! The options of all commands that send traces of jobs.

use std::path::PathBuf;

use clap::Args;
use sightline::TraceOptions;

#[derive(Args, Debug, Clone, Default)]
pub struct TraceArgs {
    /// Address of an OpenTelemetry collector for traces of jobs, by OTLP over gRPC, such as
    /// http://127.0.0.1:4317. An unreachable collector does not delay jobs: spans are lost, and the log
    /// reports the loss. Default: off.
    #[arg(
        long,
        value_name = "URL",
        env = "SIGHTLINE_TRACES",
        hide_env_values = true
    )]
    pub traces: Option<String>,
    /// The authority of the certificate of the collector, as PEM. Default: the authorities of the system.
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
