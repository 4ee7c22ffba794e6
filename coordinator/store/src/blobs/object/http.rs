//! The crate object_store on our own client of HTTP. It would bring another one, and another provider of
//! cryptography.

use std::path::Path;
use std::time::Duration;

use object_store::ClientOptions;
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpRequestBody,
    HttpResponse, HttpResponseBody, HttpService,
};
use sightline_http::{Answer, Client, During, Fault, RootCertStore};

/// How long a connection may take.
const CONNECT: Duration = Duration::from_secs(5);
/// How long the answer to a request may take, and its body with it: a part of an upload is 16 MiB or, of the
/// largest blobs, some hundred.
const ANSWER: Duration = Duration::from_secs(120);
/// Most bytes of a file of authorities: each worker is sent it.
const MOST_CA: u64 = 256 << 10;

/// Makes connections. Clones share them.
#[derive(Clone, Debug)]
pub(super) struct Http(Client<HttpRequestBody>);

/// The authorities in a file, as PEM text.
///
/// # Errors
/// What is wrong with the file.
pub(super) fn authorities(path: &Path) -> Result<Vec<u8>, String> {
    let bad = |e: String| {
        format!(
            "{}: {e}; ca= names the store's authority as PEM",
            path.display()
        )
    };
    let length = std::fs::metadata(path)
        .map_err(|e| bad(e.to_string()))?
        .len();
    if length > MOST_CA {
        return Err(bad("it is too large".to_owned()));
    }
    let pem = std::fs::read(path).map_err(|e| bad(e.to_string()))?;
    sightline_http::roots(Some(&pem)).map_err(bad)?;
    Ok(pem)
}

impl Http {
    /// A client that trusts these authorities.
    ///
    /// # Errors
    /// When TLS cannot be set up.
    pub(super) fn new(roots: RootCertStore) -> Result<Self, String> {
        Client::new(roots, CONNECT).map(Self)
    }
}

impl HttpConnector for Http {
    fn connect(&self, _: &ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(self.clone()))
    }
}

fn error(fault: Fault) -> HttpError {
    let kind = match fault.during {
        During::Connecting => HttpErrorKind::Connect,
        During::Waiting => HttpErrorKind::Timeout,
        During::Talking => HttpErrorKind::Interrupted,
    };
    HttpError::new(kind, fault)
}

#[async_trait::async_trait]
impl HttpService for Http {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let (parts, body) = self
            .0
            .request(request, ANSWER)
            .await
            .map_err(error)?
            .into_parts();
        Ok(HttpResponse::from_parts(
            parts,
            HttpResponseBody::new(Body(body)),
        ))
    }
}

/// The body of an answer.
struct Body(Answer);

impl http_body::Body for Body {
    type Data = bytes::Bytes;
    type Error = HttpError;

    fn poll_frame(
        mut self: std::pin::Pin<&mut Self>,
        cx: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Option<Result<http_body::Frame<bytes::Bytes>, HttpError>>> {
        let frame = std::pin::Pin::new(&mut self.0).poll_frame(cx);
        frame.map(|frame| frame.map(|frame| frame.map_err(error)))
    }

    fn is_end_stream(&self) -> bool {
        self.0.is_end_stream()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.0.size_hint()
    }
}
