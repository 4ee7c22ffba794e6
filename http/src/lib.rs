//! HTTP to object stores, for the coordinator and for workers: rustls with the one provider of cryptography
//! of this program, and no wait without an end.
//!
//! Errors never have the address of a request: that of a request which is signed in its address is a secret.

use std::error::Error as StdError;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use hyper::body::Incoming;
pub use hyper::http::request::Builder;
pub use hyper::http::{Request, Response, StatusCode, Uri, header};
use hyper_rustls::HttpsConnector;
use hyper_util::client::legacy::connect::HttpConnector as Tcp;
use hyper_util::client::legacy::{self, Error as LegacyError};
use hyper_util::rt::{TokioExecutor, TokioTimer};
use tokio::time::{Instant, Sleep, sleep, timeout};
pub use tokio_rustls::rustls::RootCertStore;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;

/// How long an answer may pause within its body.
const PAUSE: Duration = Duration::from_secs(30);
/// How long an unused connection is kept.
const IDLE: Duration = Duration::from_secs(20);

/// Where a request has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum During {
    /// There is no connection.
    Connecting,
    /// Something took too long.
    Waiting,
    /// The connection broke.
    Talking,
}

/// A request that was not answered, or an answer that broke off.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{reason}")]
pub struct Fault {
    /// Where.
    pub during: During,
    /// The innermost error, which has no address.
    pub reason: String,
}

impl Fault {
    fn late(what: &str) -> Self {
        Self {
            during: During::Waiting,
            reason: what.to_owned(),
        }
    }

    fn of(during: During, e: &dyn StdError) -> Self {
        let mut inner = e;
        while let Some(deeper) = inner.source() {
            inner = deeper;
        }
        Self {
            during,
            reason: inner.to_string(),
        }
    }
}

/// Whom to trust: the system's authorities, and those of a PEM text.
///
/// # Errors
/// What is wrong with the text.
pub fn roots(pem: Option<&[u8]>) -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    let system = rustls_native_certs::load_native_certs();
    let (_, unusable) = roots.add_parsable_certificates(system.certs);
    if unusable > 0 || !system.errors.is_empty() {
        let errors = system.errors.len();
        tracing::debug!(
            "of the system's authorities {unusable} cannot be used, and {errors} not be read"
        );
    }
    if let Some(pem) = pem {
        let before = roots.len();
        for certificate in CertificateDer::pem_slice_iter(pem) {
            let certificate = certificate.map_err(|e| e.to_string())?;
            roots.add(certificate).map_err(|e| e.to_string())?;
        }
        if roots.len() == before {
            return Err("it holds no certificate".to_owned());
        }
    }
    Ok(roots)
}

/// Makes connections. Clones share them. `B` is the body of its requests.
#[derive(Debug)]
pub struct Client<B>(legacy::Client<HttpsConnector<Tcp>, B>);

impl<B> Clone for Client<B> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<B> Client<B>
where
    B: Body<Data = Bytes> + Send + Unpin + 'static,
    B::Error: Into<Box<dyn StdError + Send + Sync>>,
{
    /// A client that trusts these authorities; a connection takes no longer than `connect`.
    ///
    /// # Errors
    /// When TLS cannot be set up.
    pub fn new(roots: RootCertStore, connect: Duration) -> Result<Self, String> {
        let config = tokio_rustls::rustls::ClientConfig::builder_with_provider(Arc::new(
            ring::default_provider(),
        ))
        .with_safe_default_protocol_versions()
        .map_err(|e| e.to_string())?
        .with_root_certificates(roots)
        .with_no_client_auth();
        let mut tcp = Tcp::new();
        tcp.enforce_http(false);
        tcp.set_connect_timeout(Some(connect));
        tcp.set_nodelay(true);
        let tls = hyper_rustls::HttpsConnectorBuilder::new()
            .with_tls_config(config)
            .https_or_http()
            .enable_http1()
            .wrap_connector(tcp);
        let client = legacy::Client::builder(TokioExecutor::new())
            .pool_timer(TokioTimer::new())
            .pool_idle_timeout(IDLE)
            .build(tls);
        Ok(Self(client))
    }

    /// Sends a request; its answer begins within this time, which is also the time for its body to be sent.
    ///
    /// # Errors
    /// Why there is no answer.
    pub async fn request(
        &self,
        request: Request<B>,
        within: Duration,
    ) -> Result<Response<Answer>, Fault> {
        let answer = timeout(within, self.0.request(request)).await;
        let answer = answer.map_err(|_| Fault::late("no answer"))?;
        let during = |e: &LegacyError| {
            if e.is_connect() {
                During::Connecting
            } else {
                During::Talking
            }
        };
        Ok(answer
            .map_err(|e| Fault::of(during(&e), &e))?
            .map(Answer::new))
    }
}

/// The body of an answer, which ends with an error when it pauses for too long.
#[derive(Debug)]
pub struct Answer {
    body: Incoming,
    pause: Pin<Box<Sleep>>,
}

impl Answer {
    fn new(body: Incoming) -> Self {
        Self {
            body,
            pause: Box::pin(sleep(PAUSE)),
        }
    }

    /// The next bytes; `None` at the end.
    ///
    /// # Errors
    /// Why the answer broke off.
    pub async fn next(&mut self) -> Result<Option<Bytes>, Fault> {
        loop {
            let frame = std::future::poll_fn(|cx| Pin::new(&mut *self).poll_frame(cx)).await;
            match frame.transpose()?.map(Frame::into_data) {
                None => return Ok(None),
                Some(Ok(bytes)) => return Ok(Some(bytes)),
                // Trailers have no bytes.
                Some(Err(_)) => {}
            }
        }
    }
}

impl Body for Answer {
    type Data = Bytes;
    type Error = Fault;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Fault>>> {
        if let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(cx) {
            self.pause.as_mut().reset(Instant::now() + PAUSE);
            return Poll::Ready(
                frame.map(|frame| frame.map_err(|e| Fault::of(During::Talking, &e))),
            );
        }
        ready!(self.pause.as_mut().poll(cx));
        Poll::Ready(Some(Err(Fault::late("the answer came to a halt"))))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
