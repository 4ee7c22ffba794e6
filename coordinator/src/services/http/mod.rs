//! The coordinator for browsers and for programs without gRPC: calls as JSON, streams of changes, results,
//! and pages.
//!
//! A call is `POST /sightline.v1.Jobs/List` with the request as JSON, by the JSON mapping of Protocol Buffers
//! and the Connect protocol. The rules of gRPC hold, too: beyond this machine the address needs encryption or
//! `--allow-plaintext`, and if callers need tokens, a call needs its scope. The pages show the jobs of all
//! users, so they need `admin`.
//!
//! Pages of other sites cannot call: `application/json` makes a browser ask for permission first, and the
//! coordinator never grants it. Nor can such a page reach a loopback address under the host name of its site.

mod calls;
mod live;
mod login;
mod logins;
mod pages;
mod site;
mod snapshot;

use std::convert::Infallible;
use std::net::IpAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::Response;
use axum::routing::{get, post};
use http_body::Body as _;
use tonic::{Code, Status};

use self::logins::Logins;
use self::site::{Site, failure};
use self::snapshot::Snapshots;
use super::answer_right;
use super::authorize::permitted;
use super::connections::{Listener, Peer, Protocol, ServeError};
use super::farm::FarmService;
use super::jobs::JobsService;
use super::metered::{MAX_MESSAGE, MESSAGE_TIME, bounded, needed_by_json};
use super::results::ResultsService;
use super::silence::until_deadline;
use super::tls::Tls;
use crate::access::Caller;
use crate::coordinator::Coordinator;

/// Serves pages and JSON until the future is dropped.
///
/// # Errors
/// [`ServeError::Broken`] if the system does not report the address of the listener.
pub async fn serve_http(
    coordinator: Arc<Coordinator>,
    listener: Listener,
    tls: Option<Arc<Tls>>,
) -> Result<Infallible, ServeError> {
    let broken = |e: std::io::Error| ServeError::Broken(e.to_string());
    let address = listener.local_addr().map_err(broken)?;
    let is_local = address.ip().is_loopback();
    let is_encrypted = tls.is_some();
    let site = Arc::new(Site {
        jobs: JobsService(Arc::clone(&coordinator)),
        farm: FarmService(Arc::clone(&coordinator)),
        results: ResultsService(Arc::clone(&coordinator)),
        snapshots: Snapshots::start(&coordinator),
        coordinator,
        is_local,
        is_encrypted,
        port: address.port(),
        logins: Logins::default(),
    });
    let routes = Router::new()
        .route("/", get(pages::dashboard))
        .route(
            "/login",
            // Only this path reads a body of an unknown caller.
            get(login::page)
                .post(login::login)
                .layer(DefaultBodyLimit::max(login::MAX_FORM)),
        )
        .route("/logout", post(login::logout))
        .route("/live", get(live::live))
        .route("/events/{job}", get(live::events))
        .route("/results/{file}", get(pages::result))
        .route("/scenes", post(pages::put_scene))
        .route("/view/{job}", get(pages::view))
        .route("/{service}/{method}", post(calls::call))
        .fallback(|| async {
            failure(&Status::not_found(
                "the page does not exist; the dashboard is at /",
            ))
        })
        .layer(DefaultBodyLimit::max(MAX_MESSAGE as usize))
        .layer(from_fn_with_state(Arc::clone(&site), guard))
        .with_state(site);
    Ok(listener.serve(tls, Protocol::Http1, routes).await)
}

/// Rejects requests that pages of other sites can trigger, requests of unauthorized callers, and requests
/// above the rate limits.
async fn guard(site: State<Arc<Site>>, request: Request, next: Next) -> Response {
    let mut answer = guarded(site, request, next).await;
    // Browsers must not guess another content type from the bytes.
    answer.headers_mut().insert(
        header::X_CONTENT_TYPE_OPTIONS,
        HeaderValue::from_static("nosniff"),
    );
    answer
}

async fn guarded(State(site): State<Arc<Site>>, mut request: Request, next: Next) -> Response {
    if let Some(status) = refusal(&site, request.headers()) {
        return failure(&status);
    }
    let path = request.uri().path().to_owned();
    let path = path.as_str();
    if path == "/login" || path == "/logout" {
        // A caller without a session must not use up the calls of users.
        return next.run(request).await;
    }
    if let Some(access) = site.coordinator.users.access.get() {
        match login::admitted(&site, access, request.headers(), path) {
            Ok(caller) => drop(request.extensions_mut().insert(caller)),
            Err(status) if path == "/" && status.code() == Code::Unauthenticated => {
                return login::ask().await;
            }
            Err(status) => return failure(&status),
        }
    }
    match permitted(&site.coordinator, request.extensions().get::<Caller>()) {
        Ok(permit) => {
            if let Some(peer) = request.extensions().get::<Peer>() {
                peer.admitted(false);
            }
            // A scene file goes to the disk, so its length does not count as memory.
            let announced = request.headers().get(header::CONTENT_LENGTH);
            let announced: Option<u64> =
                announced.and_then(|length| length.to_str().ok()?.parse().ok());
            let is_empty = request.body().is_end_stream() || path == "/scenes";
            let bytes = match announced {
                _ if is_empty => 0,
                Some(announced) => needed_by_json(announced),
                None => {
                    return failure(&Status::invalid_argument(
                        "the length of the request is missing; send the header content-length",
                    ));
                }
            };
            let user = bounded(request.extensions().get::<Caller>()).to_owned();
            match site.coordinator.users.intake.room(&user, bytes).await {
                Ok(room) => {
                    if bytes > 0 {
                        request = request.map(|body| until_deadline(body, MESSAGE_TIME));
                    }
                    answer_right::until_end(next.run(request).await, (permit, room))
                }
                Err(_) => failure(&Status::unavailable(
                    "the coordinator is stopping; try again after its restart",
                )),
            }
        }
        Err(status) => failure(&status),
    }
}

/// Returns the reason to reject a request by its headers, or `None`.
fn refusal(site: &Site, headers: &HeaderMap) -> Option<Status> {
    let text = |name| {
        headers
            .get(name)
            .and_then(|value| value.to_str().ok())
            .unwrap_or_default()
    };
    let host = text(header::HOST);
    // An encrypted page has a name of the certificate, and callers need a token in addition.
    let is_known = site.is_encrypted
        && site
            .coordinator
            .users
            .access
            .get()
            .is_some_and(|access| access.has_tokens());
    if !is_known && !is_own(host, site.is_local) {
        return Some(Status::permission_denied(
            "the host of the request is not allowed; use an IP address, localhost, or the name of the \
             machine without a domain",
        ));
    }
    let origin = text(header::ORIGIN);
    let is_foreign = !origin.is_empty()
        && origin
            .split_once("://")
            .is_none_or(|(_, from)| from != host);
    is_foreign.then(|| Status::permission_denied("requests from pages of other sites are rejected"))
}

/// Returns true if a `Host` header can name this machine.
///
/// A page of another site reaches this machine under a name of that site, which has a dot. Other sites cannot
/// own addresses, `localhost`, or names without a domain.
fn is_own(host: &str, is_local: bool) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name
        .trim_start_matches('[')
        .trim_end_matches(']')
        .to_ascii_lowercase();
    match name.parse::<IpAddr>() {
        Ok(address) => !is_local || address.is_loopback(),
        Err(_) => name == "localhost" || !is_local && !name.is_empty() && !name.contains('.'),
    }
}

#[cfg(test)]
mod tests {
    use super::is_own;

    #[test]
    fn hosts_of_other_sites_are_rejected() {
        for own in [
            "127.0.0.1:7601",
            "localhost:7601",
            "LOCALHOST",
            "[::1]:7601",
            "[::1]",
            "127.0.0.1",
        ] {
            assert!(is_own(own, true) && is_own(own, false), "{own}");
        }
        for beyond in ["192.168.1.7:7601", "farm:7601", "[fe80::1]:7601"] {
            assert!(!is_own(beyond, true) && is_own(beyond, false), "{beyond}");
        }
        for foreign in [
            "evil.example:7601",
            "evil.example",
            "127.0.0.1.evil.example",
            "",
            ":7601",
        ] {
            assert!(
                !is_own(foreign, true) && !is_own(foreign, false),
                "{foreign}"
            );
        }
    }
}
