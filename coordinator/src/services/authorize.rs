//! Authentication and authorization of gRPC calls, before a service handles them. The services also check
//! here that a job belongs to the caller.

use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use futures::future::{BoxFuture, Either, Ready, ready};
use sightline_records::ids::JobId;
use sightline_store::StoreError;
use tonic::body::Body;
use tonic::codegen::http;
use tonic::{Request, Status};
use tower::{Layer, Service};

use super::blocking::blocking;
use super::connections::Peer;
use super::metered::{LastRoom, Metered, bounded};
use super::status;
use crate::access::{Access, Caller, Need, Refusal, Scope, Scopes, needed};
use crate::coordinator::Coordinator;
use crate::quota::Permit;

/// A layer that wraps services in [`Authorized`].
#[derive(Clone)]
pub(super) struct AuthorizeLayer(pub(super) Arc<Coordinator>);

impl<S> Layer<S> for AuthorizeLayer {
    type Service = Authorized<S>;

    fn layer(&self, inner: S) -> Authorized<S> {
        Authorized {
            inner,
            coordinator: Arc::clone(&self.0),
        }
    }
}

/// A service that rejects calls of unauthorized callers.
#[derive(Clone)]
pub(super) struct Authorized<S> {
    inner: S,
    coordinator: Arc<Coordinator>,
}

/// The right to a call and its memory, until the end of the answer.
pub(super) struct CallRight {
    _permit: Permit,
    /// The memory of the call's last message.
    _room: LastRoom,
}

impl<S> Service<http::Request<Body>> for Authorized<S>
where
    S: Service<http::Request<Body>, Response = http::Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = Either<
        BoxFuture<'static, Result<S::Response, S::Error>>,
        Ready<Result<S::Response, S::Error>>,
    >;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: http::Request<Body>) -> Self::Future {
        if let Some(access) = self.coordinator.users.access.get() {
            let peer = request.extensions().get::<Peer>();
            let certificate = peer
                .and_then(|peer| peer.certificate.as_ref())
                .map(|shown| shown.as_ref().as_ref());
            match admitted(access, request.headers(), certificate, request.uri().path()) {
                Ok(caller) => drop(request.extensions_mut().insert(caller)),
                Err(status) => return Either::Right(ready(Ok(status.into_http()))),
            }
        }
        let caller = request.extensions().get::<Caller>();
        let user = bounded(caller).to_owned();
        match permitted(&self.coordinator, caller) {
            Ok(permit) => {
                if let Some(peer) = request.extensions().get::<Peer>() {
                    peer.admitted(needed(request.uri().path()) == Need::Scope(Scope::Worker));
                }
                let path = request.uri().path().to_owned();
                let mut room = LastRoom::default();
                let request = request.map(|body| {
                    let (body, last) =
                        Metered::new(body, &self.coordinator.users.intake, &user, &path);
                    room = last;
                    Body::new(body)
                });
                let held = CallRight {
                    _permit: permit,
                    _room: room,
                };
                let answer = self.inner.call(request);
                // The right lasts until the end of the answer, also of a stream, so the body owns it.
                Either::Left(Box::pin(async move {
                    let mut answer = answer.await?;
                    answer.extensions_mut().insert(Arc::new(held));
                    Ok(answer)
                }))
            }
            Err(status) => Either::Right(ready(Ok(status.into_http()))),
        }
    }
}

/// Returns the right of a caller to one more call. Workers have no rate limit, since they call as often as
/// their tiles require.
///
/// # Errors
/// RESOURCE_EXHAUSTED if the caller, or all callers together, have too many calls.
pub(super) fn permitted(c: &Coordinator, caller: Option<&Caller>) -> Result<Permit, Status> {
    let quota = match caller {
        Some(Caller::User { name, scopes }) if !scopes.include(Scope::Worker) => {
            Some((name, c.config.quotas.for_user(name)))
        }
        _ => None,
    };
    let (user, quota) = quota
        .as_ref()
        .map_or(("", None), |(user, quota)| (user.as_str(), Some(quota)));
    c.users
        .rate_limiter
        .begin(user, quota, Instant::now())
        .map_err(|beyond| {
            c.telemetry.metrics.refused(beyond.name());
            Status::resource_exhausted(beyond.to_string())
        })
}

/// Authenticates the caller by the headers and the certificate, and checks that the caller may call `path`.
pub(super) fn admitted(
    access: &Access,
    headers: &http::HeaderMap,
    certificate: Option<&[u8]>,
    path: &str,
) -> Result<Caller, Status> {
    let token = match headers.get(http::header::AUTHORIZATION) {
        None => None,
        Some(value) => {
            let text = value
                .to_str()
                .ok()
                .and_then(|text| text.strip_prefix("Bearer "));
            Some(text.ok_or_else(|| {
                Status::unauthenticated("send the token as `authorization: Bearer TOKEN`")
            })?)
        }
    };
    admitted_with(access, token, certificate, path)
}

/// Authenticates the caller by a token or a certificate, and checks that the caller may call `path`. If the
/// token is not sufficient, the certificate is tried without the token.
pub(super) fn admitted_with(
    access: &Access,
    token: Option<&str>,
    certificate: Option<&[u8]>,
    path: &str,
) -> Result<Caller, Status> {
    let by = |token, certificate| {
        admitted_by(access, path, |access| access.identify(token, certificate))
    };
    // A worker may have a token and a certificate, and either is sufficient.
    by(token, certificate)
        .or_else(|status| by(None, certificate.filter(|_| token.is_some())).map_err(|_| status))
}

/// Identifies the caller with `identify`, and checks that the caller may call `path`.
pub(super) fn admitted_by(
    access: &Access,
    path: &str,
    identify: impl FnOnce(&Access) -> Result<Caller, &'static str>,
) -> Result<Caller, Status> {
    let caller = identify(access).map_err(Status::unauthenticated)?;
    access
        .permit(&caller, needed(path))
        .map_err(|refusal| match refusal {
            Refusal::Unknown(text) => Status::unauthenticated(text),
            Refusal::Scope(text) => Status::permission_denied(text),
        })?;
    Ok(match (access.has_tokens(), caller) {
        // Without client tokens, data has no owner.
        (false, _) => Caller::Nobody,
        // Callers that have not authenticated see no data.
        (true, Caller::Nobody) => Caller::User {
            name: String::new(),
            scopes: Scopes::default(),
        },
        (true, caller) => caller,
    })
}

/// Returns the caller of an admitted request.
pub(super) fn caller<T>(c: &Coordinator, r: &Request<T>) -> Result<Caller, Status> {
    match (r.extensions().get::<Caller>(), c.users.access.get()) {
        (Some(caller), _) => Ok(caller.clone()),
        (None, None) => Ok(Caller::Nobody),
        (None, Some(_)) => Err(Status::internal("a call bypassed authentication")),
    }
}

/// Returns the job with this number if the caller of `r` may see it. A job of another owner is reported as
/// not existing.
pub(super) async fn own_job<T>(
    c: &Arc<Coordinator>,
    r: &Request<T>,
    job: u64,
) -> Result<JobId, Status> {
    let caller = caller(c, r)?;
    let id = JobId(job);
    if caller.sees_all() {
        return Ok(id);
    }
    blocking(c, move |c| {
        let record = c.records.job(id).map_err(|e| status::of_store(&e))?;
        match record.filter(|record| caller.sees(&record.owner)) {
            Some(_) => Ok(id),
            None => Err(status::of_store(&StoreError::UnknownJob { job: id })),
        }
    })
    .await
}
