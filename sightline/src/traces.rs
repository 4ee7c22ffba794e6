//! The collector of traces to which a process sends the spans of its jobs.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sightline_traces::{Settings, Traces, TracesError};

use crate::error::Error;

/// The collector of traces. Default: no collector, and no span is sent.
///
/// ```
/// use sightline::TraceOptions;
///
/// let traces = TraceOptions::default().start("my-tool", "host-1")?;
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TraceOptions {
    /// The address of the collector, which accepts OTLP over gRPC, such as http://127.0.0.1:4317.
    pub url: Option<String>,
    /// The path of the authority of the collector's certificate, as PEM. Default: the authorities of the
    /// system.
    pub ca: Option<PathBuf>,
}

impl TraceOptions {
    /// Starts sending spans if a collector is given. `name` identifies this process within the service.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] if the address is invalid, or [`crate::ErrorKind::Input`] if a file cannot
    /// be read.
    pub fn start(&self, service: &'static str, name: &str) -> Result<Traces, Error> {
        let Some(url) = self.url.as_ref().filter(|url| !url.is_empty()) else {
            return Ok(Traces::default());
        };
        let ca = self.ca.as_ref().filter(|path| !path.as_os_str().is_empty());
        let settings = Settings {
            url: url.clone(),
            ca: ca
                .map(|path| std::fs::read(path).map_err(|e| Error::reading(path, &e)))
                .transpose()?,
            service,
            instance: name.to_owned(),
        };
        Traces::start(settings).map_err(|e| match e {
            TracesError::Address { .. } => Error::usage(format!("--traces: {e}")).about("traces"),
            TracesError::System(_) => Error::internal(e),
        })
    }
}
