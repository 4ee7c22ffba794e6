//! The coordinator on the network: its services, health, reflection, and the tick.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use sightline_proto::v1::farm_server::FarmServer;
use sightline_proto::v1::jobs_server::JobsServer;
use sightline_proto::v1::results_server::ResultsServer;
use sightline_proto::v1::workers_server::WorkersServer;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_stream::wrappers::ReceiverStream;
use tonic::body::Body;
use tonic::codegen::http::{Request, Response};
use tonic::service::Routes;
use tonic::transport::Server;
use tonic::transport::server::{Router, TcpIncoming};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower::{BoxError, Layer, Service};

use super::blocking::{blocking, later};
use super::counting::Counting;
use super::farm::FarmService;
use super::guard::Guard;
use super::jobs::JobsService;
use super::results::ResultsService;
use super::tls::{self, Tls};
use super::workers::WorkersService;
use crate::housekeeping::tidy_up;
use crate::lifecycle;
use crate::readiness::readiness;
use crate::state::Coordinator;

/// How often timers are looked at.
const TICK: Duration = Duration::from_millis(200);

/// How often it is looked whether the coordinator is ready.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// Calls and streams of a connection at a time.
pub(super) const MOST_STREAMS: u32 = 256;

/// Ticks between two removals of what is not kept, and before the first one.
const TIDY: u32 = 5 * 600;
const TIDY_FIRST: u32 = 5 * 10;

/// Ticks between two looks at the file of tokens.
const REFRESH: u32 = 5;

/// How often connections are asked whether they live.
pub(super) const KEEPALIVE: Duration = Duration::from_secs(10);

/// A coordinator that cannot serve, or whose server stopped.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address would carry plain text beyond this machine.
    #[error(
        "{0} can be reached from other machines and traffic would not be encrypted; give --tls-cert and \
         --tls-key, listen on 127.0.0.1, or say --allow-plaintext when the network is private"
    )]
    Plaintext(SocketAddr),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}; is another coordinator running there?")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// The server ended by itself.
    #[error("the server stopped: {0}")]
    Broken(String),
}

/// Listens on `address`. Anything but loopback is refused unless `protected`: by encryption, or because the
/// user says that the network is private.
///
/// # Errors
/// [`ServeError`] when the address is not loopback or cannot be listened on.
pub async fn listen(address: SocketAddr, protected: bool) -> Result<TcpListener, ServeError> {
    if !address.ip().is_loopback() && !protected {
        return Err(ServeError::Plaintext(address));
    }
    TcpListener::bind(address).await.map_err(|source| ServeError::Listen { address, source })
}

/// Serves until `stop` resolves; encrypted if there are certificates.
///
/// # Errors
/// [`ServeError::Broken`] when the server ends by itself.
pub async fn serve(
    coordinator: Arc<Coordinator>,
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let services = Services::new();
    let routes = services.routes(&coordinator).await?;
    let ticks = tick(&coordinator);
    let looks = services.report_readiness(&coordinator);
    let server = Server::builder()
        .http2_keepalive_interval(Some(KEEPALIVE))
        .max_concurrent_streams(MOST_STREAMS)
        .layer(Counting::of(&coordinator))
        .layer(Guard(Arc::clone(&coordinator)))
        .add_routes(routes);
    let server = run(server, listener, tls);
    // Streams that stay open (workers, watchers) would delay a graceful end for ever. They are cut off: every
    // acknowledged change is on the disk already.
    let ended = tokio::select! {
        r = server => r,
        () = stop => Ok(()),
    };
    ticks.abort();
    looks.abort();
    coordinator.chronicle.write();
    ended
}

/// The services of a process, whose health is known before there is a coordinator.
pub(super) struct Services {
    reporter: HealthReporter,
    health: Routes,
}

impl Services {
    /// The process alone is healthy.
    pub(super) fn new() -> Self {
        let (reporter, health) = tonic_health::server::health_reporter();
        Self { reporter, health: Routes::new(health) }
    }

    /// The service of health alone.
    pub(super) fn health(&self) -> Routes {
        self.health.clone()
    }

    /// Keeps the health of the name `ready` up to date, until it is aborted.
    pub(super) fn report_readiness(&self, coordinator: &Arc<Coordinator>) -> JoinHandle<()> {
        tokio::spawn(report_readiness(Arc::clone(coordinator), self.reporter.clone()))
    }

    /// All services of a coordinator, which are healthy from now on.
    pub(super) async fn routes(&self, coordinator: &Arc<Coordinator>) -> Result<Routes, ServeError> {
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
        // Older tools ask by this name.
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

/// Looks at timers a few times a second, until it is aborted.
pub(super) fn tick(coordinator: &Arc<Coordinator>) -> JoinHandle<()> {
    let coordinator = Arc::clone(coordinator);
    tokio::spawn(async move {
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut ticks = 0u32;
        loop {
            tick.tick().await;
            ticks = ticks.wrapping_add(1);
            if let Some(access) = coordinator.access.get().filter(|_| ticks.is_multiple_of(REFRESH)) {
                let access = Arc::clone(access);
                tokio::task::spawn_blocking(move || access.refresh());
            }
            later(&coordinator, lifecycle::tick(&coordinator));
            if ticks % TIDY == TIDY_FIRST {
                let coordinator = Arc::clone(&coordinator);
                tokio::task::spawn_blocking(move || tidy_up(&coordinator));
            }
            if coordinator.chronicle.has_unwritten() {
                let coordinator = Arc::clone(&coordinator);
                tokio::task::spawn_blocking(move || coordinator.chronicle.write());
            }
        }
    })
}

/// Answers the connections of a listener, encrypted if there are certificates.
pub(super) async fn run<L>(
    server: Router<L>,
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
) -> Result<(), ServeError>
where
    L: Layer<Routes>,
    L::Service: Service<Request<Body>, Response = Response<Body>> + Clone + Send + 'static,
    <L::Service as Service<Request<Body>>>::Future: Send,
    <L::Service as Service<Request<Body>>>::Error: Into<BoxError> + Send,
{
    let served = match tls {
        // Without nodelay every small answer waits 40 ms for the acknowledgement of the one before.
        None => server.serve_with_incoming(TcpIncoming::from(listener).with_nodelay(Some(true))).await,
        Some(tls) => {
            let incoming = ReceiverStream::new(tls::connections(listener, tls, b"h2"));
            server.serve_with_incoming(incoming).await
        }
    };
    served.map_err(|e| ServeError::Broken(e.to_string()))
}

/// Keeps the health of the name `ready` up to date: liveness is the health without a name.
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
            true => (String::from("the coordinator is ready"), ServingStatus::Serving),
            false => {
                (format!("the coordinator is not ready: {}", reasons.join("; ")), ServingStatus::NotServing)
            }
        };
        // At the start everybody expects it to become ready.
        if was.is_some() || !reasons.is_empty() {
            tracing::warn!("{is}");
        }
        health.set_service_status("ready", status).await;
        was = Some(reasons);
    }
}
