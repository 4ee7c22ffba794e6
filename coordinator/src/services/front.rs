//! What the addresses of a replica are answered with: by the coordinator that leads, here or elsewhere.

use std::convert::Infallible;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use axum::http::{StatusCode, header};
use futures::future::BoxFuture;
use sightline_proto::connecting::Credentials;
use sightline_store::{PostgresStore, Replica, Role, StoreError};
use tokio::sync::watch;
use tonic::codegen::http::{Request, Response};
use tonic::{Code, Status};
use tower::{Service, ServiceExt as _};

use super::connections::{Listener, Peer, Protocol, ServeError};
use super::forwarding::Forwarder;
use super::http::serve_http;
use super::metrics::Probed;
use super::server::{self, Guarding, Services};
use super::tls::Tls;
use crate::access::{Need, Scope, needed};
use crate::lifecycle::OpenError;
use crate::state::Coordinator;
use crate::telemetry::metrics::standing_by;

/// How long a call waits for somebody to lead. A take-over takes less.
const PATIENCE: Duration = Duration::from_secs(8);

/// A replica that ends.
#[derive(Debug, thiserror::Error)]
pub enum ReplicaError {
    /// Another one leads, or may lead.
    #[error(transparent)]
    Ended(StoreError),
    /// It was to lead and could not begin.
    #[error("this coordinator was to lead and cannot: {0}")]
    Open(#[from] OpenError),
    /// Its server failed.
    #[error(transparent)]
    Serve(#[from] ServeError),
}

/// A replica's place on the network.
#[derive(Clone)]
pub struct Front(Arc<Inside>);

struct Inside {
    /// What other coordinators are called with.
    credentials: Credentials,
    /// Whether workers may be known by their certificates, which cannot be passed on.
    certified: bool,
    services: Services,
    now: watch::Sender<Now>,
}

/// Who answers.
#[derive(Clone)]
enum Now {
    /// Nobody is known to lead.
    Nobody,
    /// The leader is called.
    Elsewhere(Arc<Forwarder>, String),
    /// This coordinator leads.
    Here(Guarding, Arc<Coordinator>),
}

impl Front {
    /// A place where nobody leads yet. Other coordinators are called with `credentials`; `certified` says
    /// whether workers may be known by their certificates.
    pub fn new(credentials: Credentials, certified: bool) -> Self {
        let services = Services::new();
        Self(Arc::new(Inside {
            credentials,
            certified,
            services,
            now: watch::Sender::new(Now::Nobody),
        }))
    }

    /// Follows what becomes of a replica. When it is to lead, `open` makes the coordinator on its store; that
    /// may block.
    ///
    /// # Errors
    /// Always, when it neither leads nor stands by any more.
    pub async fn follow(
        &self,
        replica: &Replica,
        open: impl FnOnce(PostgresStore) -> Result<Arc<Coordinator>, OpenError> + Send + 'static,
    ) -> Result<(), ReplicaError> {
        let mut open = Some(open);
        let mut role = replica.role();
        loop {
            let now = role.borrow_and_update().clone();
            match now {
                Role::Ended(why) => return Err(ReplicaError::Ended(why)),
                Role::StandsBy(None) => self.answer_with(Now::Nobody),
                Role::StandsBy(Some(leader)) => {
                    tracing::info!(
                        "{} at {} leads, epoch {}",
                        leader.holder,
                        leader.address,
                        leader.epoch
                    );
                    match Forwarder::to(&leader.address, &self.0.credentials) {
                        Ok(to) => self.answer_with(Now::Elsewhere(Arc::new(to), leader.address)),
                        Err(e) => {
                            tracing::error!(
                                "the leader at {} cannot be called: {e}",
                                leader.address
                            );
                            self.answer_with(Now::Nobody);
                        }
                    }
                }
                Role::Leads(epoch) => {
                    if let Some(open) = open.take() {
                        // Until it can answer, calls wait.
                        self.answer_with(Now::Nobody);
                        tracing::info!("this coordinator leads, epoch {epoch}");
                        let store = replica.store(epoch).map_err(OpenError::Store)?;
                        let opened = tokio::task::spawn_blocking(move || open(store)).await;
                        let coordinator = opened
                            .map_err(|e| ServeError::Broken(format!("it panicked: {e}")))??;
                        let routes = self.0.services.routes(&coordinator).await?;
                        server::tick(&coordinator);
                        self.0.services.report_readiness(&coordinator);
                        let guarded = Guarding::new(&coordinator, routes);
                        self.answer_with(Now::Here(guarded, coordinator));
                    }
                }
            }
            if role.changed().await.is_err() {
                return Err(ReplicaError::Ended(StoreError::Closed));
            }
        }
    }

    /// Keeps what is in memory alone and may be kept. To be called at the end.
    pub fn close(&self) {
        if let Now::Here(_, coordinator) = &*self.0.now.borrow() {
            coordinator.event_log.write();
        }
    }

    fn answer_with(&self, now: Now) {
        if let Now::Elsewhere(before, _) = self.0.now.send_replace(now) {
            before.end();
        }
    }

    /// Answers calls until this is dropped.
    pub async fn serve(&self, listener: Listener, tls: Option<Arc<Tls>>) -> Infallible {
        listener
            .serve(tls, Protocol::Http2, Answering(self.clone()))
            .await
    }

    /// Serves pages: while it stands by, one that names the leader; then those of the coordinator.
    ///
    /// # Errors
    /// [`ServeError::Broken`].
    pub async fn serve_http(
        &self,
        listener: Listener,
        tls: Option<Arc<Tls>>,
    ) -> Result<Infallible, ServeError> {
        // The same socket twice, so that no caller is turned away in between.
        let first = listener.clone();
        let mut now = self.0.now.subscribe();
        let front = self.clone();
        let pointing = Router::new().fallback(move || {
            let answer = front.pointer();
            async move { answer }
        });
        let coordinator = tokio::select! {
            never = first.serve(tls.clone(), Protocol::Http1, pointing) => match never {},
            coordinator = async {
                let here = now.wait_for(|now| matches!(now, Now::Here(..))).await;
                here.ok().and_then(|now| match &*now {
                    Now::Here(_, coordinator) => Some(Arc::clone(coordinator)),
                    _ => None,
                })
            } => coordinator,
        };
        let Some(coordinator) = coordinator else {
            return std::future::pending().await;
        };
        serve_http(coordinator, listener, tls).await
    }

    /// Says where the leader is.
    fn pointer(&self) -> (StatusCode, [(header::HeaderName, &'static str); 2], String) {
        let text = match &*self.0.now.borrow() {
            Now::Elsewhere(_, address) => {
                format!("this coordinator stands by; the one that leads is called at {address}\n")
            }
            _ => "this coordinator stands by, and none leads at the moment\n".to_owned(),
        };
        // A connection that stays would ask here again when this coordinator leads.
        let headers = [(header::CONNECTION, "close"), (header::RETRY_AFTER, "5")];
        (StatusCode::SERVICE_UNAVAILABLE, headers, text)
    }

    async fn answer(&self, request: Request<axum::body::Body>) -> Response<axum::body::Body> {
        if request.uri().path().starts_with("/grpc.health.v1.Health/") {
            // Of this process, whoever leads. Whether it is ready to lead or to pass calls on belongs here,
            // too.
            return answered(self.0.services.health().oneshot(request).await)
                .map(axum::body::Body::new);
        }
        let mut now = self.0.now.subscribe();
        let known =
            tokio::time::timeout(PATIENCE, now.wait_for(|now| !matches!(now, Now::Nobody))).await;
        let now = known.ok().and_then(Result::ok).map(|now| now.clone());
        match now {
            Some(Now::Here(guarded, _)) => answered(guarded.oneshot(request).await),
            Some(Now::Elsewhere(_, leader)) if self.0.certified && is_known_by_certificate(&request) => {
                Status::unavailable(format!(
                    "this coordinator stands by and cannot pass on a certificate; call the one that leads, \
                     at {leader}, or use a token with the scope worker"
                ))
                .into_http()
            }
            Some(Now::Elsewhere(to, _)) => {
                let peer = request.extensions().get::<Peer>().cloned();
                let is_worker = needed(request.uri().path()) == Need::Scope(Scope::Worker);
                let answer = to.forward(request).await;
                // The leader's guard answers a call that it does not admit with a status and no body.
                if let Some(peer) = peer.filter(|_| Status::from_header_map(answer.headers()).is_none()) {
                    peer.admitted(is_worker);
                }
                answer.map(axum::body::Body::new)
            }
            Some(Now::Nobody) | None => {
                Status::new(Code::Unavailable, "no coordinator leads at the moment; try again").into_http()
            }
        }
    }
}

/// A replica that stands by does what it is there for, and has nothing to count.
impl Probed for Front {
    fn metrics(&self) -> Result<String, String> {
        match self.leads() {
            Some(coordinator) => Probed::metrics(&*coordinator),
            None => standing_by().map_err(|e| e.to_string()),
        }
    }

    fn readiness(&self) -> Result<(), Vec<String>> {
        match &*self.0.now.borrow() {
            Now::Here(_, coordinator) => Probed::readiness(&**coordinator),
            Now::Elsewhere(..) => Ok(()),
            Now::Nobody => Err(vec!["no coordinator leads at the moment".to_owned()]),
        }
    }
}

impl Front {
    fn leads(&self) -> Option<Arc<Coordinator>> {
        match &*self.0.now.borrow() {
            Now::Here(_, coordinator) => Some(Arc::clone(coordinator)),
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

/// Whether a caller shows a certificate and no token.
fn is_known_by_certificate<B>(request: &Request<B>) -> bool {
    let certificate = request
        .extensions()
        .get::<Peer>()
        .and_then(|peer| peer.certificate.as_ref());
    certificate.is_some() && !request.headers().contains_key(header::AUTHORIZATION)
}

/// The service behind a replica's address.
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
