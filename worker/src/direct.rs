//! Direct transfers of blobs between this worker and the blob store, at addresses that the coordinator signs.
//!
//! An address is a secret while it is valid, so messages contain only its host.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use sightline_http::{Client, Request, RequestError, RequestStage, StatusCode, Uri, header};
use sightline_proto::v1;

use crate::leased_tile::LeasedTile;

/// Timeout for making a connection. It is short, because the coordinator is an alternative route.
const CONNECT: Duration = Duration::from_secs(3);
/// Timeout for the beginning of an answer.
const ANSWER: Duration = Duration::from_secs(60);
/// Timeout for an upload that makes progress.
const UPLOAD: Duration = Duration::from_secs(3600);
/// Timeout for an upload without progress.
const STALL: Duration = Duration::from_secs(60);
/// The interval between checks of an upload's progress.
const LOOK: Duration = Duration::from_millis(250);
/// The time for which an unreachable store is not used, unless another session begins.
pub const PAUSE: Duration = Duration::from_secs(600);
/// The number of bytes of an upload that are passed to the connection at a time.
const PIECE: usize = 64 << 10;

/// The reason why a direct transfer failed.
#[derive(Debug)]
pub enum TransferError {
    /// The store cannot be reached or rejects all requests, so the next blob would fail, too.
    Store(String),
    /// The connection broke, or the store has an internal fault. The transfer may be retried at once.
    Broken(String),
    /// The blob is missing, or differs from the announced blob.
    Blob(String),
    /// The tile is cancelled.
    Cancelled,
}

/// A request body that reports the number of bytes sent.
#[derive(Debug, Default)]
pub struct UploadBody {
    bytes: Bytes,
    sent: Arc<AtomicU64>,
}

impl Body for UploadBody {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        if self.bytes.is_empty() {
            return Poll::Ready(None);
        }
        let length = self.bytes.len().min(PIECE);
        self.sent.fetch_add(length as u64, Ordering::Relaxed);
        Poll::Ready(Some(Ok(Frame::data(self.bytes.split_to(length)))))
    }

    fn is_end_stream(&self) -> bool {
        self.bytes.is_empty()
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.bytes.len() as u64)
    }
}

/// This worker's access to the blob store, if it is allowed and offered.
pub struct Direct {
    is_allowed: bool,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The client, and the PEM text of the authorities that it trusts in addition to the system's.
    client: Option<(Client<UploadBody>, Vec<u8>)>,
    /// True if the welcome of the current session offered direct access.
    is_offered: bool,
    paused: Option<Instant>,
}

impl Direct {
    /// Creates the state of a worker to which no store was offered yet.
    pub fn new(is_allowed: bool) -> Self {
        Self {
            is_allowed,
            state: Mutex::default(),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a session. `offered` contains the settings for direct access, or is `None` if the coordinator
    /// offers no addresses.
    pub fn welcome(&self, offered: Option<v1::Direct>) {
        let mut state = self.state();
        (state.is_offered, state.paused) = (false, None);
        let Some(v1::Direct { ca }) = offered.filter(|_| self.is_allowed) else {
            return;
        };
        if state.client.as_ref().is_none_or(|(_, known)| *known != ca) {
            let pem = Some(&ca[..]).filter(|ca| !ca.is_empty());
            match sightline_http::roots(pem).and_then(|roots| Client::new(roots, CONNECT)) {
                Ok(client) => state.client = Some((client, ca)),
                Err(e) => {
                    tracing::warn!(
                        "the object store is unusable, because its authority from the coordinator \
                         is invalid: {e}; all blobs go through the coordinator"
                    );
                    return;
                }
            }
        }
        state.is_offered = true;
    }

    /// Returns the client of the store, or `None` if blobs pass through the coordinator.
    pub fn client(&self) -> Option<Client<UploadBody>> {
        let state = self.state();
        let is_paused = state.paused.is_some_and(|since| since.elapsed() < PAUSE);
        state
            .client
            .as_ref()
            .filter(|_| state.is_offered && !is_paused)
            .map(|(client, _)| client.clone())
    }

    /// Pauses direct access, because the store cannot be reached.
    pub fn pause(&self) {
        self.state().paused = Some(Instant::now());
    }
}

/// Returns the host of an address, for messages.
pub fn host(address: &v1::Address) -> String {
    let uri = address.url.parse::<Uri>().ok();
    uri.as_ref()
        .and_then(Uri::host)
        .unwrap_or("an invalid address")
        .to_owned()
}

fn request(method: &str, address: &v1::Address) -> Result<sightline_http::Builder, TransferError> {
    let unusable = || TransferError::Store("the coordinator sent an invalid address".to_owned());
    // The error of an invalid address could contain parts of it.
    let uri: Uri = address.url.parse().map_err(|_| unusable())?;
    if !matches!(uri.scheme_str(), Some("http" | "https")) || uri.host().is_none() {
        return Err(unusable());
    }
    let mut request = Request::builder().method(method).uri(uri);
    for v1::Header { name, value } in &address.headers {
        request = request.header(name, value);
    }
    Ok(request)
}

fn built(
    builder: sightline_http::Builder,
    body: UploadBody,
) -> Result<Request<UploadBody>, TransferError> {
    builder
        .body(body)
        .map_err(|_| TransferError::Store("the coordinator sent invalid headers".to_owned()))
}

/// Returns the error for a status that is not a success.
fn refused(status: StatusCode) -> TransferError {
    let text = format!("status {}", status.as_u16());
    match status {
        StatusCode::NOT_FOUND => TransferError::Blob(text),
        StatusCode::TOO_MANY_REQUESTS => TransferError::Broken(text),
        status if status.is_server_error() => TransferError::Broken(text),
        _ => TransferError::Store(text),
    }
}

/// A blob that is being downloaded.
pub struct Download {
    bytes: Vec<u8>,
    hash: blake3::Hasher,
    total: u64,
}

impl Download {
    /// Starts the download of a blob with this length, in bytes.
    pub fn new(total: u64) -> Self {
        Self {
            bytes: Vec::new(),
            hash: blake3::Hasher::new(),
            total,
        }
    }

    /// Returns the number of received bytes.
    pub fn length(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Returns the blob if it has this digest.
    pub fn finish(self, digest: &[u8; 32]) -> Result<Vec<u8>, TransferError> {
        if self.hash.finalize().as_bytes() == digest {
            return Ok(self.bytes);
        }
        Err(TransferError::Blob(
            "the received bytes do not have the requested digest".to_owned(),
        ))
    }

    /// Reads the remaining bytes from the store.
    pub async fn continue_download(
        &mut self,
        client: &Client<UploadBody>,
        address: &v1::Address,
    ) -> Result<(), TransferError> {
        let from = self.length();
        let mut get = request("GET", address)?;
        if from > 0 {
            get = get.header(header::RANGE, format!("bytes={from}-"));
        }
        let answer = client
            .request(built(get, UploadBody::default())?, ANSWER)
            .await;
        let answer = answer.map_err(|fault| self.fault(&fault))?;
        let (status, headers) = (answer.status(), answer.headers());
        match status {
            StatusCode::PARTIAL_CONTENT if from > 0 => {
                let range = headers
                    .get(header::CONTENT_RANGE)
                    .and_then(|range| range.to_str().ok());
                if !range.is_some_and(|range| range.starts_with(&format!("bytes {from}-"))) {
                    return Err(TransferError::Blob(
                        "the store sent another part than requested".to_owned(),
                    ));
                }
            }
            // A server that does not support ranges sends the complete blob again.
            StatusCode::OK => *self = Self::new(self.total),
            status => return Err(refused(status)),
        }
        let mut body = answer.into_body();
        while let Some(piece) = body
            .next()
            .await
            .map_err(|fault| TransferError::Broken(fault.to_string()))?
        {
            // Memory grows with the received bytes, and is limited by the announced length.
            if self.length() + piece.len() as u64 > self.total {
                return Err(TransferError::Blob(
                    "the blob is longer than announced".to_owned(),
                ));
            }
            self.hash.update(&piece);
            self.bytes.extend_from_slice(&piece);
        }
        if self.length() < self.total {
            return Err(TransferError::Broken(format!(
                "the answer of the store ended after {} of {} bytes",
                self.length(),
                self.total
            )));
        }
        Ok(())
    }

    /// Converts an error. A store that cannot be connected to before the first byte is not retried. A store
    /// that sent bytes before may become reachable again.
    fn fault(&self, fault: &RequestError) -> TransferError {
        match fault.stage {
            RequestStage::Connecting if self.bytes.is_empty() => {
                TransferError::Store(format!("no connection: {fault}"))
            }
            _ => TransferError::Broken(fault.to_string()),
        }
    }
}

/// Writes an output to the store. Ends early if the lease ends.
pub async fn upload(
    client: &Client<UploadBody>,
    address: &v1::Address,
    bytes: Bytes,
    leased: &LeasedTile,
) -> Result<(), TransferError> {
    let body = UploadBody {
        bytes,
        sent: Arc::default(),
    };
    let sent = Arc::clone(&body.sent);
    let put = built(request("PUT", address)?, body)?;
    let answer = tokio::select! {
        answer = client.request(put, UPLOAD) => answer,
        error = stalled(&sent, leased) => return Err(error),
    };
    let answer = answer.map_err(|fault| match fault.stage {
        RequestStage::Connecting => TransferError::Store(format!("no connection: {fault}")),
        _ => TransferError::Broken(fault.to_string()),
    })?;
    if answer.status() == StatusCode::OK {
        Ok(())
    } else {
        Err(refused(answer.status()))
    }
}

/// Waits until an upload makes no progress or is no longer needed, and returns the reason.
async fn stalled(sent: &AtomicU64, leased: &LeasedTile) -> TransferError {
    use sightline_bake::Watcher as _;
    let (mut last, mut since) = (0, Instant::now());
    loop {
        tokio::time::sleep(LOOK).await;
        let now = sent.load(Ordering::Relaxed);
        if leased.cancelled() {
            return TransferError::Cancelled;
        }
        if now != last {
            (last, since) = (now, Instant::now());
        } else if since.elapsed() > STALL {
            return TransferError::Broken("the upload made no progress for 60 s".to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};
    use std::net::TcpListener;

    use super::*;

    fn address(url: &str) -> v1::Address {
        v1::Address {
            url: url.to_owned(),
            seconds: 600,
            headers: Vec::new(),
        }
    }

    /// Creates a store that gives these answers, one per connection, and returns its address and a client.
    fn store(answers: Vec<String>) -> (v1::Address, Client<UploadBody>) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!(
            "http://{}/blob?X-Amz-Signature=hush",
            listener.local_addr().unwrap()
        );
        std::thread::spawn(move || {
            for answer in answers {
                let (mut stream, _) = listener.accept().unwrap();
                let mut asked = [0; 4096];
                let read = stream.read(&mut asked).unwrap();
                assert!(read > 0);
                stream.write_all(answer.as_bytes()).unwrap();
            }
        });
        (
            address(&url),
            Client::new(sightline_http::roots(None).unwrap(), CONNECT).unwrap(),
        )
    }

    fn answer(head: &str, length: usize, body: &str) -> String {
        format!("HTTP/1.1 {head}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}")
    }

    #[tokio::test]
    async fn download_rejects_unannounced_answers() {
        use TransferError::{Blob, Broken, Store};
        let (at, client) = store(vec![
            answer("200 OK", 7, "seventy"),
            answer("200 OK", 6, "six"),
            answer("206 Partial\r\nContent-Range: bytes 0-5/6", 6, "others"),
            answer("206 Partial\r\nContent-Range: bytes 3-5/6", 3, "ten"),
            answer("403 Forbidden", 4, "hush"),
            answer("404 Not Found", 0, ""),
            answer("503 Slow Down", 0, ""),
        ]);
        let mut download = Download::new(6);
        assert!(
            matches!(download.continue_download(&client, &at).await, Err(Blob(e)) if e.contains("longer"))
        );
        // The received bytes stay. The next request asks for the rest, and its answer must be that part.
        let mut download = Download::new(6);
        assert!(matches!(
            download.continue_download(&client, &at).await,
            Err(Broken(_))
        ));
        assert_eq!(download.length(), 3);
        assert!(
            matches!(download.continue_download(&client, &at).await, Err(Blob(e)) if e.contains("part"))
        );
        download.continue_download(&client, &at).await.unwrap();
        assert_eq!(download.length(), 6);
        assert_eq!(
            download.finish(blake3::hash(b"sixten").as_bytes()).unwrap(),
            b"sixten"
        );
        let mut errors = Vec::new();
        for _ in 0..3 {
            let mut download = Download::new(6);
            errors.push(download.continue_download(&client, &at).await.unwrap_err());
        }
        assert!(matches!(&errors[..], [Store(e), Blob(_), Broken(_)] if e == "status 403"));
        assert!(matches!(Download::new(0).finish(&[0; 32]), Err(Blob(e)) if e.contains("digest")));
    }

    #[tokio::test]
    async fn messages_contain_no_address() {
        let (_, client) = store(Vec::new());
        for url in [
            "",
            "ftp://a/?hush",
            "/?hush",
            "http://127.0.0.1:9/?hush",
            "http://no host/?hush",
        ] {
            let at = address(url);
            let error = Download::new(1)
                .continue_download(&client, &at)
                .await
                .unwrap_err();
            let text = format!("{error:?} {} {at:?}", host(&at));
            assert!(
                matches!(error, TransferError::Store(_)) && !text.contains("hush"),
                "{text}"
            );
        }
        let mut at = address("http://127.0.0.1:9/");
        at.headers.push(v1::Header {
            name: "a b".to_owned(),
            value: "hush".to_owned(),
        });
        let text = format!(
            "{:?}",
            Download::new(1)
                .continue_download(&client, &at)
                .await
                .unwrap_err()
        );
        assert!(!text.contains("hush"), "{text}");
    }

    #[test]
    fn paused_store_is_unused_until_next_session() {
        let direct = Direct::new(true);
        assert!(direct.client().is_none());
        direct.welcome(Some(v1::Direct { ca: Vec::new() }));
        assert!(direct.client().is_some());
        direct.pause();
        assert!(direct.client().is_none());
        direct.welcome(Some(v1::Direct { ca: Vec::new() }));
        assert!(direct.client().is_some());
        direct.welcome(Some(v1::Direct {
            ca: b"no certificate".to_vec(),
        }));
        assert!(direct.client().is_none());
        direct.welcome(None);
        assert!(direct.client().is_none());
        let never = Direct::new(false);
        never.welcome(Some(v1::Direct { ca: Vec::new() }));
        assert!(never.client().is_none());
    }
}
