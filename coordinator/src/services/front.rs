//! The front of a replica: forwards calls to the leading coordinator, in this process or elsewhere.

use std::convert::Infallible;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use axum::http::{StatusCode, header};
use futures::future::BoxFuture;
use sightline_proto::connection::Credentials;
use sightline_store::{PostgresStore, Replica, Role, StoreError};
use tokio::sync::watch;
use tonic::codegen::http::{Request, Response};
use tonic::{Code, Status};
use tower::{Service, ServiceExt as _};

use super::connections::{Listener, Peer, Protocol, ServeError};
use super::forwarder::Forwarder;
use super::http::serve_http;
use super::metrics::Probed;
use super::server::{self, AuthorizedServices, Services};
use super::tls::Tls;
use crate::access::{Need, Scope, needed};
use crate::coordinator::Coordinator;
use crate::startup::OpenError;
use crate::telemetry::metrics::standby_metrics;

/// Maximum time that a call waits for a leader. A takeover is faster.
const PATIENCE: Duration = Duration::from_secs(8);

/// The reason why a replica ends.
#[derive(Debug, thiserror::Error)]
pub enum ReplicaError {
    /// Another replica leads, or may lead.
    #[error(transparent)]
    Ended(StoreError),
    /// The replica became the leader, but could not open the coordinator.
    #[error("this coordinator could not become the leader: {0}")]
    Open(#[from] OpenError),
    /// The server of the coordinator failed.
    #[error(transparent)]
    Serve(#[from] ServeError),
}

/// The network front of a replica.
#[derive(Clone)]
pub struct Front(Arc<Inside>);

struct Inside {
    /// The credentials for calls to other coordinators.
    credentials: Credentials,
    /// True if certificates may identify workers. A forwarded call cannot carry a certificate.
    certified: bool,
    services: Services,
    leadership: watch::Sender<Leadership>,
}

/// The leading coordinator, which answers calls.
#[derive(Clone)]
enum Leadership {
    /// No known coordinator leads.
    Unknown,
    /// The coordinator at this address leads, and calls are forwarded to it.
    Remote(Arc<Forwarder>, String),
    /// This coordinator leads.
    Local(AuthorizedServices, Arc<Coordinator>),
}

impl Front {
    /// Creates a front without a leader. Calls to other coordinators use `credentials`. `certified` states
    /// that certificates may identify workers.
    pub fn new(credentials: Credentials, certified: bool) -> Self {
        let services = Services::new();
        Self(Arc::new(Inside {
            credentials,
            certified,
            services,
            leadership: watch::Sender::new(Leadership::Unknown),
        }))
    }

    /// Follows the role of a replica. When it becomes the leader, calls `open`, which may block, to create
    /// the coordinator on its store.
    ///
    /// # Errors
    /// [`ReplicaError`] after the replica neither leads nor stands by any longer. The function does not
    /// return before.
    pub async fn follow(
        &self,
        replica: &Replica,
        open: impl FnOnce(PostgresStore) -> Result<Arc<Coordinator>, OpenError> + Send + 'static,
    ) -> Result<(), ReplicaError> {
        let mut open = Some(open);
        let mut role = replica.role();
        loop {
            let current = role.borrow_and_update().clone();
            match current {
                Role::Ended(why) => return Err(ReplicaError::Ended(why)),
                Role::StandsBy(None) => self.answer_with(Leadership::Unknown),
                Role::StandsBy(Some(leader)) => {
                    tracing::info!(
                        "{} at {} leads, epoch {}",
                        leader.holder,
                        leader.address,
                        leader.epoch
                    );
                    match Forwarder::to(&leader.address, &self.0.credentials) {
                        Ok(to) => {
                            self.answer_with(Leadership::Remote(Arc::new(to), leader.address))
                        }
                        Err(e) => {
                            tracing::error!(
                                "the leader at {} cannot be called: {e}",
                                leader.address
                            );
                            self.answer_with(Leadership::Unknown);
                        }
                    }
                }
                Role::Leads(epoch) => {
                    if let Some(open) = open.take() {
                        // Calls wait until the new coordinator can answer.
                        self.answer_with(Leadership::Unknown);
                        tracing::info!("this coordinator leads, epoch {epoch}");
                        let store = replica.store(epoch).map_err(OpenError::Store)?;
                        let opened = tokio::task::spawn_blocking(move || open(store)).await;
                        let coordinator = opened.map_err(|e| {
                            ServeError::Broken(format!(
                                "the start of the coordinator panicked: {e}"
                            ))
                        })??;
                        let routes = self.0.services.routes(&coordinator).await?;
                        server::tick(&coordinator);
                        self.0.services.report_readiness(&coordinator);
                        let guarded = AuthorizedServices::new(&coordinator, routes);
                        self.answer_with(Leadership::Local(guarded, coordinator));
                    }
                }
            }
            if role.changed().await.is_err() {
                return Err(ReplicaError::Ended(StoreError::Closed));
            }
        }
    }

    /// Writes buffered events to the disk. To be called at the end of the process.
    pub fn close(&self) {
        if let Leadership::Local(_, coordinator) = &*self.0.leadership.borrow() {
            coordinator.telemetry.event_log.write();
        }
    }

    fn answer_with(&self, leadership: Leadership) {
        if let Leadership::Remote(before, _) = self.0.leadership.send_replace(leadership) {
            before.end();
        }
    }

    /// Answers calls until the future is dropped.
    pub async fn serve(&self, listener: Listener, tls: Option<Arc<Tls>>) -> Infallible {
        listener
            .serve(tls, Protocol::Http2, Answering(self.clone()))
            .await
    }

    /// Serves pages: while the replica stands by, a page that names the leader; then the pages of the
    /// coordinator.
    ///
    /// # Errors
    /// [`ServeError::Broken`] if a server ends by itself.
    pub async fn serve_http(
        &self,
        listener: Listener,
        tls: Option<Arc<Tls>>,
    ) -> Result<Infallible, ServeError> {
        // Both servers share the socket, so that callers can connect during the switch.
        let first = listener.clone();
        let mut leadership = self.0.leadership.subscribe();
        let front = self.clone();
        let pointing = Router::new().fallback(move || {
            let answer = front.pointer();
            async move { answer }
        });
        let coordinator = tokio::select! {
            never = first.serve(tls.clone(), Protocol::Http1, pointing) => match never {},
            coordinator = async {
                let local = leadership.wait_for(|current| matches!(current, Leadership::Local(..)));
                local.await.ok().and_then(|current| match &*current {
                    Leadership::Local(_, coordinator) => Some(Arc::clone(coordinator)),
                    _ => None,
                })
            } => coordinator,
        };
        let Some(coordinator) = coordinator else {
            return std::future::pending().await;
        };
        serve_http(coordinator, listener, tls).await
    }

    /// Returns a page that names the address of the leader.
    fn pointer(&self) -> (StatusCode, [(header::HeaderName, &'static str); 2], String) {
        let text = match &*self.0.leadership.borrow() {
            Leadership::Remote(_, address) => {
                format!("this coordinator is a standby; call the leader at {address}\n")
            }
            _ => {
                "this coordinator is a standby, and no coordinator leads at the moment; try again\n"
                    .to_owned()
            }
        };
        // On a persistent connection, the client would still reach this page after this coordinator became
        // the leader.
        let headers = [(header::CONNECTION, "close"), (header::RETRY_AFTER, "5")];
        (StatusCode::SERVICE_UNAVAILABLE, headers, text)
    }

    async fn answer(&self, request: Request<axum::body::Body>) -> Response<axum::body::Body> {
        if request.uri().path().starts_with("/grpc.health.v1.Health/") {
            // Health describes this process, regardless of the leader: it is ready if it can lead or forward
            // calls.
            return answered(self.0.services.health().oneshot(request).await)
                .map(axum::body::Body::new);
        }
        let mut leadership = self.0.leadership.subscribe();
        let known = leadership.wait_for(|current| !matches!(current, Leadership::Unknown));
        let known = tokio::time::timeout(PATIENCE, known).await;
        let leadership = known.ok().and_then(Result::ok).map(|known| known.clone());
        match leadership {
            Some(Leadership::Local(guarded, _)) => answered(guarded.oneshot(request).await),
            Some(Leadership::Remote(_, leader))
                if self.0.certified && is_known_by_certificate(&request) =>
            {
                Status::unavailable(format!(
                    "this coordinator is a standby and cannot forward a certificate; call the \
                     leader at {leader}, or use a token with the scope worker"
                ))
                .into_http()
            }
            Some(Leadership::Remote(to, _)) => {
                let peer = request.extensions().get::<Peer>().cloned();
                let is_worker = needed(request.uri().path()) == Need::Scope(Scope::Worker);
                let answer = to.forward(request).await;
                // For a rejected call, the leader's guard returns a status without a body.
                if let Some(peer) =
                    peer.filter(|_| Status::from_header_map(answer.headers()).is_none())
                {
                    peer.admitted(is_worker);
                }
                answer.map(axum::body::Body::new)
            }
            Some(Leadership::Unknown) | None => Status::new(
                Code::Unavailable,
                "no coordinator leads at the moment; try again",
            )
            .into_http(),
        }
    }
}

/// Metrics and readiness of a replica. A standby has few metrics.
impl Probed for Front {
    fn metrics(&self) -> Result<String, String> {
        match self.leads() {
            Some(coordinator) => Probed::metrics(&*coordinator),
            None => standby_metrics().map_err(|e| e.to_string()),
        }
    }

    fn readiness(&self) -> Result<(), Vec<String>> {
        match &*self.0.leadership.borrow() {
            Leadership::Local(_, coordinator) => Probed::readiness(&**coordinator),
            Leadership::Remote(..) => Ok(()),
            Leadership::Unknown => Err(vec!["no coordinator leads at the moment".to_owned()]),
        }
    }
}

impl Front {
    fn leads(&self) -> Option<Arc<Coordinator>> {
        match &*self.0.leadership.borrow() {
            Leadership::Local(_, coordinator) => Some(Arc::clone(coordinator)),
            _ => None,
        }
    }
}

fn answered<B>(answer: Result<Response<B>, Infallible>) -> Response<B> {
    match answer {
        Ok(answer) => answer,
        Err(never) => match never {},
    }
}

/// Returns true if the caller shows a certificate and no token.
fn is_known_by_certificate<B>(request: &Request<B>) -> bool {
    let certificate = request
        .extensions()
        .get::<Peer>()
        .and_then(|peer| peer.certificate.as_ref());
    certificate.is_some() && !request.headers().contains_key(header::AUTHORIZATION)
}

/// The service at a replica's address.
#[derive(Clone)]
struct Answering(Front);

impl Service<Request<axum::body::Body>> for Answering {
    type Response = Response<axum::body::Body>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Self::Response, Infallible>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: Request<axum::body::Body>) -> Self::Future {
        let front = self.0.clone();
        Box::pin(async move { Ok(front.answer(request).await) })
    }
}

#[cfg(test)]
#[path = "front_tests.rs"]
mod tests;
