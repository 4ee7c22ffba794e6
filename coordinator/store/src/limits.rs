//! Checks of the lengths and characters of stored texts.
//!
//! The limits keep every stored value below 4 KiB (`table.rs` checks the encoded value again). Identifiers
//! and names that are too long are rejected. Reasons are shortened instead, because a failure must always be
//! recordable. For the same reason, characters that JSON must escape are rejected or replaced.

use sightline_records::MAX_REASON_BYTES;

use super::error::StoreError;

/// Returns an error if an identifier is too long, or contains a character that JSON must escape.
pub(super) fn check_identifier(
    what: &'static str,
    text: &str,
    limit: usize,
) -> Result<(), StoreError> {
    check_length(what, text.len(), "bytes", limit)?;
    match text
        .chars()
        .find(|c| c.is_control() || matches!(c, '"' | '\\'))
    {
        Some(found) => Err(StoreError::BadCharacter { what, found }),
        None => Ok(()),
    }
}

/// Returns an error if a name is too long or contains control characters.
pub(super) fn check_name(what: &'static str, text: &str, limit: usize) -> Result<(), StoreError> {
    check_length(what, text.len(), "bytes", limit)?;
    match text.chars().find(|c| c.is_control()) {
        Some(found) => Err(StoreError::BadCharacter { what, found }),
        None => Ok(()),
    }
}

/// Returns an error if a length in a unit, such as `bytes`, exceeds its limit.
pub(super) fn check_length(
    what: &'static str,
    length: usize,
    unit: &'static str,
    limit: usize,
) -> Result<(), StoreError> {
    if length > limit {
        Err(StoreError::TooLong {
            what,
            length,
            unit,
            limit,
        })
    } else {
        Ok(())
    }
}

/// Returns a recordable reason: without quotes and control characters, cut at a character boundary.
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
