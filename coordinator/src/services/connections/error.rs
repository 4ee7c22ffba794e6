//! Errors of listeners and servers.

use std::net::SocketAddr;

/// An error of a coordinator that cannot serve, or whose server stopped.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address would carry plain text beyond this machine.
    #[error(
        "{0} can be reached from other machines and traffic would not be encrypted; give --tls-cert and \
         --tls-key, listen on 127.0.0.1, or say --allow-plaintext when the network is private"
    )]
    Plaintext(SocketAddr),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}; is another coordinator running there?")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// The server ended by itself.
    #[error("the server stopped: {0}")]
    Broken(String),
}
