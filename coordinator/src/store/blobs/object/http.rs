//! HTTP to the object store: rustls with the one provider of cryptography of this program, and no wait
//! without an end. The crate object_store would bring another client and another provider.

use std::io;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::Bytes;
use hyper::body::{Body, Frame, Incoming, SizeHint};
use hyper_rustls::HttpsConnector;
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector as Tcp;
use hyper_util::rt::{TokioExecutor, TokioTimer};
use object_store::ClientOptions;
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpRequestBody, HttpResponse,
    HttpResponseBody, HttpService,
};
use tokio::time::{Instant, Sleep, sleep, timeout};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// How long a connection may take.
const CONNECT: Duration = Duration::from_secs(5);
/// How long the answer to a request may take, and its body with it: a part of an upload is 16 MiB or, of the
/// largest blobs, some hundred.
const ANSWER: Duration = Duration::from_secs(120);
/// How long an answer may pause within its body.
const PAUSE: Duration = Duration::from_secs(30);
/// How long an unused connection is kept.
const IDLE: Duration = Duration::from_secs(20);

/// Makes connections. Clones share them.
#[derive(Clone, Debug)]
pub(super) struct Http(Client<HttpsConnector<Tcp>, HttpRequestBody>);

/// Whom to trust, beside the system's authorities: those in a file.
///
/// # Errors
/// What is wrong with the file, or that nobody is trusted.
pub(super) fn roots(ca: Option<&Path>) -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    let system = rustls_native_certs::load_native_certs();
    let (_, unusable) = roots.add_parsable_certificates(system.certs);
    if unusable > 0 || !system.errors.is_empty() {
        let errors = system.errors.len();
        tracing::debug!("of the system's authorities {unusable} cannot be used, and {errors} not be read");
    }
    if let Some(path) = ca {
        let bad = |e: String| format!("{}: {e}; ca= names the store's authority as PEM", path.display());
        let before = roots.len();
        for certificate in CertificateDer::pem_file_iter(path).map_err(|e| bad(e.to_string()))? {
            let certificate = certificate.map_err(|e| bad(e.to_string()))?;
            roots.add(certificate).map_err(|e| bad(e.to_string()))?;
        }
        if roots.len() == before {
            return Err(bad("it holds no certificate".to_owned()));
        }
    }
    Ok(roots)
}

impl Http {
    /// A client that trusts these authorities.
    ///
    /// # Errors
    /// When TLS cannot be set up.
    pub(super) fn new(roots: RootCertStore) -> Result<Self, String> {
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|e| e.to_string())?
            .with_root_certificates(roots)
            .with_no_client_auth();
        let mut tcp = Tcp::new();
        tcp.enforce_http(false);
        tcp.set_connect_timeout(Some(CONNECT));
        tcp.set_nodelay(true);
        let tls = hyper_rustls::HttpsConnectorBuilder::new()
            .with_tls_config(config)
            .https_or_http()
            .enable_http1()
            .wrap_connector(tcp);
        let client = Client::builder(TokioExecutor::new())
            .pool_timer(TokioTimer::new())
            .pool_idle_timeout(IDLE)
            .build(tls);
        Ok(Self(client))
    }
}

impl HttpConnector for Http {
    fn connect(&self, _: &ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(self.clone()))
    }
}

#[tonic::async_trait]
impl HttpService for Http {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let answer = timeout(ANSWER, self.0.request(request)).await;
        let late = |_| HttpError::new(HttpErrorKind::Timeout, said(io::ErrorKind::TimedOut, "no answer"));
        let answer = answer.map_err(late)?.map_err(|e| {
            let kind = if e.is_connect() { HttpErrorKind::Connect } else { HttpErrorKind::Interrupted };
            HttpError::new(kind, e)
        })?;
        let (parts, body) = answer.into_parts();
        Ok(HttpResponse::from_parts(parts, HttpResponseBody::new(Watched::new(body))))
    }
}

fn said(kind: io::ErrorKind, text: &str) -> io::Error {
    io::Error::new(kind, text)
}

/// The body of an answer, which ends with an error when it pauses for too long.
struct Watched {
    body: Incoming,
    pause: Pin<Box<Sleep>>,
}

impl Watched {
    fn new(body: Incoming) -> Self {
        Self { body, pause: Box::pin(sleep(PAUSE)) }
    }
}

impl Body for Watched {
    type Data = Bytes;
    type Error = HttpError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, HttpError>>> {
        if let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(cx) {
            self.pause.as_mut().reset(Instant::now() + PAUSE);
            let broken = |e| HttpError::new(HttpErrorKind::Interrupted, e);
            return Poll::Ready(frame.map(|frame| frame.map_err(broken)));
        }
        ready!(self.pause.as_mut().poll(cx));
        let late = said(io::ErrorKind::TimedOut, "the answer came to a halt");
        Poll::Ready(Some(Err(HttpError::new(HttpErrorKind::Timeout, late))))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
