//! Metrics and health for machines that watch a service: `/metrics`, `/livez` and `/readyz`, as plain HTTP.
//!
//! There are names of workers in it, and no jobs, scenes, users or secrets, so nobody is asked for a token.

use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;
use tokio::net::TcpListener;

use super::blocking::blocking;
use super::server::ServeError;
use super::status;
use crate::metrics::Moment;
use crate::readiness::readiness;
use crate::state::Coordinator;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Serves the metrics until `stop` resolves.
///
/// # Errors
/// [`ServeError::Broken`] when the server ends by itself.
pub async fn serve_metrics(
    coordinator: Arc<Coordinator>,
    listener: TcpListener,
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let routes = Router::new()
        .route("/metrics", get(metrics))
        .route("/livez", get(|| async { "alive\n" }))
        .route("/readyz", get(ready))
        .with_state(coordinator);
    tokio::select! {
        r = axum::serve(listener, routes) => r.map_err(|e| ServeError::Broken(e.to_string())),
        () = stop => Ok(()),
    }
}

async fn metrics(State(c): State<Arc<Coordinator>>) -> Response {
    let text = blocking(&c, |c| {
        let moment = moment(c);
        c.metrics.text(moment).map_err(|e| status::internal(&e.to_string()))
    });
    match text.await {
        Ok(text) => ([(header::CONTENT_TYPE, OPEN_METRICS)], text).into_response(),
        Err(e) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{}\n", e.message())).into_response(),
    }
}

/// How things stand.
fn moment(c: &Coordinator) -> Moment {
    let (ready, now) = (readiness(c).is_ok(), c.now_plain());
    let machine = &c.lock().machine;
    Moment {
        ready,
        jobs: machine.counts(),
        members: machine.roster(now),
        quarantined: machine.quarantined().len(),
        data_dir: c.data_dir.clone(),
    }
}

async fn ready(State(c): State<Arc<Coordinator>>) -> Response {
    match blocking(&c, |c| Ok(readiness(c))).await {
        Ok(Ok(())) => "ready\n".into_response(),
        Ok(Err(reasons)) => {
            let reasons: String = reasons.iter().map(|reason| format!("{reason}\n")).collect();
            (StatusCode::SERVICE_UNAVAILABLE, format!("not ready\n{reasons}")).into_response()
        }
        Err(e) => (StatusCode::SERVICE_UNAVAILABLE, format!("not ready\n{}\n", e.message())).into_response(),
    }
}
