//! Metrics and health for machines that watch a service: `/metrics`, `/livez` and `/readyz`, as plain HTTP.
//!
//! There are names of workers in it, and no jobs, scenes, users or secrets, so nobody is asked for a token.

use std::convert::Infallible;
use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;

use super::connections::{Listener, Protocol};
use crate::state::Coordinator;
use crate::telemetry::metrics::FarmReadings;
use crate::telemetry::readiness::readiness;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Something that tells of itself. Both calls may block on the disk.
pub trait Probed: Send + Sync + 'static {
    /// Its metrics as OpenMetrics text.
    ///
    /// # Errors
    /// A sentence, when they cannot be written.
    fn metrics(&self) -> Result<String, String>;

    /// Whether it can do its work.
    ///
    /// # Errors
    /// Why not, a sentence each.
    fn readiness(&self) -> Result<(), Vec<String>>;
}

impl Probed for Coordinator {
    fn metrics(&self) -> Result<String, String> {
        self.metrics.text(moment(self)).map_err(|e| e.to_string())
    }

    fn readiness(&self) -> Result<(), Vec<String>> {
        readiness(self)
    }
}

/// Serves metrics and health until this is dropped.
pub async fn serve_probes<P: Probed>(of: Arc<P>, listener: Listener) -> Infallible {
    let routes = Router::new()
        .route("/metrics", get(metrics::<P>))
        .route("/livez", get(|| async { "alive\n" }))
        .route("/readyz", get(ready::<P>))
        .with_state(of);
    listener.serve(None, Protocol::Http1, routes).await
}

/// Asks on one of tokio's threads for blocking work.
async fn asked<P: Probed, T: Send + 'static>(
    of: Arc<P>,
    ask: impl FnOnce(&P) -> T + Send + 'static,
) -> Result<T, Response> {
    let answer = tokio::task::spawn_blocking(move || ask(&of)).await;
    answer.map_err(|e| (StatusCode::SERVICE_UNAVAILABLE, format!("{e}\n")).into_response())
}

async fn metrics<P: Probed>(State(of): State<Arc<P>>) -> Response {
    match asked(of, |of| of.metrics()).await {
        Ok(Ok(text)) => ([(header::CONTENT_TYPE, OPEN_METRICS)], text).into_response(),
        Ok(Err(e)) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{e}\n")).into_response(),
        Err(stopped) => stopped,
    }
}

async fn ready<P: Probed>(State(of): State<Arc<P>>) -> Response {
    match asked(of, |of| of.readiness()).await {
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

/// How things stand.
fn moment(c: &Coordinator) -> FarmReadings {
    let (ready, now) = (readiness(c).is_ok(), c.now_plain());
    let scheduler = &c.lock().scheduler;
    FarmReadings {
        ready,
        jobs: scheduler.counts(),
        members: scheduler.roster(now),
        quarantined: scheduler.quarantined().len(),
        data_dir: c.data_dir.clone(),
        carried: c.blobs.carried(),
    }
}
