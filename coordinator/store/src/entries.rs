//! Raw entries of a store, for the transfer from one store to another. Entries are the keys and values of
//! `table.rs`, which contain their own checksums.

use base64::{Engine as _, engine::general_purpose::STANDARD_NO_PAD};

use super::error::StoreError;
use super::table::{Bytes, MAX_VALUE_BYTES, View, check};

/// Maximum length of a key, in bytes.
const MAX_KEY_BYTES: usize = 256;

/// Returns all entries, ascending by key.
pub(super) fn all(view: View<'_>) -> Result<Vec<Entry>, StoreError> {
    let all = view.0.scan(&[])?;
    Ok(all
        .into_iter()
        .map(|(key, value)| Entry { key, value })
        .collect())
}

/// An entry of a store: a key and its value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The key.
    pub key: Vec<u8>,
    /// The value. Its checksum also covers the key.
    pub value: Vec<u8>,
}

impl Entry {
    /// Returns the entry as text: the key in hexadecimal digits, the value as base64.
    pub fn written(&self) -> (String, String) {
        let key = self.key.iter().map(|byte| format!("{byte:02x}")).collect();
        (key, STANDARD_NO_PAD.encode(&self.value))
    }

    /// Parses an entry from its text and verifies its checksum.
    ///
    /// # Errors
    /// [`StoreError::View`] if the text is not a valid entry.
    pub fn parse(key: &str, value: &str) -> Result<Self, StoreError> {
        let (key, value) = Self::read(key, value)?;
        Ok(Self { key, value })
    }

    pub(super) fn read(key: &str, value: &str) -> Result<(Bytes, Bytes), StoreError> {
        let bad = |what: &str| StoreError::View {
            what: format!("the entry {key:.40}: {what}"),
        };
        if !key.len().is_multiple_of(2) || key.len() > 2 * MAX_KEY_BYTES || !key.is_ascii() {
            return Err(bad("the key does not consist of hexadecimal digits"));
        }
        let byte = |at: usize| u8::from_str_radix(&key[at..at + 2], 16).ok();
        let bytes: Option<Bytes> = (0..key.len()).step_by(2).map(byte).collect();
        let key_bytes =
            bytes.ok_or_else(|| bad("the key does not consist of hexadecimal digits"))?;
        if value.len() > 2 * MAX_VALUE_BYTES {
            return Err(bad("the value is too long"));
        }
        let value = STANDARD_NO_PAD
            .decode(value)
            .map_err(|e| bad(&e.to_string()))?;
        check(&key_bytes, &value)?;
        Ok((key_bytes, value))
    }
}

#[cfg(test)]
mod tests {
    use super::super::table::{encode, key};
    use super::*;

    #[test]
    fn entry_survives_text_and_damage_is_detected() {
        let key = key::EPOCH.to_vec();
        let entry = Entry {
            value: encode(&key, &7u64).unwrap(),
            key,
        };
        let text = entry.written();
        assert_eq!(Entry::parse(&text.0, &text.1).unwrap(), entry);
        for bad in [
            ("zz".to_owned(), text.1.clone()),
            ("6".to_owned(), text.1.clone()),
            ("66".to_owned(), text.1.clone()),
            ("é".to_owned(), text.1.clone()),
            (text.0.clone(), format!("{}A", text.1)),
            (text.0.clone(), "!".to_owned()),
            (text.0.clone(), "A".repeat(100_000)),
        ] {
            assert!(Entry::parse(&bad.0, &bad.1).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn longest_key_is_read_and_longer_one_is_not() {
        let read = |length: usize| {
            let key = vec![b'k'; length];
            let value = encode(&key, &7u64).unwrap();
            let text = Entry { key, value }.written();
            Entry::parse(&text.0, &text.1).is_ok()
        };
        assert_eq!([256, 257].map(read), [true, false]);
    }
}
