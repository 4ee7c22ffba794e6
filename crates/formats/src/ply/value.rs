//! Streams of the numbers in the body of a PLY file, as text or as bytes of either order.

use super::header::{NumberKind, Property};

/// A stream of numbers. Every read returns `None` if the next number is missing or malformed; [`Values::why`]
/// then describes the fault.
pub trait Values {
    /// Reads the next number, rounded to `f32`.
    fn float(&mut self, kind: NumberKind) -> Option<f32>;
    /// Reads the next number, which must be an integer.
    fn integer(&mut self, kind: NumberKind) -> Option<i64>;
    /// Skips `n` numbers.
    fn skip(&mut self, kind: NumberKind, n: usize) -> Option<()>;
    /// Returns the number of bytes that are not read yet.
    fn left(&self) -> usize;
    /// Returns the minimum size of a number of type `kind`, in bytes.
    fn least_value_bytes(&self, kind: NumberKind) -> u64;
    /// Returns the minimum size of a property, in bytes. A list may be empty, but its length needs space.
    fn least_bytes(&self, p: &Property) -> u64 {
        self.least_value_bytes(p.list.unwrap_or(p.kind))
    }
    /// Returns true if unread bytes other than white space and zeros are left.
    fn has_rest(&self) -> bool;
    /// Returns a description of the fault of the last read, which must have failed.
    fn why(&self) -> String;
}

/// A stream of numbers as text, separated by white space.
pub struct Ascii<'a> {
    body: &'a [u8],
    /// The offset in `body` of the first unread byte.
    at: usize,
    /// The offset in `body` of the token that was read last.
    token: usize,
    /// The number of lines of the file before the body.
    lines: usize,
}

impl<'a> Ascii<'a> {
    /// Creates a stream over `body`, which follows `lines` lines of the file.
    pub fn new(body: &'a [u8], lines: usize) -> Self {
        Self {
            body,
            at: 0,
            token: 0,
            lines,
        }
    }

    fn next(&mut self) -> Option<&'a str> {
        let rest = &self.body[self.at..];
        let start = rest
            .iter()
            .position(|b| !b.is_ascii_whitespace())
            .unwrap_or(rest.len());
        let len = rest[start..]
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(rest.len() - start);
        self.token = self.at + start;
        self.at = self.token + len;
        std::str::from_utf8(&self.body[self.token..self.at])
            .ok()
            .filter(|t| !t.is_empty())
    }
}

impl Values for Ascii<'_> {
    fn float(&mut self, _: NumberKind) -> Option<f32> {
        self.next()?.parse().ok()
    }

    fn integer(&mut self, kind: NumberKind) -> Option<i64> {
        let word = self.next()?;
        match kind {
            NumberKind::F32 | NumberKind::F64 => whole(word.parse().ok()?),
            _ => word.parse().ok(),
        }
    }

    fn skip(&mut self, _: NumberKind, n: usize) -> Option<()> {
        (0..n).try_for_each(|_| self.next().map(|_| ()))
    }

    fn left(&self) -> usize {
        self.body.len() - self.at
    }

    fn least_value_bytes(&self, _: NumberKind) -> u64 {
        // A number needs a digit and a space. Callers allow for the last number, which has no space.
        2
    }

    fn has_rest(&self) -> bool {
        self.body[self.at..]
            .iter()
            .any(|b| !b.is_ascii_whitespace() && *b != 0)
    }

    fn why(&self) -> String {
        let line = self.lines
            + 1
            + self.body[..self.token]
                .iter()
                .filter(|b| **b == b'\n')
                .count();
        let token = &self.body[self.token..self.at.min(self.token + 40)];
        if token.is_empty() {
            "the file ends before this value".to_owned()
        } else {
            format!(
                "\"{}\" (line {line}) is not a number of the property's type",
                String::from_utf8_lossy(token)
            )
        }
    }
}

/// A stream of numbers as bytes.
pub struct Binary<'a> {
    rest: &'a [u8],
    big: bool,
}

impl<'a> Binary<'a> {
    /// Creates a stream over `body`. If `big` is true, the most significant byte comes first.
    pub fn new(body: &'a [u8], big: bool) -> Self {
        Self { rest: body, big }
    }

    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        let mut b = *head;
        if self.big {
            b.reverse();
        }
        Some(b)
    }
}

impl Values for Binary<'_> {
    fn float(&mut self, kind: NumberKind) -> Option<f32> {
        Some(match kind {
            NumberKind::F32 => f32::from_le_bytes(self.bytes()?),
            // A number out of range becomes infinite, which the caller rejects.
            NumberKind::F64 => f64::from_le_bytes(self.bytes()?) as f32,
            _ => self.integer(kind)? as f32,
        })
    }

    fn integer(&mut self, kind: NumberKind) -> Option<i64> {
        Some(match kind {
            NumberKind::I8 => i64::from(i8::from_le_bytes(self.bytes()?)),
            NumberKind::U8 => i64::from(u8::from_le_bytes(self.bytes()?)),
            NumberKind::I16 => i64::from(i16::from_le_bytes(self.bytes()?)),
            NumberKind::U16 => i64::from(u16::from_le_bytes(self.bytes()?)),
            NumberKind::I32 => i64::from(i32::from_le_bytes(self.bytes()?)),
            NumberKind::U32 => i64::from(u32::from_le_bytes(self.bytes()?)),
            NumberKind::F32 => whole(f64::from(f32::from_le_bytes(self.bytes()?)))?,
            NumberKind::F64 => whole(f64::from_le_bytes(self.bytes()?))?,
        })
    }

    fn skip(&mut self, kind: NumberKind, n: usize) -> Option<()> {
        self.rest = self.rest.get(n.checked_mul(kind.size())?..)?;
        Some(())
    }

    fn left(&self) -> usize {
        self.rest.len()
    }

    fn least_value_bytes(&self, kind: NumberKind) -> u64 {
        kind.size() as u64
    }

    fn has_rest(&self) -> bool {
        self.rest
            .iter()
            .any(|b| !b.is_ascii_whitespace() && *b != 0)
    }

    fn why(&self) -> String {
        if self.rest.len() < 8 {
            "the file ends before this value, or the value is not a whole number".to_owned()
        } else {
            "the value is not a whole number".to_owned()
        }
    }
}

/// Returns `x` as an integer, or `None` if `x` is not an integer of magnitude at most 2⁵³.
fn whole(x: f64) -> Option<i64> {
    // Every integer up to 2⁵³ is a distinct double.
    (x.fract() == 0.0 && x.abs() <= 9_007_199_254_740_992.0).then_some(x as i64)
}
