//! Tests of listeners on loopback, with short time limits and small caps.

use std::net::SocketAddr;
use std::path::Path;

use axum::Router;
use axum::body::Bytes;
use axum::routing::{get, post};
use futures::Stream;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

use super::*;
use crate::TlsFiles;

const SHORT: Duration = Duration::from_millis(100);
/// Maximum time for the end of a connection before a test fails.
const LIMIT: Duration = Duration::from_secs(20);
const NEVER: Duration = Duration::from_secs(3600);
/// The beginning of every connection of HTTP/2, with empty settings.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// Returns limits that no test reaches.
fn wide() -> ConnectionLimits {
    let limits = ConnectionLimits::for_descriptors(65_536);
    ConnectionLimits {
        handshake: NEVER,
        idle: NEVER,
        grace: SHORT,
        silence: NEVER,
        unread: NEVER,
        ..limits
    }
}

/// A server that ends with the test.
struct ServedSockets {
    address: SocketAddr,
    server: JoinHandle<Infallible>,
}

impl Drop for ServedSockets {
    fn drop(&mut self) {
        self.server.abort();
    }
}

async fn serve(
    limits: ConnectionLimits,
    tls: Option<Arc<Tls>>,
    protocol: Protocol,
    routes: Router,
) -> ServedSockets {
    let connections = Connections::new(limits);
    let listener = Listener::bind("127.0.0.1:0".parse().unwrap(), false, &connections)
        .await
        .unwrap();
    let address = listener.local_addr().unwrap();
    ServedSockets {
        address,
        server: tokio::spawn(listener.serve(tls, protocol, routes)),
    }
}

fn hello() -> Router {
    Router::new()
        .route("/", get(|| async { "hello" }))
        .route("/", post(|body: Bytes| async { body }))
}

async fn connect(served: &ServedSockets) -> TcpStream {
    TcpStream::connect(served.address).await.unwrap()
}

/// Waits for the end of a connection, and returns the bytes that were received.
async fn end(mut stream: impl AsyncRead + Unpin) -> String {
    let mut text = Vec::new();
    let read = tokio::time::timeout(LIMIT, stream.read_to_end(&mut text)).await;
    // The system resets a connection that is closed with unread bytes.
    let _ = read.expect("the connection stays open");
    String::from_utf8_lossy(&text).into_owned()
}

async fn asked(mut stream: impl AsyncRead + AsyncWrite + Unpin) -> String {
    stream
        .write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        .await
        .unwrap();
    end(stream).await
}

#[tokio::test]
async fn listener_closes_connections_without_request() {
    let limits = ConnectionLimits {
        idle: SHORT,
        ..wide()
    };
    for (protocol, begun) in [
        (Protocol::Http1, &b""[..]),
        (Protocol::Http1, b"GET / HT"),
        (Protocol::Http1, b"GET / HTTP/1.1\r\nHost: localhost\r\n"),
        (Protocol::Http2, b""),
        (Protocol::Http2, &PREFACE[..10]),
        (Protocol::Http2, PREFACE),
    ] {
        let served = serve(limits, None, protocol, hello()).await;
        let mut stream = connect(&served).await;
        stream.write_all(begun).await.unwrap();
        end(stream).await;
    }
    // The pause after an answered request is limited, too.
    let served = serve(limits, None, Protocol::Http1, hello()).await;
    let mut stream = connect(&served).await;
    stream
        .write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .await
        .unwrap();
    assert!(end(stream).await.ends_with("hello"));
}

#[tokio::test]
async fn bytes_without_request_do_not_prolong_connection() {
    let limits = ConnectionLimits {
        idle: SHORT,
        ..wide()
    };
    let served = serve(limits, None, Protocol::Http1, hello()).await;
    let (mut read, mut write) = connect(&served).await.into_split();
    let sender = tokio::spawn(async move {
        while write.write_all(b"x").await.is_ok() {
            tokio::time::sleep(SHORT / 10).await;
        }
    });
    let mut text = Vec::new();
    let ended = tokio::time::timeout(LIMIT, read.read_to_end(&mut text)).await;
    assert!(ended.is_ok(), "the connection stays open");
    sender.await.unwrap();
}

#[tokio::test]
async fn body_that_stops_ends_its_request() {
    let served = serve(
        ConnectionLimits {
            silence: SHORT,
            ..wide()
        },
        None,
        Protocol::Http1,
        hello(),
    )
    .await;
    let mut stream = connect(&served).await;
    stream
        .write_all(b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nhalf")
        .await
        .unwrap();
    assert!(end(stream).await.starts_with("HTTP/1.1 4"));
}

#[tokio::test]
async fn peer_that_does_not_read_is_disconnected() {
    /// A body of endless bytes that reports when it is dropped.
    struct EndlessBytes(Option<oneshot::Sender<()>>);
    impl Stream for EndlessBytes {
        type Item = Result<Bytes, Infallible>;
        fn poll_next(
            self: std::pin::Pin<&mut Self>,
            _: &mut std::task::Context<'_>,
        ) -> std::task::Poll<Option<Self::Item>> {
            std::task::Poll::Ready(Some(Ok(Bytes::from_static(&[7; 4096]))))
        }
    }
    impl Drop for EndlessBytes {
        fn drop(&mut self) {
            if let Some(dropped) = self.0.take() {
                // The test waits for this message.
                dropped.send(()).unwrap();
            }
        }
    }

    let (dropped, ended) = oneshot::channel();
    let dropped = Arc::new(std::sync::Mutex::new(Some(dropped)));
    let endless =
        move || async move { Body::from_stream(EndlessBytes(dropped.lock().unwrap().take())) };
    let routes = Router::new().route("/", get(endless));
    let served = serve(
        ConnectionLimits {
            unread: SHORT,
            ..wide()
        },
        None,
        Protocol::Http1,
        routes,
    )
    .await;
    let mut stream = connect(&served).await;
    stream
        .write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .await
        .unwrap();
    tokio::time::timeout(LIMIT, ended)
        .await
        .expect("the connection stays open")
        .unwrap();
}

#[tokio::test]
async fn full_listener_closes_oldest_connections() {
    for limits in [
        ConnectionLimits {
            general: 8,
            ..wide()
        },
        ConnectionLimits {
            of_address: 8,
            ..wide()
        },
    ] {
        let served = serve(limits, None, Protocol::Http1, hello()).await;
        let mut idle = Vec::new();
        for _ in 0..50 {
            let mut stream = connect(&served).await;
            stream.write_all(b"GET / HT").await.unwrap();
            idle.push(stream);
        }
        assert!(asked(connect(&served).await).await.ends_with("hello"));
        // The oldest connections are closed.
        for stream in idle.drain(..40) {
            end(stream).await;
        }
    }
}

/// Creates a TLS configuration with a new certificate in this folder, and a client that trusts the
/// certificate.
fn encrypted(folder: &Path) -> (Arc<Tls>, TlsConnector) {
    let signed = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let [certificate, key] = ["server.pem", "server.key"].map(|name| folder.join(name));
    std::fs::write(&certificate, signed.cert.pem()).unwrap();
    std::fs::write(&key, signed.signing_key.serialize_pem()).unwrap();
    let tls = Tls::open(TlsFiles {
        certificate,
        key,
        client_ca: None,
    })
    .unwrap();
    let mut roots = RootCertStore::empty();
    roots.add(signed.cert.der().to_vec().into()).unwrap();
    let client = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    (Arc::new(tls), TlsConnector::from(Arc::new(client)))
}

async fn shaken(
    client: &TlsConnector,
    served: &ServedSockets,
) -> impl AsyncRead + AsyncWrite + Unpin {
    let name = ServerName::try_from("localhost").unwrap();
    client.connect(name, connect(served).await).await.unwrap()
}

#[tokio::test]
async fn handshakes_end_in_time_and_leave_room() {
    let folder = tempfile::tempdir().unwrap();
    let (tls, client) = encrypted(folder.path());
    // A handshake that never starts.
    let limits = ConnectionLimits {
        handshake: SHORT,
        ..wide()
    };
    let served = serve(limits, Some(Arc::clone(&tls)), Protocol::Http1, hello()).await;
    assert_eq!(end(connect(&served).await).await, "");
    // A finished handshake without a request.
    let limits = ConnectionLimits {
        idle: SHORT,
        ..wide()
    };
    let served = serve(limits, Some(Arc::clone(&tls)), Protocol::Http1, hello()).await;
    assert_eq!(end(shaken(&client, &served).await).await, "");
    // More handshakes than the caps permit, from one address and in total.
    for limits in [
        ConnectionLimits {
            handshakes: 4,
            ..wide()
        },
        ConnectionLimits {
            handshakes_of_address: 4,
            ..wide()
        },
    ] {
        let served = serve(limits, Some(Arc::clone(&tls)), Protocol::Http1, hello()).await;
        let mut silent = Vec::new();
        for _ in 0..40 {
            silent.push(connect(&served).await);
        }
        assert!(
            asked(shaken(&client, &served).await)
                .await
                .ends_with("hello")
        );
        for stream in silent.drain(..30) {
            end(stream).await;
        }
    }
}

#[tokio::test]
async fn dropped_server_closes_its_connections() {
    let served = serve(wide(), None, Protocol::Http1, hello()).await;
    let first = connect(&served).await;
    assert!(asked(connect(&served).await).await.ends_with("hello"));
    served.server.abort();
    end(first).await;
}
