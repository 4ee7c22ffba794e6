//! Maximum lengths of texts and lists in records.
//!
//! The limits keep every stored value below 4 KiB. The store also checks the length of the encoded value.

/// Maximum length of a request id or a numerics profile, in bytes.
pub const MAX_IDENTIFIER_BYTES: usize = 128;
/// Maximum length of a job name, in bytes.
pub const MAX_NAME_BYTES: usize = 128;
/// Maximum length of a worker name, in bytes.
pub const MAX_WORKER_BYTES: usize = 64;
/// Maximum length of a worker's signature (name, separator and identity), in bytes.
pub const MAX_SIGNATURE_BYTES: usize = MAX_WORKER_BYTES + 17;
/// Maximum length of a stored reason, in bytes. Longer reasons are cut.
pub const MAX_REASON_BYTES: usize = 200;
/// Maximum length of an opaque job specification, in bytes.
pub const MAX_SPEC_BYTES: usize = 2048;
/// Maximum number of helpers named in a tile's record. Further helpers are only counted.
pub const MAX_HELPERS: usize = 12;
/// Maximum number of workers whose failures a tile's record contains.
pub const MAX_FAILURES: usize = 8;
/// Maximum number of reasons in the record of a tile that was set aside.
pub const MAX_REASONS: usize = 4;
/// Maximum length of an owner's name, and of the user's name in a job that has an owner, in bytes.
pub const MAX_OWNER_BYTES: usize = 32;
/// Maximum number of users who own one scene.
pub const MAX_OWNERS: usize = 24;
/// Maximum number of tiles of a job.
pub const MAX_TILES: u32 = 1 << 20;
