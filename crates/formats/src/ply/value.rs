//! Numbers one after another from the body of a PLY file, as text or as bytes of either order.

use super::header::{NumberKind, Property};

/// A stream of numbers. Every read returns `None` when the next number is missing or malformed;
/// [`Values::why`] then says which.
pub trait Values {
    /// The next number, rounded to `f32`.
    fn float(&mut self, kind: NumberKind) -> Option<f32>;
    /// The next number, which must be an integer.
    fn integer(&mut self, kind: NumberKind) -> Option<i64>;
    /// Steps over `n` numbers.
    fn skip(&mut self, kind: NumberKind, n: usize) -> Option<()>;
    /// Bytes not read yet.
    fn left(&self) -> usize;
    /// The least number of bytes one number takes.
    fn least_value_bytes(&self, kind: NumberKind) -> u64;
    /// The least number of bytes a property takes: a list may be empty, but not its length.
    fn least_bytes(&self, p: &Property) -> u64 {
        self.least_value_bytes(p.list.unwrap_or(p.kind))
    }
    /// Whether anything but padding is left.
    fn has_rest(&self) -> bool;
    /// Why the last read failed.
    fn why(&self) -> String;
}

/// Numbers as text, separated by white space.
pub struct Ascii<'a> {
    body: &'a [u8],
    at: usize,
    /// Where the last token began.
    token: usize,
    /// Lines before the body.
    lines: usize,
}

impl<'a> Ascii<'a> {
    /// Over `body`, which comes after `lines` lines.
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
        // A digit and the space after it; callers allow for the last number having none.
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
            "the file ends before it".to_owned()
        } else {
            format!(
                "\"{}\" (line {line}) is not a number of its type",
                String::from_utf8_lossy(token)
            )
        }
    }
}

/// Numbers as bytes.
pub struct Binary<'a> {
    rest: &'a [u8],
    big: bool,
}

impl<'a> Binary<'a> {
    /// Over `body`; `big` says that the most significant byte comes first.
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
            // Out of range becomes infinite, which the caller refuses.
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
            "the file ends before it".to_owned()
        } else {
            "it is not a whole number".to_owned()
        }
    }
}

/// `x` as an integer when it is one.
fn whole(x: f64) -> Option<i64> {
    // Up to 2⁵³ every integer is a distinct double.
    (x.fract() == 0.0 && x.abs() <= 9_007_199_254_740_992.0).then_some(x as i64)
}
