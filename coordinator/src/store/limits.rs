//! How long each stored text may be, and the checks of it.
//!
//! The limits keep every stored value under 4 KiB (`table.rs` checks the encoded value again). Identifiers
//! and names that are too long are refused; reasons are shortened, because a failure must always be
//! recordable. Characters that JSON would have to escape are refused or replaced for the same reason.

use super::error::StoreError;

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
/// Most users who may own a scene.
pub const MAX_OWNERS: usize = 24;
/// Most tiles a job may have.
pub const MAX_TILES: u32 = 1 << 20;

/// Refuses an identifier that is too long or that JSON would have to escape.
pub(super) fn check_identifier(
    what: &'static str,
    text: &str,
    limit: usize,
) -> Result<(), StoreError> {
    check_length(what, text.len(), limit)?;
    match text
        .chars()
        .find(|c| c.is_control() || matches!(c, '"' | '\\'))
    {
        Some(found) => Err(StoreError::BadCharacter { what, found }),
        None => Ok(()),
    }
}

/// Refuses a name that is too long or holds control characters.
pub(super) fn check_name(what: &'static str, text: &str, limit: usize) -> Result<(), StoreError> {
    check_length(what, text.len(), limit)?;
    match text.chars().find(|c| c.is_control()) {
        Some(found) => Err(StoreError::BadCharacter { what, found }),
        None => Ok(()),
    }
}

/// Refuses data longer than its bound, in bytes.
pub(super) fn check_length(
    what: &'static str,
    length: usize,
    limit: usize,
) -> Result<(), StoreError> {
    if length > limit {
        Err(StoreError::TooLong {
            what,
            length,
            limit,
        })
    } else {
        Ok(())
    }
}

/// A reason made recordable: quotes and control characters replaced, cut at a character boundary.
pub(super) fn clean_reason(reason: &str) -> String {
    let mut clean = String::new();
    for c in reason.chars() {
        let c = match c {
            '"' => '\'',
            '\\' => '/',
            c if c.is_control() => ' ',
            c => c,
        };
        if clean.len() + c.len_utf8() > MAX_REASON_BYTES {
            break;
        }
        clean.push(c);
    }
    clean
}
