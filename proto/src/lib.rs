//! The `sightline.v1` gRPC interface: messages, clients and servers generated from `proto/sightline/v1`.
//!
//! The contract is in the .proto files' comments. Beside the generated code there is only the conversion between
//! large things and [`v1::Chunk`]s.

pub mod chunks;

#[cfg(feature = "services")]
use std::time::Duration;

#[cfg(feature = "services")]
use tonic::transport::Endpoint;

/// Package `sightline.v1`.
#[allow(missing_docs, clippy::all, reason = "generated; the documentation is in the .proto files")]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/sightline.v1.rs"));
}

/// The compiled descriptors of both files, for gRPC reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// How a coordinator at `url` is reached: within five seconds, without waiting to fill packets.
///
/// # Errors
/// What is wrong with the address, in words.
#[cfg(feature = "services")]
pub fn endpoint(url: &str) -> Result<Endpoint, String> {
    let endpoint = Endpoint::from_shared(url.to_owned()).map_err(|e| e.to_string())?;
    match (endpoint.uri().scheme_str(), endpoint.uri().host()) {
        (Some("http"), Some(_)) => {}
        (Some("https"), _) => return Err("https is not spoken yet".to_owned()),
        _ => return Err("it does not begin with http:// and a host".to_owned()),
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
