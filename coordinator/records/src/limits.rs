//! Maximum lengths and numbers in records.
//!
//! The limits keep every stored value below 4 KiB; the store checks the encoded value again.

/// Longest request id or numerics profile, in bytes.
pub const MAX_IDENTIFIER_BYTES: usize = 128;
/// Longest job name, in bytes.
pub const MAX_NAME_BYTES: usize = 128;
/// Longest worker name, in bytes.
pub const MAX_WORKER_BYTES: usize = 64;
/// Longest worker name with the worker's identity, in bytes.
pub const MAX_SIGNATURE_BYTES: usize = MAX_WORKER_BYTES + 17;
/// Reasons are cut to this many bytes.
pub const MAX_REASON_BYTES: usize = 200;
/// Longest opaque job specification, in bytes.
pub const MAX_SPEC_BYTES: usize = 2048;
/// Helpers that are named in a tile's record; the others are counted.
pub const MAX_HELPERS: usize = 12;
/// Different workers' failures remembered of one tile.
pub const MAX_FAILURES: usize = 8;
/// Reasons remembered of a tile set aside.
pub const MAX_REASONS: usize = 4;
/// Longest name of an owner, in bytes, and of the user of a job that has an owner.
pub const MAX_OWNER_BYTES: usize = 32;
/// Maximum number of users who own one scene.
pub const MAX_OWNERS: usize = 24;
/// Maximum number of tiles of a job.
pub const MAX_TILES: u32 = 1 << 20;
