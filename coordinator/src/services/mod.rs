//! The gRPC services, which translate between the wire and the subjects and make no decisions.

#[cfg(test)]
mod admission_tests;
mod answer_right;
mod authorize;
mod blocking;
mod call_metrics;
#[cfg(test)]
mod caller_tests;
mod connections;
mod crews;
mod farm;
mod forwarder;
mod front;
#[doc(hidden)]
pub mod fuzzing;
mod http;
mod jobs;
mod metered;
mod metrics;
mod results;
mod server;
mod silence;
mod spooling;
mod status;
mod streams;
mod tls;
mod wire;
mod workers;

pub use connections::{ConnectionLimits, Connections, FewDescriptors, Listener, ServeError};
pub use front::{Front, ReplicaError};
pub use http::serve_http;
pub use metrics::{Probed, serve_probes};
pub use server::serve;
pub use tls::{Tls, TlsError, TlsFiles};

/// The answer to a call: a message or an error.
type Answer<T> = Result<tonic::Response<T>, tonic::Status>;
