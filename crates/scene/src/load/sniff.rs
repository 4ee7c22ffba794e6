//! The kind of a scene file, from its first bytes; it must agree with the extension.
//!
//! A file whose content does not agree with its extension is refused, since reading it as another kind would
//! hide a mistake of the user.

use std::path::Path;

use crate::SceneError;

/// A kind of scene file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY, ascii or binary.
    Ply,
    /// glTF 2.0 as JSON.
    Gltf,
    /// glTF 2.0 in its binary container.
    Glb,
}

impl Kind {
    /// The kind of an extension, if it is known.
    fn from_extension(name: &str) -> Option<Self> {
        let ext = Path::new(name).extension()?.to_str()?.to_ascii_lowercase();
        match ext.as_str() {
            "obj" => Some(Self::Obj),
            "ply" => Some(Self::Ply),
            "gltf" => Some(Self::Gltf),
            "glb" => Some(Self::Glb),
            _ => None,
        }
    }

    /// Its usual extension.
    fn extension(self) -> &'static str {
        match self {
            Self::Obj => ".obj",
            Self::Ply => ".ply",
            Self::Gltf => ".gltf",
            Self::Glb => ".glb",
        }
    }

    /// Its name in a message.
    fn describe(self) -> &'static str {
        match self {
            Self::Obj => "Wavefront OBJ text",
            Self::Ply => "a PLY file",
            Self::Gltf => "JSON (glTF)",
            Self::Glb => "a binary glTF (GLB)",
        }
    }
}

/// First bytes of files that users mistake for scenes.
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
    (b"SLSCENE1", "a canonical scene of this program"),
    (
        b"version https://git-lfs",
        "a Git LFS pointer (the real file was not fetched)",
    ),
    (b"PVS", "a visibility result"),
];

/// OBJ statements that open a line; a text with one of these near its start is taken for OBJ.
const OBJ_WORDS: &[&[u8]] = &[
    b"v", b"vt", b"vn", b"vp", b"f", b"o", b"g", b"s", b"l", b"p", b"mtllib", b"usemtl",
];

/// How many bytes of a text are looked at for an OBJ statement.
const LOOK: usize = 1 << 16;

/// The kind of `bytes`, which must agree with the extension of `name` where that is a known one.
pub(super) fn kind_of(name: &str, bytes: &[u8]) -> Result<Kind, SceneError> {
    if bytes.is_empty() {
        return Err(SceneError::bad(
            name,
            "whole file",
            "it is empty",
            "export or copy it again",
        ));
    }
    let named = Kind::from_extension(name);
    match (named, by_content(bytes)) {
        (None, Ok(kind)) => Ok(kind),
        (Some(n), Ok(kind)) if n == kind => Ok(kind),
        // A text without OBJ statements near its start, but named .obj: the parser reports what is missing.
        (Some(Kind::Obj), Err("text")) => Ok(Kind::Obj),
        (Some(n), Ok(kind)) => Err(SceneError::bad(
            name,
            "whole file",
            format!(
                "its name says {} but it looks like {}",
                n.extension(),
                kind.describe()
            ),
            format!(
                "rename it to {}, or export it again as {}",
                kind.extension(),
                n.extension()
            ),
        )),
        (Some(n), Err(looks)) => Err(SceneError::bad(
            name,
            "whole file",
            format!("its name says {} but it looks like {looks}", n.extension()),
            "export the scene as OBJ, PLY, glTF or GLB",
        )),
        (None, Err(looks)) => Err(SceneError::bad(
            name,
            "whole file",
            format!("it looks like {looks}, not like a scene"),
            "export the scene as OBJ, PLY, glTF or GLB",
        )),
    }
}

/// The kind the content shows, or a description of what else it looks like.
fn by_content(bytes: &[u8]) -> Result<Kind, &'static str> {
    if bytes.starts_with(b"glTF") {
        return Ok(Kind::Glb);
    }
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") || bytes == b"ply" {
        return Ok(Kind::Ply);
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if text.trim_ascii_start().starts_with(b"{") {
        return Ok(Kind::Gltf);
    }
    if let Some((_, what)) = OTHERS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return Err(what);
    }
    let head = &text[..text.len().min(LOOK)];
    if head.contains(&0) {
        return Err("unknown binary data");
    }
    let is_obj = |line: &[u8]| {
        let word = line.split(u8::is_ascii_whitespace).find(|w| !w.is_empty());
        word.is_some_and(|w| OBJ_WORDS.contains(&w))
    };
    if head.split(|b| *b == b'\n' || *b == b'\r').any(is_obj) {
        Ok(Kind::Obj)
    } else {
        Err("text")
    }
}
