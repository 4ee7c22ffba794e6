//! Errors of listeners and servers.

use std::net::SocketAddr;

/// The reason why a coordinator cannot serve, or why its server stopped.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address would carry unencrypted traffic beyond this machine.
    #[error(
        "{0} is reachable from other machines, and traffic would not be encrypted; give --tls-cert \
         and --tls-key, listen on 127.0.0.1, or give --allow-plaintext if the network is private"
    )]
    Plaintext(SocketAddr),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}; is another coordinator running there?")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The server ended by itself.
    #[error("the server stopped: {0}")]
    Broken(String),
}
