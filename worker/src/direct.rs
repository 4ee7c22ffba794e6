//! Blobs between this worker and the store that they are in, at addresses that the coordinator signs.
//!
//! An address is a secret while it is accepted: no message here has more of it than the host.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use sightline_http::{Client, During, Fault, Request, StatusCode, Uri, header};
use sightline_proto::v1;

use crate::leased_tile::LeasedTile;

/// How long a connection may take: who cannot reach the store has another way.
const CONNECT: Duration = Duration::from_secs(3);
/// How long an answer may take to begin.
const ANSWER: Duration = Duration::from_secs(60);
/// How long an upload may take, if it goes on all the time.
const UPLOAD: Duration = Duration::from_secs(3600);
/// How long an upload may make no progress.
const STALL: Duration = Duration::from_secs(60);
/// How often it is looked at.
const LOOK: Duration = Duration::from_millis(250);
/// How long a store that cannot be reached is left alone, unless another session begins.
pub const PAUSE: Duration = Duration::from_secs(600);
/// Bytes of an upload that are handed over at a time.
const PIECE: usize = 64 << 10;

/// Why something is not between this worker and the store.
#[derive(Debug)]
pub enum Miss {
    /// The store cannot be reached, or accepts nothing: the next blob would fare no better.
    Store(String),
    /// The connection broke, or the store is in trouble: it may be tried again at once.
    Broken(String),
    /// This blob is not there, or not as announced.
    Blob(String),
    /// The tile is cancelled.
    Cancelled,
}

/// A body of a request: bytes whose progress can be seen.
#[derive(Debug, Default)]
pub struct Sending {
    bytes: Bytes,
    sent: Arc<AtomicU64>,
}

impl Body for Sending {
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

/// Whether and how this worker reaches the store of the blobs.
pub struct Direct {
    is_allowed: bool,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The client, and the authorities that it trusts beside the system's.
    client: Option<(Client<Sending>, Vec<u8>)>,
    /// Set by the welcome of each session.
    is_offered: bool,
    paused: Option<Instant>,
}

impl Direct {
    /// A worker that does not know of a store yet.
    pub fn new(is_allowed: bool) -> Self {
        Self {
            is_allowed,
            state: Mutex::default(),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A session begins; the coordinator offers addresses or not.
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
                        "the object store cannot be used from here: its authority, as the coordinator has \
                         it: {e}; everything goes through the coordinator"
                    );
                    return;
                }
            }
        }
        state.is_offered = true;
    }

    /// The way to the store; `None` where blobs go through the coordinator.
    pub fn client(&self) -> Option<Client<Sending>> {
        let state = self.state();
        let is_paused = state.paused.is_some_and(|since| since.elapsed() < PAUSE);
        state
            .client
            .as_ref()
            .filter(|_| state.is_offered && !is_paused)
            .map(|(client, _)| client.clone())
    }

    /// The store cannot be reached: for a while it is not tried.
    pub fn pause(&self) {
        self.state().paused = Some(Instant::now());
    }
}

/// The host of an address, for messages.
pub fn host(address: &v1::Address) -> String {
    let uri = address.url.parse::<Uri>().ok();
    uri.as_ref()
        .and_then(Uri::host)
        .unwrap_or("an address that is none")
        .to_owned()
}

fn request(method: &str, address: &v1::Address) -> Result<sightline_http::Builder, Miss> {
    let unusable = || Miss::Store("the coordinator gave an address that is none".to_owned());
    // The error of a wrong address could have parts of it.
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

fn built(builder: sightline_http::Builder, body: Sending) -> Result<Request<Sending>, Miss> {
    builder
        .body(body)
        .map_err(|_| Miss::Store("the coordinator gave headers that are none".to_owned()))
}

/// What a status that is no success says.
fn refused(status: StatusCode) -> Miss {
    let text = format!("it answers {}", status.as_u16());
    match status {
        StatusCode::NOT_FOUND => Miss::Blob(text),
        StatusCode::TOO_MANY_REQUESTS => Miss::Broken(text),
        status if status.is_server_error() => Miss::Broken(text),
        _ => Miss::Store(text),
    }
}

/// A blob that arrives.
pub struct Download {
    bytes: Vec<u8>,
    hash: blake3::Hasher,
    total: u64,
}

impl Download {
    /// Of a blob with this length.
    pub fn new(total: u64) -> Self {
        Self {
            bytes: Vec::new(),
            hash: blake3::Hasher::new(),
            total,
        }
    }

    /// Bytes that have arrived.
    pub fn length(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// The blob, if it has this digest.
    pub fn finish(self, digest: &[u8; 32]) -> Result<Vec<u8>, Miss> {
        if self.hash.finalize().as_bytes() == digest {
            return Ok(self.bytes);
        }
        Err(Miss::Blob("its bytes do not have its digest".to_owned()))
    }

    /// Reads on from where it is, to the end.
    pub async fn go_on(
        &mut self,
        client: &Client<Sending>,
        address: &v1::Address,
    ) -> Result<(), Miss> {
        let from = self.length();
        let mut get = request("GET", address)?;
        if from > 0 {
            get = get.header(header::RANGE, format!("bytes={from}-"));
        }
        let answer = client
            .request(built(get, Sending::default())?, ANSWER)
            .await;
        let answer = answer.map_err(|fault| self.fault(&fault))?;
        let (status, headers) = (answer.status(), answer.headers());
        match status {
            StatusCode::PARTIAL_CONTENT if from > 0 => {
                let range = headers
                    .get(header::CONTENT_RANGE)
                    .and_then(|range| range.to_str().ok());
                if !range.is_some_and(|range| range.starts_with(&format!("bytes {from}-"))) {
                    return Err(Miss::Blob(
                        "it sends another part than the one asked for".to_owned(),
                    ));
                }
            }
            // Whoever knows no ranges sends the whole again.
            StatusCode::OK => *self = Self::new(self.total),
            status => return Err(refused(status)),
        }
        let mut body = answer.into_body();
        while let Some(piece) = body
            .next()
            .await
            .map_err(|fault| Miss::Broken(fault.to_string()))?
        {
            // Memory grows with what arrives, and ends with what was announced.
            if self.length() + piece.len() as u64 > self.total {
                return Err(Miss::Blob("it is longer than announced".to_owned()));
            }
            self.hash.update(&piece);
            self.bytes.extend_from_slice(&piece);
        }
        if self.length() < self.total {
            return Err(Miss::Broken(format!(
                "it ended after {} of {} bytes",
                self.length(),
                self.total
            )));
        }
        Ok(())
    }

    /// A store that cannot be reached from the start is left alone; one that was reached may come back.
    fn fault(&self, fault: &Fault) -> Miss {
        match fault.during {
            During::Connecting if self.bytes.is_empty() => {
                Miss::Store(format!("no connection: {fault}"))
            }
            _ => Miss::Broken(fault.to_string()),
        }
    }
}

/// Writes an output. Ends early when its lease does.
pub async fn upload(
    client: &Client<Sending>,
    address: &v1::Address,
    bytes: Bytes,
    held: &LeasedTile,
) -> Result<(), Miss> {
    let body = Sending {
        bytes,
        sent: Arc::default(),
    };
    let sent = Arc::clone(&body.sent);
    let put = built(request("PUT", address)?, body)?;
    let answer = tokio::select! {
        answer = client.request(put, UPLOAD) => answer,
        miss = stalled(&sent, held) => return Err(miss),
    };
    let answer = answer.map_err(|fault| match fault.during {
        During::Connecting => Miss::Store(format!("no connection: {fault}")),
        _ => Miss::Broken(fault.to_string()),
    })?;
    if answer.status() == StatusCode::OK {
        Ok(())
    } else {
        Err(refused(answer.status()))
    }
}

/// Resolves when an upload makes no progress, or is not needed any more.
async fn stalled(sent: &AtomicU64, held: &LeasedTile) -> Miss {
    use sightline_bake::Watcher as _;
    let (mut last, mut since) = (0, Instant::now());
    loop {
        tokio::time::sleep(LOOK).await;
        let now = sent.load(Ordering::Relaxed);
        if held.cancelled() {
            return Miss::Cancelled;
        }
        if now != last {
            (last, since) = (now, Instant::now());
        } else if since.elapsed() > STALL {
            return Miss::Broken("the upload came to a halt".to_owned());
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

    /// A store that gives these answers, a connection each; and a client.
    fn store(answers: Vec<String>) -> (v1::Address, Client<Sending>) {
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
    async fn what_is_not_as_announced_is_refused() {
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
            matches!(download.go_on(&client, &at).await, Err(Miss::Blob(e)) if e.contains("longer"))
        );
        // What has come stays; the rest is asked for, and has to be that.
        let mut download = Download::new(6);
        assert!(matches!(
            download.go_on(&client, &at).await,
            Err(Miss::Broken(_))
        ));
        assert_eq!(download.length(), 3);
        assert!(
            matches!(download.go_on(&client, &at).await, Err(Miss::Blob(e)) if e.contains("part"))
        );
        download.go_on(&client, &at).await.unwrap();
        assert_eq!(download.length(), 6);
        assert_eq!(
            download.finish(blake3::hash(b"sixten").as_bytes()).unwrap(),
            b"sixten"
        );
        let mut miss = Vec::new();
        for _ in 0..3 {
            let mut download = Download::new(6);
            miss.push(download.go_on(&client, &at).await.unwrap_err());
        }
        assert!(
            matches!(&miss[..], [Miss::Store(e), Miss::Blob(_), Miss::Broken(_)] if e == "it answers 403")
        );
        assert!(
            matches!(Download::new(0).finish(&[0; 32]), Err(Miss::Blob(e)) if e.contains("digest"))
        );
    }

    #[tokio::test]
    async fn no_message_has_an_address() {
        let (_, client) = store(Vec::new());
        for url in [
            "",
            "ftp://a/?hush",
            "/?hush",
            "http://127.0.0.1:9/?hush",
            "http://no host/?hush",
        ] {
            let at = address(url);
            let miss = Download::new(1).go_on(&client, &at).await.unwrap_err();
            let text = format!("{miss:?} {} {at:?}", host(&at));
            assert!(
                matches!(miss, Miss::Store(_)) && !text.contains("hush"),
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
            Download::new(1).go_on(&client, &at).await.unwrap_err()
        );
        assert!(!text.contains("hush"), "{text}");
    }

    #[test]
    fn a_store_is_left_alone_until_the_next_session() {
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
