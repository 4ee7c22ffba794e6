//! The `sightline.v1` gRPC interface: messages, clients and servers generated from `proto/sightline/v1`.
//!
//! The comments of the .proto files are the contract. Besides the generated code, this crate converts blobs
//! to [`v1::Chunk`]s and back.
//!
//! ```
//! use sightline_proto::chunks::{Assembler, cut};
//!
//! let blob = vec![7; 3 << 20];
//! let mut assembler = Assembler::new(1 << 30);
//! for chunk in cut(&blob) {
//!     assembler.push(&chunk)?;
//! }
//! assert_eq!(assembler.finish()?, blob);
//! # Ok::<(), sightline_proto::chunks::ChunkError>(())
//! ```

pub mod chunks;

#[cfg(feature = "services")]
use std::time::Duration;

#[cfg(feature = "services")]
use tonic::transport::Endpoint;

/// Package `sightline.v1`.
#[allow(missing_docs, clippy::all, reason = "generated; the documentation is in the .proto files")]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/sightline.v1.rs"));
    #[cfg(feature = "json")]
    include!(concat!(env!("OUT_DIR"), "/sightline.v1.serde.rs"));
}

/// The compiled descriptors of the .proto files, for gRPC reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// The endpoint of a coordinator at `url`, with a connection timeout of five seconds and without Nagle's
/// algorithm.
///
/// # Errors
/// A sentence that says what is wrong with the address.
#[cfg(feature = "services")]
pub fn endpoint(url: &str) -> Result<Endpoint, String> {
    let endpoint = Endpoint::from_shared(url.to_owned()).map_err(|e| e.to_string())?;
    match (endpoint.uri().scheme_str(), endpoint.uri().host()) {
        (Some("http"), Some(_)) => {}
        (Some("https"), _) => return Err("https is not supported".to_owned()),
        _ => return Err("it must begin with http:// and a host".to_owned()),
    }
    Ok(endpoint.connect_timeout(Duration::from_secs(5)).tcp_nodelay(true))
}

#[cfg(all(test, feature = "services"))]
mod tests {
    use super::endpoint;

    #[test]
    fn an_address_has_a_scheme_and_a_host() {
        for good in ["http://127.0.0.1:7600", "http://coordinator:7600/", "http://[::1]:7600"] {
            assert!(endpoint(good).is_ok(), "{good}");
        }
        for bad in ["foo", "", "127.0.0.1:7600", "https://a:1", "ftp://a", "http:///x", "a b"] {
            assert!(endpoint(bad).is_err(), "{bad}");
        }
    }
}
