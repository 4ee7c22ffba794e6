//! Connections of all listeners: they are accepted, encrypted, served and closed in one place.
//!
//! `limits.rs` limits the handshake, the time until the head of the first request, the pause between two
//! requests, and the time for which an answer stays unread. When a cap is reached, `table.rs` closes the
//! connection that has been idle longest to admit a new one.

mod error;
mod limits;
mod table;
#[cfg(test)]
mod tests;
mod watched;

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::{http1, http2};
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tonic::codegen::http::{Request, Response};
use tower::{Service, ServiceExt as _};

pub use self::error::ServeError;
pub use self::limits::{ConnectionLimits, FewDescriptors};
pub use self::table::Connections;
use self::table::{Connection, ConnectionEntry};
use self::watched::WatchedSocket;
use super::answer_right;
use super::silence::until_silent;
use super::tls::Tls;

/// The time between two pings on an HTTP/2 connection.
const KEEPALIVE: Duration = Duration::from_secs(10);
/// Maximum number of simultaneous calls and streams of a connection.
const MOST_STREAMS: u32 = 256;
/// Maximum size of the head of a request over HTTP/1, in bytes.
const MAX_HEAD: usize = 32 << 10;
/// The pause in accepting connections after the system could not open another one.
const NO_ROOM: Duration = Duration::from_millis(100);

/// An address on which connections arrive.
#[derive(Clone)]
pub struct Listener {
    socket: Arc<TcpListener>,
    connections: Arc<Connections>,
}

/// The protocol of a listener.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    /// HTTP/1.1, for browsers and metrics.
    Http1,
    /// HTTP/2, for gRPC.
    Http2,
}

/// The connection of a request, as an extension of the request.
#[derive(Clone)]
pub(super) struct Peer {
    connection: Arc<Connection>,
    connections: Arc<Connections>,
    /// The peer's certificate, which TLS has checked.
    pub(super) certificate: Option<Arc<CertificateDer<'static>>>,
}

impl Peer {
    /// Returns the limits of the connection.
    pub(super) fn limits(&self) -> &ConnectionLimits {
        self.connections.limits()
    }

    /// Marks the connection as used by an admitted caller.
    pub(super) fn admitted(&self, is_worker: bool) {
        self.connection.admitted(&self.connections, is_worker);
    }
}

impl Listener {
    /// Listens on `address`. An address that other machines can reach is rejected unless it is `protected`:
    /// by encryption, or because the user has declared the network private.
    ///
    /// # Errors
    /// [`ServeError`] if the address is reachable and not protected, or if listening fails.
    pub async fn bind(
        address: SocketAddr,
        protected: bool,
        connections: &Arc<Connections>,
    ) -> Result<Self, ServeError> {
        if !address.ip().is_loopback() && !protected {
            return Err(ServeError::Plaintext(address));
        }
        let socket = TcpListener::bind(address).await;
        let socket = Arc::new(socket.map_err(|source| ServeError::Listen { address, source })?);
        Ok(Self {
            socket,
            connections: Arc::clone(connections),
        })
    }

    /// Returns the address, with the port that the system has chosen.
    ///
    /// # Errors
    /// [`io::Error`] if the system cannot report the address.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Serves connections until the future is dropped, which closes all of them.
    pub(super) async fn serve<S>(
        self,
        tls: Option<Arc<Tls>>,
        protocol: Protocol,
        service: S,
    ) -> Infallible
    where
        S: Service<Request<Body>, Response = Response<Body>, Error = Infallible>,
        S: Clone + Send + Sync + 'static,
        S::Future: Send,
    {
        let mut served = JoinSet::new();
        loop {
            // Remove finished connections. The thread of a connection has already reported its panic.
            while served.try_join_next().is_some() {}
            let (stream, from) = match self.socket.accept().await {
                Ok(accepted) => accepted,
                Err(e) => {
                    tracing::warn!("a connection was not accepted: {e}");
                    // An aborted connection needs no descriptor, so no other connection has to close.
                    if e.kind() != io::ErrorKind::ConnectionAborted {
                        self.connections.evict_one();
                        tokio::time::sleep(NO_ROOM).await;
                    }
                    continue;
                }
            };
            let entry = self.connections.add(from.ip(), tls.is_some());
            let (connections, service) = (Arc::clone(&self.connections), service.clone());
            let tls = tls.clone();
            served.spawn(async move {
                let connection = Arc::clone(&entry.connection);
                tokio::select! {
                    ended = connected(stream, &entry, connections, tls, protocol, service) => {
                        if let Err(e) = ended {
                            tracing::debug!("the connection with {from} broke: {e}");
                        }
                    }
                    () = connection.evicted() => {}
                }
            });
        }
    }
}

type Broken = Box<dyn std::error::Error + Send + Sync>;

/// Serves a connection from the handshake to its end.
async fn connected<S>(
    stream: TcpStream,
    entry: &ConnectionEntry,
    connections: Arc<Connections>,
    tls: Option<Arc<Tls>>,
    protocol: Protocol,
    service: S,
) -> Result<(), Broken>
where
    S: Service<Request<Body>, Response = Response<Body>, Error = Infallible>,
    S: Clone + Send + Sync + 'static,
    S::Future: Send,
{
    // Without nodelay, every small answer would wait 40 ms for the acknowledgement of the previous one.
    stream.set_nodelay(true)?;
    let connection = Arc::clone(&entry.connection);
    let limits = *connections.limits();
    let peer = |certificate| Peer {
        connection: Arc::clone(&connection),
        connections,
        certificate,
    };
    match tls {
        None => {
            let stream = WatchedSocket::new(stream, Arc::clone(&connection), limits.unread);
            answered(stream, &limits, peer(None), protocol, service).await
        }
        Some(tls) => {
            let name: &[u8] = if protocol == Protocol::Http2 {
                b"h2"
            } else {
                b"http/1.1"
            };
            let stream = tokio::time::timeout(limits.handshake, tls.acceptor(name).accept(stream));
            let stream = stream
                .await
                .map_err(|_| format!("no handshake within {:?}", limits.handshake))??;
            connection.shaken();
            let shown = stream
                .get_ref()
                .1
                .peer_certificates()
                .and_then(|all| all.first());
            let certificate = shown.map(|certificate| Arc::new(certificate.clone().into_owned()));
            let stream = WatchedSocket::new(stream, Arc::clone(&connection), limits.unread);
            answered(stream, &limits, peer(certificate), protocol, service).await
        }
    }
}

/// Answers the requests of a connection.
async fn answered<IO, S>(
    stream: IO,
    limits: &ConnectionLimits,
    peer: Peer,
    protocol: Protocol,
    service: S,
) -> Result<(), Broken>
where
    IO: AsyncRead + AsyncWrite + Unpin + Send,
    S: Service<Request<Body>, Response = Response<Body>, Error = Infallible>,
    S: Clone + Send + Sync + 'static,
    S::Future: Send,
{
    let connection = Arc::clone(&peer.connection);
    let silence = limits.silence;
    let service = service_fn(move |mut request: Request<Incoming>| {
        let open = peer.connection.begin();
        request.extensions_mut().insert(peer.clone());
        let request = request.map(|body| match protocol {
            Protocol::Http1 => until_silent(Body::new(body), silence),
            // Each call has its own limit, because streams of workers are silent while a worker computes a
            // tile.
            Protocol::Http2 => Body::new(body),
        });
        let answer = service.clone().oneshot(request);
        async move {
            let Ok(answer) = answer.await;
            Ok::<_, Infallible>(answer_right::until_end(answer, open))
        }
    });
    let stream = TokioIo::new(stream);
    // The two types of connections have no common trait.
    macro_rules! to_its_end {
        ($served:expr) => {{
            let mut served = std::pin::pin!($served);
            tokio::select! {
                ended = served.as_mut() => return Ok(ended?),
                () = connection.idle_for(limits.idle) => {}
            }
            served.as_mut().graceful_shutdown();
            // A call that is in progress is still answered, however long the call lasts.
            loop {
                match tokio::time::timeout(limits.grace, served.as_mut()).await {
                    Ok(ended) => return Ok(ended?),
                    Err(_) if connection.has_requests() => {}
                    // The peer does not close the connection, so the server does.
                    Err(_) => return Ok(()),
                }
            }
        }};
    }
    match protocol {
        Protocol::Http1 => {
            let mut http = http1::Builder::new();
            http.timer(TokioTimer::new())
                .header_read_timeout(limits.idle)
                .max_buf_size(MAX_HEAD);
            to_its_end!(http.serve_connection(stream, service))
        }
        Protocol::Http2 => {
            let mut http = http2::Builder::new(TokioExecutor::new());
            http.timer(TokioTimer::new())
                .keep_alive_interval(KEEPALIVE)
                .max_concurrent_streams(MOST_STREAMS);
            to_its_end!(http.serve_connection(stream, service))
        }
    }
}
