//! Numbers of bytes in options.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A number of bytes. As text, the number may have a unit: B, kB, MB or GB, which are powers of 1000.
///
/// ```
/// use sightline::ByteSize;
///
/// assert_eq!(serde_json::from_str::<ByteSize>("\"250kB\"")?, ByteSize(250_000));
/// assert_eq!(serde_json::from_str::<ByteSize>("250")?, ByteSize(250));
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ByteSize(pub u64);

/// Parses a number of bytes, as in `250kB`. A number without a unit is in bytes.
///
/// # Errors
/// The remedy as a text, if `text` is not a number of bytes, or the number is 0.
pub fn parse_byte_size(text: &str) -> Result<ByteSize, String> {
    let digits = text
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit = match unit {
        "" | "B" => Some(1),
        "kB" => Some(1000),
        "MB" => Some(1_000_000),
        "GB" => Some(1_000_000_000),
        _ => None,
    };
    let number = number.parse::<u64>().ok().filter(|n| *n > 0);
    let bytes = number.zip(unit).and_then(|(n, unit)| n.checked_mul(unit));
    bytes.map(ByteSize).ok_or_else(|| {
        "give a whole number of at least 1 with B, kB, MB or GB, as in 250kB".to_owned()
    })
}

impl Serialize for ByteSize {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(to)
    }
}

impl<'de> Deserialize<'de> for ByteSize {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum ByteSizeText {
            Bytes(u64),
            Text(String),
        }
        match ByteSizeText::deserialize(from)? {
            ByteSizeText::Bytes(bytes) => Ok(Self(bytes)),
            ByteSizeText::Text(text) => parse_byte_size(&text).map_err(serde::de::Error::custom),
        }
    }
}
