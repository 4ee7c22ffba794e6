//! Traces of jobs: the options of all commands that send them, and the spans of a client.

use std::path::PathBuf;

use clap::Args;
use sightline_proto::v1;
use sightline_traces::{Begun, Settings, Span, TraceId, Traces, TracesError};

use crate::error::CliError;

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
    /// Begins to send, if that is asked for. `name` is that of the process among those of its kind.
    ///
    /// # Errors
    /// [`CliError::Usage`] for what is no address, [`CliError::Input`] for a file that cannot be read.
    pub fn start(&self, service: &'static str, name: &str) -> Result<Traces, CliError> {
        let Some(url) = self.traces.as_ref().filter(|url| !url.is_empty()) else {
            return Ok(Traces::default());
        };
        let read = |path: &PathBuf| {
            std::fs::read(path)
                .map_err(|e| CliError::Input(format!("{}: cannot be read: {e}", path.display())))
        };
        let ca = self
            .traces_ca
            .as_ref()
            .filter(|path| !path.as_os_str().is_empty())
            .map(read)
            .transpose()?;
        let settings = Settings {
            url: url.clone(),
            ca,
            service,
            instance: name.to_owned(),
        };
        Traces::start(settings).map_err(|e| match e {
            TracesError::Address { .. } => CliError::Usage(format!("--traces: {e}")),
            TracesError::System(_) => CliError::internal(e),
        })
    }
}

/// The spans of a submission: what the client did before there was a job, and until it had the answer. A job
/// that was there already has none of them.
pub fn submitted(traces: &Traces, answer: &v1::SubmitResponse, begun: Begun, uploaded: Begun) {
    let job = answer.job.as_ref().filter(|_| !answer.existing);
    // The coordinator that sends no traces names none.
    let Some((job, trace)) = job.and_then(|job| Some((job.id, TraceId::of_bytes(&job.trace)?)))
    else {
        return;
    };
    let submit = traces.fresh_id();
    let span = |name| Span::of(trace, name, begun).number("sightline.job", job);
    traces.send(span("upload").below(submit).end_at(uploaded));
    traces.send(span("submit").known_as(submit).below(trace.job()).end());
}
