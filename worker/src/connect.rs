//! Connections to the coordinator, with a time limit that includes the look-up of the coordinator's name.
//!
//! The default connector of gRPC limits only the connection of the socket. If a name server does not answer
//! while the coordinator restarts, as in some container networks, a look-up takes ten seconds. The worker
//! would then reconnect too late for its tile.

use std::io;
use std::time::Duration;

use hyper_util::rt::TokioIo;
use sightline_proto::connection::{Connection, Credentials};
use tokio::net::TcpStream;
use tonic::transport::{Endpoint, Uri};

/// Timeout for an attempt to connect. After a restart the coordinator reserves tiles for their workers for
/// 2.5 s.
const CONNECT: Duration = Duration::from_secs(1);

/// Creates a channel that connects at its first use, and again after its connection broke.
pub fn channel(endpoint: &Endpoint, credentials: &Credentials) -> Connection {
    credentials.over(endpoint.connect_with_connector_lazy(tower::service_fn(
        |address: Uri| async move {
            let connected = tokio::time::timeout(CONNECT, connect(&address)).await;
            connected.unwrap_or_else(|_| {
                Err(io::Error::new(
                    io::ErrorKind::TimedOut,
                    format!("the coordinator accepted no connection within {CONNECT:?}"),
                ))
            })
        },
    )))
}

async fn connect(address: &Uri) -> io::Result<TokioIo<TcpStream>> {
    // [`Credentials::endpoint`] has checked that the host exists and that the scheme is http or https.
    let host = address
        .host()
        .unwrap_or_default()
        .trim_start_matches('[')
        .trim_end_matches(']');
    let port = if address.scheme_str() == Some("https") {
        443
    } else {
        80
    };
    let stream = TcpStream::connect((host, address.port_u16().unwrap_or(port))).await?;
    stream.set_nodelay(true)?;
    Ok(TokioIo::new(stream))
}
