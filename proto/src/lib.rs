//! The `sightline.v1` gRPC interface: messages, clients and servers generated from `proto/sightline/v1`.
//!
//! The comments in the .proto files specify the interface. In addition to the generated code, this crate
//! converts blobs to [`v1::Chunk`]s and back.
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
pub mod connection;

/// The generated code of the package `sightline.v1`.
#[allow(
    missing_docs,
    clippy::all,
    reason = "generated; the documentation is in the .proto files"
)]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/sightline.v1.rs"));
    #[cfg(feature = "json")]
    include!(concat!(env!("OUT_DIR"), "/sightline.v1.serde.rs"));
}

impl std::fmt::Debug for v1::Address {
    /// Hides the URL and the headers. Every holder of an address may use it, so no message and no log may
    /// show one.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Address(…)")
    }
}

/// The compiled descriptors of the .proto files, for gRPC reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// The version of the messages between coordinator and worker, which `Hello` contains.
pub const PROTOCOL: u32 = 2;
