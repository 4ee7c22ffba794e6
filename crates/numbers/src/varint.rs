//! Variable-length integers (LEB128): seven bits a byte, the least first, the top bit set on all bytes but
//! the last.
//!
//! The formats that use them accept different forms, and keep to what they accept. [`read`] accepts any form
//! of a number, also one padded with zero bits; [`read_shortest`] accepts one form for each number, so that
//! equal content has equal bytes. Both take the greatest number of bytes, which bounds the value.

/// The most bytes a number of 64 bits takes.
pub const MOST_BYTES: u32 = 10;

/// Why bytes are not a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VarintError {
    /// The bytes end within the number.
    #[error("a number is cut short")]
    CutShort,
    /// The number has bits beyond the 64th.
    #[error("a number is beyond 64 bits")]
    TooLarge,
    /// No byte among the most allowed ends the number.
    #[error("a number has too many bytes")]
    TooLong,
    /// The last byte adds nothing: the number has a shorter form.
    #[error("a number has more bytes than it needs")]
    NotShortest,
}

/// Appends `value` to `out` in its shortest form.
///
/// ```
/// use sightline_numbers::varint;
///
/// let mut bytes = Vec::new();
/// varint::write(&mut bytes, 300);
/// assert_eq!(bytes, [0xac, 0x02]);
/// let mut rest = bytes.as_slice();
/// assert_eq!(varint::read(&mut rest, varint::MOST_BYTES), Ok(300));
/// assert!(rest.is_empty());
/// ```
#[inline]
pub fn write(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Takes a number of at most `most_bytes` (1 to [`MOST_BYTES`]) bytes off the front of `from`, in any form.
/// `from` is left as it is on an error.
///
/// # Errors
/// [`VarintError::CutShort`], [`VarintError::TooLarge`] and [`VarintError::TooLong`].
#[inline]
pub fn read(from: &mut &[u8], most_bytes: u32) -> Result<u64, VarintError> {
    take(from, most_bytes, false)
}

/// Takes a number of at most `most_bytes` (1 to [`MOST_BYTES`]) bytes off the front of `from`, in its
/// shortest form only. `from` is left as it is on an error.
///
/// # Errors
/// Any [`VarintError`].
#[inline]
pub fn read_shortest(from: &mut &[u8], most_bytes: u32) -> Result<u64, VarintError> {
    take(from, most_bytes, true)
}

#[inline]
fn take(from: &mut &[u8], most_bytes: u32, shortest: bool) -> Result<u64, VarintError> {
    debug_assert!((1..=MOST_BYTES).contains(&most_bytes));
    let mut rest = *from;
    let mut value = 0u64;
    for shift in (0..most_bytes).map(|i| 7 * i) {
        let (&byte, after) = rest.split_first().ok_or(VarintError::CutShort)?;
        rest = after;
        let bits = u64::from(byte & 0x7f);
        if bits << shift >> shift != bits {
            return Err(VarintError::TooLarge);
        }
        value |= bits << shift;
        if byte < 0x80 {
            if shortest && shift > 0 && byte == 0 {
                return Err(VarintError::NotShortest);
            }
            *from = rest;
            return Ok(value);
        }
    }
    Err(VarintError::TooLong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bytes_have_known_answers() {
        for (value, expected) in [
            (0, &[0][..]),
            (127, &[0x7f]),
            (128, &[0x80, 1]),
            (16_384, &[0x80, 0x80, 1]),
            (
                u64::MAX,
                &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1],
            ),
        ] {
            let mut bytes = Vec::new();
            write(&mut bytes, value);
            assert_eq!(bytes, expected);
        }
    }

    #[test]
    fn bad_numbers_are_refused_with_the_reason_and_nothing_is_taken() {
        use VarintError::*;
        let full = [0xff; 10];
        let beyond = [&[0x80; 9][..], &[2]].concat();
        for (bytes, most_bytes, shortest, expected) in [
            (&[][..], 10, false, CutShort),
            (&[0x80], 10, false, CutShort),
            (&full, 5, false, TooLong),
            (&full, 9, true, TooLong),
            (&full, 10, false, TooLarge),
            (&beyond, 10, false, TooLarge),
            (&[0x80; 10], 10, false, TooLong),
            (&[0x80, 0], 10, true, NotShortest),
        ] {
            let mut rest = bytes;
            assert_eq!(
                take(&mut rest, most_bytes, shortest),
                Err(expected),
                "{bytes:x?}"
            );
            assert_eq!(rest, bytes);
        }
    }

    #[test]
    fn padded_numbers_are_read_where_they_are_allowed() {
        assert_eq!(read(&mut &[0x81, 0x80, 0][..], 10), Ok(1));
        assert_eq!(read_shortest(&mut &[0][..], 9), Ok(0));
        assert_eq!(
            read(&mut &[0xff, 0xff, 0xff, 0xff, 0x7f][..], 5),
            Ok((1 << 35) - 1)
        );
    }

    proptest! {
        #[test]
        fn numbers_come_back(value in (any::<u64>(), 0u32..64).prop_map(|(v, s)| v >> s), tail: Vec<u8>) {
            let mut bytes = Vec::new();
            write(&mut bytes, value);
            let length = bytes.len();
            bytes.extend(&tail);
            for shortest in [false, true] {
                let mut rest = bytes.as_slice();
                prop_assert_eq!(take(&mut rest, MOST_BYTES, shortest), Ok(value));
                prop_assert_eq!(rest.len(), bytes.len() - length);
            }
        }
    }
}
