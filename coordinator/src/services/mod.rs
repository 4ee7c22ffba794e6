//! The gRPC services: they translate between the wire and the subjects, and decide nothing.

mod blocking;
mod counting;
mod crews;
mod farm;
mod forwarding;
mod front;
mod guard;
mod http;
mod jobs;
mod metrics;
mod results;
mod server;
mod status;
mod streams;
mod tls;
mod wire;
mod workers;

pub use front::{Front, ReplicaError};
pub use http::serve_http;
pub use metrics::{Probed, serve_probes};
pub use server::{ServeError, listen, serve};
pub use tls::{Tls, TlsError, TlsFiles};
