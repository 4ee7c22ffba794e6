//! Escapes for terminals: control characters of names, files and answers are escaped.
//!
//! A name with an escape sequence could move the cursor, rename the window or hide other output. The escapes
//! are escapes of JSON, so escaped JSON is still JSON.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io;

use serde::Serialize;
use serde_json::Serializer;
use serde_json::ser::Formatter;

/// Returns a name with all control characters escaped, including line ends, as `\u001b`.
pub fn name(text: &str) -> Cow<'_, str> {
    escaped(text, |_| false)
}

/// Returns a text of several lines with its control characters escaped. Line ends and tabs stay.
pub fn text(text: &str) -> Cow<'_, str> {
    escaped(text, |c| matches!(c, '\n' | '\t'))
}

fn escaped(text: &str, stays: impl Fn(char) -> bool) -> Cow<'_, str> {
    let is_hidden = |c: char| (c.is_control() || turns_direction(c)) && !stays(c);
    if !text.contains(is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_hidden(c) {
            // All these characters have four digits. Writing to a string does not fail.
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// Writes a value as JSON, with the control characters of its strings escaped.
///
/// # Errors
/// [`io::Error`] if the writer fails, or the value cannot be serialised.
pub fn json(to: impl io::Write, value: &impl Serialize) -> io::Result<()> {
    value
        .serialize(&mut Serializer::with_formatter(to, Escaped))
        .map_err(io::Error::from)
}

/// The compact format of JSON with more escapes, because serde_json does not escape DEL and higher
/// characters.
struct Escaped;

impl Formatter for Escaped {
    fn write_string_fragment<W: io::Write + ?Sized>(
        &mut self,
        to: &mut W,
        fragment: &str,
    ) -> io::Result<()> {
        to.write_all(name(fragment).as_bytes())
    }
}

/// Returns true for characters that change the writing direction (left to right, or right to left) of later
/// text.
fn turns_direction(c: char) -> bool {
    matches!(u32::from(c), 0x200e | 0x200f | 0x202a..=0x202e | 0x2066..=0x2069)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped() {
        assert_eq!(
            name("wall\u{1b}[2J\n\u{7}\u{9b}"),
            "wall\\u001b[2J\\u000a\\u0007\\u009b"
        );
        assert_eq!(name("a\u{202e}b\t"), "a\\u202eb\\u0009");
        assert_eq!(text("one\n\ttwo\r\u{1b}c"), "one\n\ttwo\\u000d\\u001bc");
        assert!(matches!(name("Wand übergröße 壁"), Cow::Borrowed(_)));
    }

    #[test]
    fn json_with_escaped_characters_is_json() {
        let value = serde_json::json!({"a\u{200f}b": "\u{7f}\u{9b}2J\u{1b}\u{202e}\n\"\\ü壁"});
        let mut streamed = Vec::new();
        json(&mut streamed, &value).unwrap();
        for text in [
            String::from_utf8(streamed).unwrap(),
            text(&value.to_string()).into_owned(),
        ] {
            assert!(
                !text.contains(|c: char| c.is_control() || turns_direction(c)),
                "{text}"
            );
            assert_eq!(
                serde_json::from_str::<serde_json::Value>(&text).unwrap(),
                value
            );
        }
    }
}
