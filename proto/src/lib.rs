//! The `sightline.v1` gRPC interface: messages, clients and servers generated from `proto/sightline/v1`.
//!
//! The contract is in the .proto files' comments. Beside the generated code there is only the conversion between
//! large things and [`v1::Chunk`]s.

pub mod chunks;

/// Package `sightline.v1`.
#[allow(missing_docs, clippy::all, reason = "generated; the documentation is in the .proto files")]
pub mod v1 {
    tonic::include_proto!("sightline.v1");
}

/// The compiled descriptors of both files, for gRPC reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
