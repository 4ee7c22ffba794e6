//! The header of a PLY file: the format of the file, and the elements with their counts and properties.

/// The fault of a header that cannot be read, with its line. Lines are numbered from 1.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("header line {line}: {reason}")]
pub struct HeaderFault {
    /// The number of the line, from 1.
    pub line: usize,
    /// A description of the fault.
    pub reason: String,
}

/// The encoding of the values after the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Numbers as text.
    Ascii,
    /// Numbers as bytes, the least significant byte first.
    BinaryLittle,
    /// Numbers as bytes, the most significant byte first.
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
    /// Returns the type with the name `word`. PLY files use two families of names: the names of C types, and
    /// names with the size in bits.
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

    /// Returns the size of a number of this type in a binary file, in bytes.
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

/// A property of an element: a number, or a list of numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// The name of the property, truncated to 64 characters.
    pub name: String,
    /// The type of the number, or of the values of the list.
    pub kind: NumberKind,
    /// The type of the list's length; `None` for a single number.
    pub list: Option<NumberKind>,
}

/// An element of a PLY file, such as `vertex`: a list of records with the same properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// The name of the element, truncated to 64 characters.
    pub name: String,
    /// The number of records that the header announces. Readers must not trust this number.
    pub count: u64,
    /// The properties, in the order of their values in a record.
    pub properties: Vec<Property>,
}

/// The contents of a header.
#[derive(Debug)]
pub struct Header {
    /// The encoding of the body.
    pub format: Format,
    /// The elements, in the order of the body.
    pub elements: Vec<Element>,
    /// The offset in the file of the first byte after the header.
    pub body: usize,
    /// The number of lines of the header.
    pub lines: usize,
}

/// Reads the header at the beginning of a file.
///
/// # Errors
/// [`HeaderFault`] with the line that contains the fault.
pub fn read(bytes: &[u8]) -> Result<Header, HeaderFault> {
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    let mut line = 0usize;
    loop {
        // There is at most one line per byte, so this cannot overflow.
        line += 1;
        let bad = |reason: String| HeaderFault { line, reason };
        let rest = bytes.get(at..).unwrap_or_default();
        let Some(len) = rest.iter().position(|b| *b == b'\n' || *b == b'\r') else {
            return Err(bad("the file ends before the line end_header".to_owned()));
        };
        // A line ends with \n, \r\n, or \r in files from old machines.
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
                let count = count.parse().map_err(|_| {
                    bad(format!(
                        "the count \"{}\" is not a whole number",
                        short(count)
                    ))
                })?;
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
                let element = elements.last_mut().ok_or_else(|| {
                    bad("a property line precedes the first element line".to_owned())
                })?;
                let kind_of = |word: &str| {
                    NumberKind::from_word(word)
                        .ok_or_else(|| bad(format!("the type {} is unknown", short(word))))
                };
                element.properties.push(match words {
                    ["list", len, kind, name] => {
                        let len = kind_of(len)?;
                        if len.is_float() {
                            return Err(bad(
                                "the type of a list's length must be an integer type".to_owned()
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
                            "a property line must be `TYPE NAME` or `list TYPE TYPE NAME`"
                                .to_owned(),
                        ));
                    }
                });
            }
            ["end_header"] => {
                let format = format.ok_or_else(|| bad("the format line is missing".to_owned()))?;
                return Ok(Header {
                    format,
                    elements,
                    body: at,
                    lines: line,
                });
            }
            _ => {
                return Err(bad(format!(
                    "\"{}\" is not a valid PLY header line",
                    short(&text)
                )));
            }
        }
    }
}

/// Returns the first 64 characters of `word`. The program only compares and prints names, and no known name
/// is longer.
fn short(word: &str) -> String {
    word.chars().take(64).collect()
}
