//! The identity of a store: its name, by which blobs belong to it, and a secret key for leases.
//!
//! The identity is a record of the store, so an export or a migration moves it, too. Its name is also written
//! into the blob store, because a coordinator must not remove blobs that belong to another store.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sightline_records::hex_digest;
use sightline_records::ids::Digest;

use super::error::StoreError;

/// The name of a store: 16 random bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StoreId(pub [u8; 16]);

impl fmt::Display for StoreId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl FromStr for StoreId {
    type Err = ();

    /// Parses the 32 hexadecimal digits that `Display` writes.
    fn from_str(text: &str) -> Result<Self, ()> {
        let digits = Some(text)
            .filter(|text| text.len() == 32 && text.bytes().all(|b| b.is_ascii_hexdigit()));
        let number = digits
            .and_then(|text| u128::from_str_radix(text, 16).ok())
            .ok_or(())?;
        Ok(Self(number.to_be_bytes()))
    }
}

/// The name of a store of records, and the secret from which [`Self::key`] derives keys.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoreIdentity {
    #[serde(with = "hex_id")]
    id: StoreId,
    #[serde(with = "hex_digest")]
    secret: Digest,
}

impl StoreIdentity {
    /// Generates an identity from the system's random numbers.
    ///
    /// # Errors
    /// [`StoreError::Random`] if the system returns no random numbers.
    pub fn random() -> Result<Self, StoreError> {
        let (mut id, mut secret) = ([0; 16], [0; 32]);
        getrandom::fill(&mut id)
            .and_then(|()| getrandom::fill(&mut secret))
            .map_err(|e| StoreError::Random {
                what: e.to_string(),
            })?;
        Ok(Self {
            id: StoreId(id),
            secret,
        })
    }

    /// Returns the name of the store, which is not secret.
    pub fn id(&self) -> StoreId {
        self.id
    }

    /// Derives a 32-byte key for one purpose from the store's secret.
    ///
    /// `purpose` is a hard-coded, globally unique text, as [`blake3::derive_key`] requires.
    pub fn key(&self, purpose: &str) -> [u8; 32] {
        blake3::derive_key(purpose, &self.secret)
    }
}

impl fmt::Debug for StoreIdentity {
    /// Writes the name without the secret.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StoreIdentity")
            .field("id", &self.id)
            .finish_non_exhaustive()
    }
}

/// Serialization of store names as 32 hexadecimal digits.
mod hex_id {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    use super::StoreId;

    pub(super) fn serialize<S: Serializer>(id: &StoreId, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(id)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<StoreId, D::Error> {
        let text = String::deserialize(from)?;
        text.parse()
            .map_err(|()| D::Error::custom("the store's name must have 32 hexadecimal digits"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identity_survives_serialization_and_hides_secret() {
        let identity = StoreIdentity::random().unwrap();
        let text = serde_json::to_string(&identity).unwrap();
        assert_eq!(
            serde_json::from_str::<StoreIdentity>(&text).unwrap(),
            identity
        );
        assert_ne!(identity, StoreIdentity::random().unwrap());
        assert_ne!(identity.key("one"), identity.key("two"));
        let shown = format!("{identity:?}");
        assert!(!shown.contains("secret"), "{shown}");
        for wrong in ["", "0", "+0000000000000000000000000000000", &"0".repeat(33)] {
            assert!(wrong.parse::<StoreId>().is_err(), "{wrong}");
        }
    }
}
