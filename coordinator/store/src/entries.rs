//! Raw entries of a store, as they go from one store to another: the keys and values of `table.rs`, which
//! have their own checksums.

use base64::{Engine as _, engine::general_purpose::STANDARD_NO_PAD};

use super::error::StoreError;
use super::table::{Bytes, MAX_VALUE_BYTES, View, check};

/// Longest key.
const MAX_KEY_BYTES: usize = 256;

/// Everything, ascending by key.
pub(super) fn all(view: View<'_>) -> Result<Vec<Entry>, StoreError> {
    let all = view.0.scan(&[])?;
    Ok(all
        .into_iter()
        .map(|(key, value)| Entry { key, value })
        .collect())
}

/// A key and its value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The key.
    pub key: Vec<u8>,
    /// The value, whose checksum covers the key, too.
    pub value: Vec<u8>,
}

impl Entry {
    /// The entry as text: the key in hexadecimal digits, the value as base64.
    pub fn written(&self) -> (String, String) {
        let key = self.key.iter().map(|byte| format!("{byte:02x}")).collect();
        (key, STANDARD_NO_PAD.encode(&self.value))
    }

    /// The entry of such a text, its checksum checked.
    ///
    /// # Errors
    /// [`StoreError::View`] when it is none.
    pub fn of_text((key, value): &(String, String)) -> Result<Self, StoreError> {
        let (key, value) = Self::read(&(key.clone(), value.clone()))?;
        Ok(Self { key, value })
    }

    pub(super) fn read((key, value): &(String, String)) -> Result<(Bytes, Bytes), StoreError> {
        let bad = |what: &str| StoreError::View {
            what: format!("the entry {key:.40}: {what}"),
        };
        if key.len() % 2 != 0 || key.len() > 2 * MAX_KEY_BYTES || !key.is_ascii() {
            return Err(bad("its key is not of hexadecimal digits"));
        }
        let byte = |at: usize| u8::from_str_radix(&key[at..at + 2], 16).ok();
        let bytes: Option<Bytes> = (0..key.len()).step_by(2).map(byte).collect();
        let key_bytes = bytes.ok_or_else(|| bad("its key is not of hexadecimal digits"))?;
        if value.len() > 2 * MAX_VALUE_BYTES {
            return Err(bad("its value is too long"));
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
    fn an_entry_comes_back_and_damage_is_found() {
        let key = key::EPOCH.to_vec();
        let entry = Entry {
            value: encode(&key, &7u64).unwrap(),
            key,
        };
        let text = entry.written();
        assert_eq!(Entry::of_text(&text).unwrap(), entry);
        for bad in [
            ("zz".to_owned(), text.1.clone()),
            ("6".to_owned(), text.1.clone()),
            ("66".to_owned(), text.1.clone()),
            ("é".to_owned(), text.1.clone()),
            (text.0.clone(), format!("{}A", text.1)),
            (text.0.clone(), "!".to_owned()),
            (text.0.clone(), "A".repeat(100_000)),
        ] {
            assert!(Entry::of_text(&bad).is_err(), "{bad:?}");
        }
    }
}
