//! The header of a PLY file: its format, and the elements with their counts and properties.

/// A header that cannot be read: the number of the line, from 1, and the fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("header line {line}: {reason}")]
pub struct HeaderFault {
    /// The line.
    pub line: usize,
    /// The fault.
    pub reason: String,
}

/// The encoding of the values behind the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Text.
    Ascii,
    /// Bytes, the least significant one first.
    BinaryLittle,
    /// Bytes, the most significant one first.
    BinaryBig,
}

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberKind {
    /// `char` or `int8`.
    I8,
    /// `uchar` or `uint8`.
    U8,
    /// `short` or `int16`.
    I16,
    /// `ushort` or `uint16`.
    U16,
    /// `int` or `int32`.
    I32,
    /// `uint` or `uint32`.
    U32,
    /// `float` or `float32`.
    F32,
    /// `double` or `float64`.
    F64,
}

impl NumberKind {
    /// Both families of names are in use: C's and those with the size in bits.
    fn from_word(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary file.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// One property of an element: a number, or a list of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// The name, cut to 64 characters.
    pub name: String,
    /// Type of the number, or of the values of the list.
    pub kind: NumberKind,
    /// Type of the list's length, for a list.
    pub list: Option<NumberKind>,
}

/// An element and the count that the header announces, which is not trusted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// The name, cut to 64 characters.
    pub name: String,
    /// The announced count.
    pub count: u64,
    /// The properties, in the order of their values.
    pub properties: Vec<Property>,
}

/// The whole header.
#[derive(Debug)]
pub struct Header {
    /// The encoding of the body.
    pub format: Format,
    /// The elements, in the order of the body.
    pub elements: Vec<Element>,
    /// Offset of the first byte after it.
    pub body: usize,
    /// Number of its lines.
    pub lines: usize,
}

/// Reads the header at the beginning of a file.
///
/// # Errors
/// [`HeaderFault`] with the line at fault.
pub fn read(bytes: &[u8]) -> Result<Header, HeaderFault> {
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    let mut line = 0usize;
    loop {
        // At most one line a byte, so this cannot overflow.
        line += 1;
        let bad = |reason: String| HeaderFault { line, reason };
        let rest = bytes.get(at..).unwrap_or_default();
        let Some(len) = rest.iter().position(|b| *b == b'\n' || *b == b'\r') else {
            return Err(bad("the file ends before end_header".to_owned()));
        };
        // A line ends with \n, \r\n or, from old machines, \r.
        at += len
            + if rest[len..].starts_with(b"\r\n") {
                2
            } else {
                1
            };
        let text = String::from_utf8_lossy(&rest[..len]);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if line == 1 => {}
            [] | ["comment" | "obj_info", ..] => {}
            ["format", kind, "1.0"] if format.is_none() => {
                format = Some(match *kind {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::BinaryLittle,
                    "binary_big_endian" => Format::BinaryBig,
                    other => return Err(bad(format!("the format {} is unknown", short(other)))),
                });
            }
            ["element", name, count] => {
                let count = count
                    .parse()
                    .map_err(|_| bad(format!("the count {} is no number", short(count))))?;
                if elements.iter().any(|e| e.name == *name) {
                    return Err(bad(format!("the element {} appears twice", short(name))));
                }
                elements.push(Element {
                    name: short(name),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", words @ ..] => {
                let element = elements
                    .last_mut()
                    .ok_or_else(|| bad("a property before any element".to_owned()))?;
                let kind_of = |word: &str| {
                    NumberKind::from_word(word)
                        .ok_or_else(|| bad(format!("the type {} is unknown", short(word))))
                };
                element.properties.push(match words {
                    ["list", len, kind, name] => {
                        let len = kind_of(len)?;
                        if len.is_float() {
                            return Err(bad(
                                "the length of a list must be an integer type".to_owned()
                            ));
                        }
                        Property {
                            name: short(name),
                            kind: kind_of(kind)?,
                            list: Some(len),
                        }
                    }
                    [kind, name] => Property {
                        name: short(name),
                        kind: kind_of(kind)?,
                        list: None,
                    },
                    _ => {
                        return Err(bad(
                            "the property is not written as the format asks".to_owned()
                        ));
                    }
                });
            }
            ["end_header"] => {
                let format = format.ok_or_else(|| bad("there is no format line".to_owned()))?;
                return Ok(Header {
                    format,
                    elements,
                    body: at,
                    lines: line,
                });
            }
            _ => return Err(bad(format!("\"{}\" is not understood", short(&text)))),
        }
    }
}

/// The beginning of a word from the file: names are compared and shown, and no name that is looked for is
/// longer.
fn short(word: &str) -> String {
    word.chars().take(64).collect()
}
