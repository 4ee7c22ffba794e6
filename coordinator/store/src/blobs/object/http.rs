//! An adapter that runs the crate object_store on the project's own HTTP client. The default client of
//! object_store would add another HTTP implementation and another cryptography provider.

use std::path::Path;
use std::time::Duration;

use object_store::ClientOptions;
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpRequestBody,
    HttpResponse, HttpResponseBody, HttpService,
};
use sightline_http::{Client, RequestError, RequestStage, ResponseBody, RootCertStore};

/// Timeout for making a connection.
const CONNECT: Duration = Duration::from_secs(5);
/// Timeout for the answer to a request including its body. A part of an upload has 16 MiB, or a few hundred
/// MiB for the largest blobs.
const ANSWER: Duration = Duration::from_secs(120);
/// Maximum length of a file of certificate authorities, in bytes. The coordinator sends the file to each
/// worker.
const MOST_CA: u64 = 256 << 10;

/// A factory of connections. Clones share the connections.
#[derive(Clone, Debug)]
pub(super) struct Http(Client<HttpRequestBody>);

/// Reads the certificate authorities in a file and returns them as PEM text.
///
/// # Errors
/// A description of the file's fault.
pub(super) fn authorities(path: &Path) -> Result<Vec<u8>, String> {
    let bad = |e: String| {
        format!(
            "{}: {e}; ca= must name a PEM file with the store's certificate authority",
            path.display()
        )
    };
    let length = std::fs::metadata(path)
        .map_err(|e| bad(e.to_string()))?
        .len();
    if length > MOST_CA {
        return Err(bad(format!("the file has more than {MOST_CA} bytes")));
    }
    let pem = std::fs::read(path).map_err(|e| bad(e.to_string()))?;
    sightline_http::roots(Some(&pem)).map_err(bad)?;
    Ok(pem)
}

impl Http {
    /// Creates a client that trusts these certificate authorities.
    ///
    /// # Errors
    /// An error if TLS cannot be set up.
    pub(super) fn new(roots: RootCertStore) -> Result<Self, String> {
        Client::new(roots, CONNECT).map(Self)
    }
}

impl HttpConnector for Http {
    fn connect(&self, _: &ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(self.clone()))
    }
}

fn error(fault: RequestError) -> HttpError {
    let kind = match fault.stage {
        RequestStage::Connecting => HttpErrorKind::Connect,
        RequestStage::Waiting => HttpErrorKind::Timeout,
        RequestStage::Talking => HttpErrorKind::Interrupted,
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
struct Body(ResponseBody);

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_longer_files_than_limit_are_rejected_unread() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ca.pem");
        let error = |length: u64| {
            std::fs::write(&path, vec![b'x'; length as usize]).unwrap();
            authorities(&path).unwrap_err()
        };
        assert!(error(MOST_CA + 1).contains("more than"));
        assert!(!error(MOST_CA).contains("more than"));
    }
}
