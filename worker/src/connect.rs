//! Connections to the coordinator, with a limit on the time that one takes, the look-up of its name included.
//!
//! The usual connector of gRPC limits the connection of the socket alone. Where a name server does not answer
//! while the coordinator restarts (in a network of containers, for one), a look-up takes ten seconds, and the
//! worker would come back too late for its tile.

use std::io;
use std::time::Duration;

use hyper_util::rt::TokioIo;
use sightline_proto::connecting::{Connection, Credentials};
use tokio::net::TcpStream;
use tonic::transport::{Endpoint, Uri};

/// How long an attempt to connect takes at most: after a restart the coordinator keeps tiles for its workers
/// for two and a half seconds.
const CONNECT: Duration = Duration::from_secs(1);

/// A channel that connects when it is used, and again when its connection has broken.
pub fn channel(endpoint: &Endpoint, credentials: &Credentials) -> Connection {
    credentials.over(endpoint.connect_with_connector_lazy(tower::service_fn(
        |address: Uri| async move {
            let connected = tokio::time::timeout(CONNECT, connect(&address)).await;
            connected.unwrap_or_else(|_| {
                Err(io::Error::new(
                    io::ErrorKind::TimedOut,
                    format!("no connection within {CONNECT:?}"),
                ))
            })
        },
    )))
}

async fn connect(address: &Uri) -> io::Result<TokioIo<TcpStream>> {
    // Checked by [`Credentials::endpoint`]: there is a host, and the scheme is http or https.
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
