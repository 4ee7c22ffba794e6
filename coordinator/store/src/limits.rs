//! How long each stored text may be, and the checks of it.
//!
//! The limits keep every stored value under 4 KiB (`table.rs` checks the encoded value again). Identifiers
//! and names that are too long are refused; reasons are shortened, because a failure must always be
//! recordable. Characters that JSON would have to escape are refused or replaced for the same reason.

use sightline_records::MAX_REASON_BYTES;

use super::error::StoreError;

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
