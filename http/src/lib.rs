//! The HTTP client for object stores, used by the coordinator and by workers. The client uses rustls with
//! this program's only cryptography provider, and every wait has a time limit.
//!
//! Errors never contain the address of a request, because a signed address is a secret.

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

/// Timeout for a pause within the body of an answer.
const PAUSE: Duration = Duration::from_secs(30);
/// The time for which an unused connection stays open.
const IDLE: Duration = Duration::from_secs(20);

/// The stage at which a request failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestStage {
    /// No connection was made.
    Connecting,
    /// A time limit was exceeded.
    Waiting,
    /// The connection broke.
    Talking,
}

/// An error of a request without an answer, or of an interrupted answer.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{reason}")]
pub struct RequestError {
    /// The stage at which the request failed.
    pub stage: RequestStage,
    /// The message of the innermost error. The message does not contain the URL of the request, because a
    /// signed URL is a secret.
    pub reason: String,
}

impl RequestError {
    fn late(what: &str) -> Self {
        Self {
            stage: RequestStage::Waiting,
            reason: what.to_owned(),
        }
    }

    fn from_error(stage: RequestStage, e: &dyn StdError) -> Self {
        let mut inner = e;
        while let Some(deeper) = inner.source() {
            inner = deeper;
        }
        Self {
            stage,
            reason: inner.to_string(),
        }
    }
}

/// Returns the trusted authorities: the authorities of the system and of a PEM text.
///
/// # Errors
/// A description of the fault of the text.
pub fn roots(pem: Option<&[u8]>) -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    let system = rustls_native_certs::load_native_certs();
    let (_, unusable) = roots.add_parsable_certificates(system.certs);
    if unusable > 0 || !system.errors.is_empty() {
        let errors = system.errors.len();
        tracing::debug!(
            "{unusable} of the system's authorities cannot be used, and {errors} cannot be read"
        );
    }
    if let Some(pem) = pem {
        let before = roots.len();
        for certificate in CertificateDer::pem_slice_iter(pem) {
            let certificate = certificate.map_err(|e| e.to_string())?;
            roots.add(certificate).map_err(|e| e.to_string())?;
        }
        if roots.len() == before {
            return Err("the PEM text contains no certificate".to_owned());
        }
    }
    Ok(roots)
}

/// A factory of connections, which clones share. `B` is the type of the request bodies.
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
    /// Creates a client that trusts these authorities. Making a connection takes at most `connect`.
    ///
    /// # Errors
    /// An error if TLS cannot be set up.
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

    /// Sends a request. The request's body must be sent, and its answer must begin, within the time `within`.
    ///
    /// # Errors
    /// The reason why there is no answer.
    pub async fn request(
        &self,
        request: Request<B>,
        within: Duration,
    ) -> Result<Response<ResponseBody>, RequestError> {
        let answer = timeout(within, self.0.request(request)).await;
        let answer = answer.map_err(|_| RequestError::late("the server sent no answer in time"))?;
        let stage = |e: &LegacyError| {
            if e.is_connect() {
                RequestStage::Connecting
            } else {
                RequestStage::Talking
            }
        };
        Ok(answer
            .map_err(|e| RequestError::from_error(stage(&e), &e))?
            .map(ResponseBody::new))
    }
}

/// The body of an answer. The body ends with an error after a pause of more than 30 s.
#[derive(Debug)]
pub struct ResponseBody {
    body: Incoming,
    pause: Pin<Box<Sleep>>,
}

impl ResponseBody {
    fn new(body: Incoming) -> Self {
        Self {
            body,
            pause: Box::pin(sleep(PAUSE)),
        }
    }

    /// Returns the next bytes, or `None` at the end.
    ///
    /// # Errors
    /// The reason why the answer was interrupted.
    pub async fn next(&mut self) -> Result<Option<Bytes>, RequestError> {
        loop {
            let frame = std::future::poll_fn(|cx| Pin::new(&mut *self).poll_frame(cx)).await;
            match frame.transpose()?.map(Frame::into_data) {
                None => return Ok(None),
                Some(Ok(bytes)) => return Ok(Some(bytes)),
                // Trailers contain no bytes.
                Some(Err(_)) => {}
            }
        }
    }
}

impl Body for ResponseBody {
    type Data = Bytes;
    type Error = RequestError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, RequestError>>> {
        if let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(cx) {
            self.pause.as_mut().reset(Instant::now() + PAUSE);
            return Poll::Ready(frame.map(|frame| {
                frame.map_err(|e| RequestError::from_error(RequestStage::Talking, &e))
            }));
        }
        ready!(self.pause.as_mut().poll(cx));
        Poll::Ready(Some(Err(RequestError::late(
            "the server sent no further bytes of the answer for 30 s",
        ))))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
