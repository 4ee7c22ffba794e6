//! Detection of the format of a scene file from its first bytes. The format must agree with the extension.
//!
//! A file whose content does not agree with its extension is rejected, because reading it as another format
//! would hide a mistake of the user.

use std::path::Path;

use super::limits::LoadLimits;
use super::marks::Marks;
use crate::{Scene, SceneError};

/// A scene file in memory.
pub(super) struct SceneFile<'a> {
    /// The name of the file in errors. Its extension is compared with the content.
    pub(super) name: &'a str,
    pub(super) bytes: &'a [u8],
    /// The folder of the further files to which the scene file refers. Without a folder, the loaders cannot
    /// read further files.
    pub(super) base_dir: Option<&'a Path>,
    pub(super) limits: &'a LoadLimits,
}

/// A format of scene files.
pub(super) struct SceneFormat {
    /// The name of the format.
    pub(super) name: &'static str,
    /// The extension of files in the format, in lower case, with the dot.
    pub(super) extension: &'static str,
    /// The description in a message of content in the format.
    pub(super) content: &'static str,
    /// Returns true if bytes begin like a file in the format. Formats without a signature use a heuristic.
    pub(super) has_signature: fn(&[u8]) -> bool,
    /// True if a file with the format's extension may be any text. The reader then reports the faults.
    pub(super) accepts_text: bool,
    /// Reads a scene file in the format.
    pub(super) read: fn(&SceneFile<'_>, &mut Marks) -> Result<Scene, SceneError>,
}

impl SceneFormat {
    /// Returns the format whose extension the file name `name` has, or `None` if there is no such format.
    fn from_extension(formats: &'static [Self], name: &str) -> Option<&'static Self> {
        let extension = Path::new(name).extension()?.to_str()?.to_ascii_lowercase();
        formats
            .iter()
            .find(|format| format.extension[1..] == extension)
    }
}

/// The first bytes of files that users mistake for scenes, and the description of each in a message.
const OTHERS: &[(&[u8], &str)] = &[
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "gzip-compressed data"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed data"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"Kaydara FBX Binary", "an FBX file"),
    (b"BLENDER", "a Blender file"),
    (b"solid ", "an STL file"),
    (
        b"<",
        "XML or HTML (perhaps COLLADA, or a web page saved by mistake)",
    ),
    (b"SLSCENE", "a canonical scene of this program"),
    (
        b"version https://git-lfs",
        "a Git LFS pointer (the real file was not fetched)",
    ),
    (b"PVS", "a visibility result"),
];

/// The maximum number of bytes at the start of a text that the detection examines.
const HEAD: usize = 1 << 16;

/// Returns the start of a text, without a byte order mark, or `None` if the start contains a zero byte.
pub(super) fn text_head(bytes: &[u8]) -> Option<&[u8]> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let head = &text[..text.len().min(HEAD)];
    (!head.contains(&0)).then_some(head)
}

/// The content of a file without a format.
enum Unknown {
    /// A text.
    Text,
    /// Content of this description.
    Other(&'static str),
}

impl Unknown {
    /// Returns the description of the content in a message.
    fn describe(&self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Other(content) => content,
        }
    }
}

/// Determines the format of a file from its content, which must agree with a known extension.
///
/// # Errors
/// [`SceneError::Bad`] if the content has no format, or the format of another extension.
pub(super) fn find_format(
    formats: &'static [SceneFormat],
    file: &SceneFile<'_>,
) -> Result<&'static SceneFormat, SceneError> {
    let bad = |reason: String, remedy: String| {
        Err(SceneError::bad(file.name, "whole file", reason, remedy))
    };
    if file.bytes.is_empty() {
        return bad(
            "the file is empty".into(),
            "export or copy the file again".into(),
        );
    }
    let names: Vec<&str> = formats.iter().rev().map(|format| format.name).collect();
    let (last, others) = names.split_last().unwrap_or((&"", &[]));
    let export = format!("export the scene as {} or {last}", others.join(", "));
    let named = SceneFormat::from_extension(formats, file.name);
    match (named, by_content(formats, file.bytes)) {
        (None, Ok(format)) => Ok(format),
        (Some(named), Ok(format)) if std::ptr::eq(named, format) => Ok(format),
        (Some(named), Err(Unknown::Text)) if named.accepts_text => Ok(named),
        (Some(named), Ok(format)) => bad(
            format!(
                "the file name indicates {}, but the content looks like {}",
                named.extension, format.content
            ),
            format!(
                "rename the file to {}, or export the scene again as {}",
                format.extension, named.extension
            ),
        ),
        (Some(named), Err(looks)) => bad(
            format!(
                "the file name indicates {}, but the content looks like {}",
                named.extension,
                looks.describe()
            ),
            export,
        ),
        (None, Err(looks)) => bad(
            format!(
                "the content looks like {}, not like a scene",
                looks.describe()
            ),
            export,
        ),
    }
}

/// Returns the format whose signature the content has. Formats that accept any text are compared last.
fn by_content(
    formats: &'static [SceneFormat],
    bytes: &[u8],
) -> Result<&'static SceneFormat, Unknown> {
    let shown = |accepts_text: bool| {
        formats.iter().find(move |format| {
            format.accepts_text == accepts_text && (format.has_signature)(bytes)
        })
    };
    if let Some(format) = shown(false) {
        return Ok(format);
    }
    if let Some((_, content)) = OTHERS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return Err(Unknown::Other(content));
    }
    shown(true).ok_or(match text_head(bytes) {
        Some(_) => Unknown::Text,
        None => Unknown::Other("unknown binary data"),
    })
}
