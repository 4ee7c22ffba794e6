//! Variable-length integers (LEB128): seven bits per byte, the lowest bits first, the top bit set on all
//! bytes except the last.
//!
//! The reader of each file format uses one of two functions. [`read`] accepts every encoding of a number,
//! including encodings that are padded with zero bits. [`read_shortest`] accepts only the shortest encoding,
//! so that equal content has equal bytes. Both functions have a limit on the number of encoded bytes, which
//! bounds the value.

/// The maximum number of encoded bytes of a 64-bit number.
pub const MOST_BYTES: u32 = 10;

/// The reason why bytes are not a valid variable-length integer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VarintError {
    /// The input ends before the last byte of the number.
    #[error("the input ends within a variable-length integer")]
    CutShort,
    /// The number has bits beyond the 64th.
    #[error("a variable-length integer exceeds 64 bits")]
    TooLarge,
    /// The number does not end within the allowed number of bytes.
    #[error("a variable-length integer has more bytes than its format allows")]
    TooLong,
    /// The last of several bytes is 0, so the number has a shorter encoding.
    #[error("a variable-length integer is not in its shortest encoding")]
    NotShortest,
}

/// Appends the shortest encoding of `value` to `out`.
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

/// Reads a number in any encoding from the front of `from` and advances `from` past the number.
///
/// The encoding has at most `most_bytes` bytes (1 to [`MOST_BYTES`]). An error leaves `from` unchanged.
///
/// # Errors
/// [`VarintError::CutShort`] if the input ends within the number, [`VarintError::TooLarge`] if the number has
/// more than 64 bits, and [`VarintError::TooLong`] if the encoding has more than `most_bytes` bytes.
#[inline]
pub fn read(from: &mut &[u8], most_bytes: u32) -> Result<u64, VarintError> {
    take(from, most_bytes, false)
}

/// Reads a number in its shortest encoding from the front of `from` and advances `from` past the number.
///
/// The encoding has at most `most_bytes` bytes (1 to [`MOST_BYTES`]). An error leaves `from` unchanged.
///
/// # Errors
/// The errors of [`read`], and [`VarintError::NotShortest`] if the number has a shorter encoding.
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
    fn invalid_numbers_return_error_and_leave_input_unchanged() {
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
    fn read_accepts_padded_numbers() {
        assert_eq!(read(&mut &[0x81, 0x80, 0][..], 10), Ok(1));
        assert_eq!(read_shortest(&mut &[0][..], 9), Ok(0));
        assert_eq!(
            read(&mut &[0xff, 0xff, 0xff, 0xff, 0x7f][..], 5),
            Ok((1 << 35) - 1)
        );
    }

    proptest! {
        #[test]
        fn numbers_round_trip(value in (any::<u64>(), 0u32..64).prop_map(|(v, s)| v >> s), tail: Vec<u8>) {
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
