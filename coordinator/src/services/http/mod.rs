//! The coordinator for browsers and for programs without gRPC: the calls of its services as JSON, a stream of
//! what changes, results, and the pages that show all this.
//!
//! A call is `POST /sightline.v1.Jobs/List` with the request as JSON, by the mapping of the Protocol Buffers,
//! as the Connect protocol has it. The same rules hold as for gRPC: beyond this machine the address needs
//! encryption or `--allow-plaintext`, and where callers need tokens a call needs its scope. The pages show
//! the jobs of all users, so they need `admin`. Pages of other sites can neither call (`application/json`
//! makes a browser ask first, and nothing here says yes) nor reach a loopback address under a name of their
//! own.

mod calls;
mod held;
mod live;
mod login;
mod pages;
mod site;
mod snapshot;

use std::net::IpAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::{HeaderMap, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::Response;
use axum::routing::{get, post};
use tokio::net::TcpListener;
use tonic::{Code, Status};

use self::site::{Site, failure};
use self::snapshot::Snapshots;
use super::farm::FarmService;
use super::guard::permitted;
use super::jobs::JobsService;
use super::results::ResultsService;
use super::server::ServeError;
use super::tls::{self, Tls};
use crate::access::Caller;
use crate::scene_files;
use crate::state::Coordinator;

/// Most bytes of a request, as for messages of gRPC.
const MOST_BYTES: usize = 4 << 20;

/// Serves pages and JSON until `stop` resolves.
///
/// # Errors
/// [`ServeError::Broken`] when the server ends by itself.
pub async fn serve_http(
    coordinator: Arc<Coordinator>,
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let broken = |e: std::io::Error| ServeError::Broken(e.to_string());
    let address = listener.local_addr().map_err(broken)?;
    let is_local = address.ip().is_loopback();
    let is_encrypted = tls.is_some();
    let site = Arc::new(Site {
        jobs: JobsService(Arc::clone(&coordinator)),
        farm: FarmService(Arc::clone(&coordinator)),
        results: ResultsService(Arc::clone(&coordinator)),
        snapshots: Snapshots::of(&coordinator),
        coordinator,
        is_local,
        is_encrypted,
    });
    let routes = Router::new()
        .route("/", get(pages::dashboard))
        .route("/login", get(login::page).post(login::login))
        .route("/live", get(live::live))
        .route("/events/{job}", get(live::events))
        .route("/results/{file}", get(pages::result))
        .route(
            "/scenes",
            post(pages::put_scene).layer(DefaultBodyLimit::max(scene_files::MOST_BYTES as usize)),
        )
        .route("/view/{job}", get(pages::view))
        .route("/{service}/{method}", post(calls::call))
        .fallback(|| async { failure(&Status::not_found("there is no such page; / is the dashboard")) })
        .layer(DefaultBodyLimit::max(MOST_BYTES))
        .layer(from_fn_with_state(Arc::clone(&site), guard))
        .with_state(site);
    // Streams that stay open would delay a graceful end for ever.
    tokio::select! {
        r = serve_routes(routes, listener, tls) => r,
        () = stop => Ok(()),
    }
}

/// Answers the connections of a listener, encrypted if there are certificates.
pub(super) async fn serve_routes(
    routes: Router,
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
) -> Result<(), ServeError> {
    let broken = |e: std::io::Error| ServeError::Broken(e.to_string());
    let address = listener.local_addr().map_err(broken)?;
    let served = match tls {
        None => axum::serve(listener, routes).await,
        Some(tls) => {
            let connections = tls::connections(listener, tls, b"http/1.1");
            axum::serve(tls::Pages { connections, address }, routes).await
        }
    };
    served.map_err(broken)
}

/// Refuses requests that pages of other sites can make a browser send, those of callers who may not, and
/// those that are too many.
async fn guard(State(site): State<Arc<Site>>, mut request: Request, next: Next) -> Response {
    if let Some(status) = refusal(&site, request.headers()) {
        return failure(&status);
    }
    let path = request.uri().path();
    if path == "/login" {
        // Whoever sends a token here has none yet, and may not take the calls of those who have one.
        return next.run(request).await;
    }
    if let Some(access) = site.coordinator.access.get() {
        match login::admitted(access, request.headers(), path) {
            Ok(caller) => drop(request.extensions_mut().insert(caller)),
            Err(status) if path == "/" && status.code() == Code::Unauthenticated => return login::ask(),
            Err(status) => return failure(&status),
        }
    }
    match permitted(&site.coordinator, request.extensions().get::<Caller>()) {
        Ok(permit) => held::until_end(next.run(request).await, permit),
        Err(status) => failure(&status),
    }
}

/// Why a request is refused, by its headers.
fn refusal(site: &Site, headers: &HeaderMap) -> Option<Status> {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let host = text(header::HOST);
    // An encrypted page is under a name of its certificate, and whoever calls needs a token besides.
    let is_known =
        site.is_encrypted && site.coordinator.access.get().is_some_and(|access| access.has_tokens());
    if !is_known && !is_own(host, site.is_local) {
        return Some(Status::permission_denied(
            "ask for an address, for localhost, or for the machine's name without a domain",
        ));
    }
    let origin = text(header::ORIGIN);
    let is_foreign = !origin.is_empty() && origin.split_once("://").is_none_or(|(_, from)| from != host);
    is_foreign.then(|| Status::permission_denied("pages of other sites may not call here"))
}

/// Whether a `Host` can be this machine's. A page of another site reaches it under a name of that site, which
/// has a dot; addresses, `localhost` and names without a domain are not given to anybody else.
fn is_own(host: &str, is_local: bool) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.trim_start_matches('[').trim_end_matches(']').to_ascii_lowercase();
    match name.parse::<IpAddr>() {
        Ok(address) => !is_local || address.is_loopback(),
        Err(_) => name == "localhost" || !is_local && !name.is_empty() && !name.contains('.'),
    }
}

#[cfg(test)]
mod tests {
    use super::is_own;

    #[test]
    fn names_of_other_sites_are_not_ours() {
        for own in ["127.0.0.1:7601", "localhost:7601", "LOCALHOST", "[::1]:7601", "[::1]", "127.0.0.1"] {
            assert!(is_own(own, true) && is_own(own, false), "{own}");
        }
        for beyond in ["192.168.1.7:7601", "farm:7601", "[fe80::1]:7601"] {
            assert!(!is_own(beyond, true) && is_own(beyond, false), "{beyond}");
        }
        for foreign in ["evil.example:7601", "evil.example", "127.0.0.1.evil.example", "", ":7601"] {
            assert!(!is_own(foreign, true) && !is_own(foreign, false), "{foreign}");
        }
    }
}
