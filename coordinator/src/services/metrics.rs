//! Metrics and health for monitoring systems: `/metrics`, `/livez` and `/readyz`, over plain HTTP.
//!
//! The answers contain names of workers, but no jobs, scenes, users or secrets, so callers need no token.

use std::convert::Infallible;
use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;

use super::connections::{Listener, Protocol};
use crate::coordinator::Coordinator;
use crate::telemetry::metrics::FarmReadings;
use crate::telemetry::readiness::readiness;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// A component that reports metrics and readiness. Both calls may block on the disk.
pub trait Probed: Send + Sync + 'static {
    /// Returns the metrics as OpenMetrics text.
    ///
    /// # Errors
    /// A sentence with the reason, if the metrics cannot be written.
    fn metrics(&self) -> Result<String, String>;

    /// Checks that the component can do its work.
    ///
    /// # Errors
    /// The reasons, one sentence each.
    fn readiness(&self) -> Result<(), Vec<String>>;
}

impl Probed for Coordinator {
    fn metrics(&self) -> Result<String, String> {
        self.telemetry
            .metrics
            .text(readings(self))
            .map_err(|e| e.to_string())
    }

    fn readiness(&self) -> Result<(), Vec<String>> {
        readiness(self)
    }
}

/// Serves metrics and health until the future is dropped.
pub async fn serve_probes<P: Probed>(probed: Arc<P>, listener: Listener) -> Infallible {
    let routes = Router::new()
        .route("/metrics", get(metrics::<P>))
        .route("/livez", get(|| async { "alive\n" }))
        .route("/readyz", get(ready::<P>))
        .with_state(probed);
    listener.serve(None, Protocol::Http1, routes).await
}

/// Queries a component on one of tokio's threads for blocking work.
async fn asked<P: Probed, T: Send + 'static>(
    source: Arc<P>,
    ask: impl FnOnce(&P) -> T + Send + 'static,
) -> Result<T, Response> {
    let answer = tokio::task::spawn_blocking(move || ask(&source)).await;
    answer.map_err(|e| (StatusCode::SERVICE_UNAVAILABLE, format!("{e}\n")).into_response())
}

async fn metrics<P: Probed>(State(probed): State<Arc<P>>) -> Response {
    match asked(probed, |probed| probed.metrics()).await {
        Ok(Ok(text)) => ([(header::CONTENT_TYPE, OPEN_METRICS)], text).into_response(),
        Ok(Err(e)) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{e}\n")).into_response(),
        Err(stopped) => stopped,
    }
}

async fn ready<P: Probed>(State(probed): State<Arc<P>>) -> Response {
    match asked(probed, |probed| probed.readiness()).await {
        Ok(Ok(())) => "ready\n".into_response(),
        Ok(Err(reasons)) => {
            let reasons: String = reasons.iter().map(|reason| format!("{reason}\n")).collect();
            (
                StatusCode::SERVICE_UNAVAILABLE,
                format!("not ready\n{reasons}"),
            )
                .into_response()
        }
        Err(stopped) => stopped,
    }
}

/// Returns the current state of the farm, for metrics.
fn readings(c: &Coordinator) -> FarmReadings {
    let (ready, now) = (readiness(c).is_ok(), c.scheduler_now());
    c.dispatcher.read(|scheduler| FarmReadings {
        ready,
        jobs: scheduler.counts(),
        members: scheduler.roster(now),
        quarantined: scheduler.quarantined().len(),
        data_dir: c.config.data_dir.clone(),
        carried: c.blobs.carried(),
    })
}
