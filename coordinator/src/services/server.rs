//! The server of a coordinator: services, health, reflection, and the tick.

use std::convert::Infallible;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use futures::future::BoxFuture;
use sightline_proto::v1::farm_server::FarmServer;
use sightline_proto::v1::jobs_server::JobsServer;
use sightline_proto::v1::results_server::ResultsServer;
use sightline_proto::v1::workers_server::WorkersServer;
use tokio::task::JoinHandle;
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::http::{Request, Response};
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower::{Layer as _, Service};

use super::authorize::{AuthorizeLayer, Authorized};
use super::blocking::{blocking, later};
use super::call_metrics::{CallMetrics, Counted};
use super::connections::{Listener, Protocol, ServeError};
use super::farm::FarmService;
use super::jobs::JobsService;
use super::results::ResultsService;
use super::tls::Tls;
use super::workers::WorkersService;
use crate::coordinator::Coordinator;
use crate::jobs::retention::tidy_up;
use crate::jobs::retention_stamp;
use crate::startup;
use crate::telemetry::readiness::readiness;

/// The time between two ticks of the timers.
const TICK: Duration = Duration::from_millis(200);

/// The time between two checks of the coordinator's readiness.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// The number of ticks between two runs of retention, which is 10 minutes.
const TIDY: u32 = 5 * 600;
/// The number of ticks before the first run of retention, which is 10 s.
const TIDY_FIRST: u32 = 5 * 10;

/// The number of ticks between two checks of the token file, which is 1 s.
const REFRESH: u32 = 5;

/// Serves until `stop` resolves. Connections are encrypted if `tls` has certificates.
///
/// # Errors
/// [`ServeError::Broken`] if the server ends by itself.
pub async fn serve(
    coordinator: Arc<Coordinator>,
    listener: Listener,
    tls: Option<Arc<Tls>>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let services = Services::new();
    let routes = services.routes(&coordinator).await?;
    let ticks = tick(&coordinator);
    let looks = services.report_readiness(&coordinator);
    let authorized = AuthorizedServices::new(&coordinator, routes);
    // Open streams of workers and watchers would delay a graceful end forever, so they are cut off. Every
    // acknowledged change is already on the disk.
    tokio::select! {
        never = listener.serve(tls, Protocol::Http2, authorized) => match never {},
        () = stop => {}
    }
    ticks.abort();
    looks.abort();
    coordinator.telemetry.event_log.write();
    Ok(())
}

/// The service of a coordinator: counts, authorizes and answers calls.
#[derive(Clone)]
pub(super) struct AuthorizedServices(Counted<Authorized<Routes>>);

impl AuthorizedServices {
    /// Wraps the services of a coordinator in its layers.
    pub(super) fn new(coordinator: &Arc<Coordinator>, routes: Routes) -> Self {
        let guarded = AuthorizeLayer(Arc::clone(coordinator)).layer(routes);
        Self(CallMetrics::new(coordinator).layer(guarded))
    }
}

impl Service<Request<axum::body::Body>> for AuthorizedServices {
    type Response = Response<axum::body::Body>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Self::Response, Infallible>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        self.0.poll_ready(context)
    }

    fn call(&mut self, request: Request<axum::body::Body>) -> Self::Future {
        let limit = request
            .headers()
            .get("grpc-timeout")
            .and_then(|text| timeout_of(text.to_str().ok()?));
        let answer = self.0.call(request.map(Body::new));
        Box::pin(async move {
            let answer = match limit {
                None => answer.await?,
                Some(limit) => match tokio::time::timeout(limit, answer).await {
                    Ok(answer) => answer?,
                    Err(_) => {
                        Status::deadline_exceeded(format!("no answer within {limit:?}")).into_http()
                    }
                },
            };
            Ok(answer.map(axum::body::Body::new))
        })
    }
}

/// Parses a timeout in the format of the gRPC specification: up to eight digits and a unit.
fn timeout_of(text: &str) -> Option<Duration> {
    let (at, unit) = text.char_indices().last()?;
    let digits = text
        .get(..at)
        .filter(|digits| (1..=8).contains(&digits.len()))?;
    let count = digits
        .bytes()
        .all(|b| b.is_ascii_digit())
        .then(|| digits.parse::<u64>().ok())??;
    Some(match unit {
        'H' => Duration::from_secs(count * 3600),
        'M' => Duration::from_secs(count * 60),
        'S' => Duration::from_secs(count),
        'm' => Duration::from_millis(count),
        'u' => Duration::from_micros(count),
        'n' => Duration::from_nanos(count),
        _ => return None,
    })
}

/// The services of a process. Its health is available before a coordinator exists.
pub(super) struct Services {
    reporter: HealthReporter,
    health: Routes,
}

impl Services {
    /// Creates services that report only the process as healthy.
    pub(super) fn new() -> Self {
        let (reporter, health) = tonic_health::server::health_reporter();
        Self {
            reporter,
            health: Routes::new(health),
        }
    }

    /// Returns only the health service.
    pub(super) fn health(&self) -> Routes {
        self.health.clone()
    }

    /// Starts a task that keeps the health of the name `ready` up to date until the task is aborted.
    pub(super) fn report_readiness(&self, coordinator: &Arc<Coordinator>) -> JoinHandle<()> {
        tokio::spawn(report_readiness(
            Arc::clone(coordinator),
            self.reporter.clone(),
        ))
    }

    /// Returns all services of a coordinator, and reports them as healthy.
    pub(super) async fn routes(
        &self,
        coordinator: &Arc<Coordinator>,
    ) -> Result<Routes, ServeError> {
        let broken = |e: &dyn std::fmt::Display| ServeError::Broken(e.to_string());
        let health = &self.reporter;
        health.set_serving::<JobsServer<JobsService>>().await;
        health.set_serving::<WorkersServer<WorkersService>>().await;
        health.set_serving::<FarmServer<FarmService>>().await;
        health.set_serving::<ResultsServer<ResultsService>>().await;
        let reflected = || {
            tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(sightline_proto::DESCRIPTORS)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        };
        let reflection = reflected().build_v1().map_err(|e| broken(&e))?;
        // Older tools use this name of the reflection service.
        let older = reflected().build_v1alpha().map_err(|e| broken(&e))?;
        Ok(self
            .health()
            .add_service(reflection)
            .add_service(older)
            .add_service(JobsServer::new(JobsService(Arc::clone(coordinator))))
            .add_service(FarmServer::new(FarmService(Arc::clone(coordinator))))
            .add_service(ResultsServer::new(ResultsService(Arc::clone(coordinator))))
            .add_service(WorkersServer::new(WorkersService(Arc::clone(coordinator)))))
    }
}

/// Starts a task that passes the time to the timers at each tick, until the task is aborted.
pub(super) fn tick(coordinator: &Arc<Coordinator>) -> JoinHandle<()> {
    let coordinator = Arc::clone(coordinator);
    tokio::spawn(async move {
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut ticks = 0u32;
        loop {
            tick.tick().await;
            ticks = ticks.wrapping_add(1);
            if let Some(access) = coordinator
                .users
                .access
                .get()
                .filter(|_| ticks.is_multiple_of(REFRESH))
            {
                let access = Arc::clone(access);
                tokio::task::spawn_blocking(move || access.refresh());
            }
            later(&coordinator, startup::tick(&coordinator));
            if ticks % TIDY == TIDY_FIRST {
                let coordinator = Arc::clone(&coordinator);
                tokio::task::spawn_blocking(move || tidy_up(&coordinator));
            }
            if retention_stamp::is_due(&coordinator) {
                let coordinator = Arc::clone(&coordinator);
                tokio::task::spawn_blocking(move || retention_stamp::record_if_due(&coordinator));
            }
            if coordinator.telemetry.event_log.has_unwritten() {
                let coordinator = Arc::clone(&coordinator);
                tokio::task::spawn_blocking(move || coordinator.telemetry.event_log.write());
            }
        }
    })
}

/// Keeps the health of the name `ready` up to date. The health without a name reports liveness.
async fn report_readiness(c: Arc<Coordinator>, health: tonic_health::server::HealthReporter) {
    let mut every = tokio::time::interval(LOOK_EVERY);
    let mut was = None;
    loop {
        every.tick().await;
        let now = blocking(&c, |c| Ok(readiness(c))).await;
        let reasons = match now {
            Ok(Ok(())) => Vec::new(),
            Ok(Err(reasons)) => reasons,
            Err(status) => vec![status.message().to_owned()],
        };
        if was.as_ref() == Some(&reasons) {
            continue;
        }
        let (is, status) = match reasons.is_empty() {
            true => (
                String::from("the coordinator is ready"),
                ServingStatus::Serving,
            ),
            false => (
                format!("the coordinator is not ready: {}", reasons.join("; ")),
                ServingStatus::NotServing,
            ),
        };
        // The first readiness after a start is expected, so it is not logged as a warning.
        if was.is_some() || !reasons.is_empty() {
            tracing::warn!("{is}");
        }
        health.set_service_status("ready", status).await;
        was = Some(reasons);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timeouts_of_grpc_are_parsed() {
        for (text, seconds) in [
            ("2H", 7200.0),
            ("3M", 180.0),
            ("99999999S", 99_999_999.0),
            ("5m", 0.005),
        ] {
            assert_eq!(
                timeout_of(text),
                Some(Duration::from_secs_f64(seconds)),
                "{text}"
            );
        }
        assert_eq!(timeout_of("7u"), Some(Duration::from_micros(7)));
        assert_eq!(timeout_of("7n"), Some(Duration::from_nanos(7)));
        for bad in ["", "S", "123456789S", "-1S", "1", "1x", "1é"] {
            assert_eq!(timeout_of(bad), None, "{bad:?}");
        }
    }
}
