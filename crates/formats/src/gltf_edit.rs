//! Editor that adds an extension to a glTF or GLB file. The JSON stays unchanged, character by character,
//! except for the members that name the extension and its data. So the editor preserves the data of other
//! programs.

use std::ops::Range;

use serde::de::{DeserializeOwned, IgnoredAny};
use serde_json::{Value, json};

use crate::glb::{self, BINARY, Chunk, GlbFault, JSON};

/// The reason why an extension cannot be added.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum GltfError {
    /// The file is damaged. The text names the fault.
    #[error("{0}; export the file again from the program that created it")]
    Broken(&'static str),
    /// The header or a chunk of the GLB is damaged.
    #[error("{element}: {0}; export the file again from the program that created it", element = .0.element())]
    Container(GlbFault),
    /// The file already has the extension.
    #[error("the file already has the extension {0}; name a file without this extension")]
    There(&'static str),
    /// The file would be too long for a GLB.
    #[error("with the extension, the file would be longer than 4 GiB, the limit of a GLB")]
    TooLarge,
}

/// A glTF or GLB file, split into its JSON and its other chunks.
pub struct GltfFile<'a> {
    json: &'a str,
    /// The chunks of a GLB after its JSON. `None` for a glTF file, which consists of JSON only.
    chunks: Option<Vec<Chunk<'a>>>,
}

/// The binary data of an extension, which become consecutive buffer views of the binary chunk.
#[derive(Default)]
pub struct Added {
    bytes: Vec<u8>,
    views: Vec<Range<usize>>,
}

impl Added {
    /// Appends `bytes` as a new buffer view, at an offset that is a multiple of four.
    pub fn push(&mut self, bytes: impl IntoIterator<Item = u8>) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        self.views.push(start..self.bytes.len());
    }

    /// Returns the number of bytes of all buffer views, including padding.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }
}

impl<'a> GltfFile<'a> {
    /// Splits a file into its JSON and its other chunks.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, GltfError> {
        if !glb::is_glb(bytes) {
            return Ok(Self {
                json: text(bytes)?,
                chunks: None,
            });
        }
        let mut chunks = glb::chunks(bytes).map_err(GltfError::Container)?;
        let (_, json) = chunks.remove(0);
        Ok(Self {
            json: text(json)?,
            chunks: Some(chunks),
        })
    }

    /// Returns true if the file is a GLB.
    pub fn is_glb(&self) -> bool {
        self.chunks.is_some()
    }

    /// Returns true if buffer views can be added, which requires a GLB with a buffer in its binary chunk.
    pub fn takes_views(&self) -> Result<bool, GltfError> {
        Ok(self.binary_buffer(&Members::parse(self.json)?)?.is_some())
    }

    /// Returns the URI of the first external file that a buffer or image refers to, or `None` if the file
    /// needs no external file. Data URIs and URIs with a scheme are ignored.
    pub fn needs(&self) -> Result<Option<String>, GltfError> {
        let root = Members::parse(self.json)?;
        for key in ["buffers", "images"] {
            for item in root.elements(key)? {
                let uri = Members::parse(&self.json[item])?.string("uri");
                if let Some(uri) =
                    uri.filter(|uri| !uri.starts_with("data:") && !uri.contains("://"))
                {
                    return Ok(Some(uri));
                }
            }
        }
        Ok(None)
    }

    /// Returns the bytes of the file with the extension `name` added to its root object.
    ///
    /// `extension` creates the extension's value from the index of the first added buffer view.
    pub fn with(
        &self,
        name: &'static str,
        added: &Added,
        extension: impl FnOnce(usize) -> Value,
    ) -> Result<Vec<u8>, GltfError> {
        let root = Members::parse(self.json)?;
        if let Some(of) = root.get("extensions")
            && Members::parse(&self.json[of])?.get(name).is_some()
        {
            return Err(GltfError::There(name));
        }
        root.elements("extensionsUsed")?;
        let mut edits = Edits {
            root: &root,
            all: Vec::new(),
        };
        let value = extension(root.elements("bufferViews")?.len());
        edits.append(
            "extensions",
            ['{', '}'],
            &format!("{}:{value}", json!(name)),
        );
        edits.append("extensionsUsed", ['[', ']'], &json!(name).to_string());
        let mut binary = None;
        if !added.views.is_empty() {
            let (length, start) = self.binary_buffer(&root)?.ok_or(GltfError::Broken(
                "the file has no buffer in a binary chunk",
            ))?;
            edits
                .all
                .push((length, (start + added.bytes.len()).to_string()));
            binary = Some(start);
            let view = |range: &Range<usize>| {
                let (at, size) = (start + range.start, range.len());
                json!({"buffer": 0, "byteOffset": at, "byteLength": size}).to_string()
            };
            let views: Vec<String> = added.views.iter().map(view).collect();
            edits.append("bufferViews", ['[', ']'], &views.join(","));
        }
        self.join(&edits.apply(), binary, &added.bytes)
    }

    /// Returns the byte range of the `byteLength` of buffer 0 in the JSON, and the offset in the binary chunk
    /// at which bytes can be appended.
    ///
    /// Returns `None` if buffer 0 is not in the binary chunk.
    fn binary_buffer(
        &self,
        root: &Members<'_>,
    ) -> Result<Option<(Range<usize>, usize)>, GltfError> {
        let Some([(BINARY, bytes), ..]) = self.chunks.as_deref() else {
            return Ok(None);
        };
        let Some(first) = root.elements("buffers")?.into_iter().next() else {
            return Ok(None);
        };
        let buffer = Members::parse(&self.json[first.clone()])?;
        if buffer.get("uri").is_some() {
            return Ok(None);
        }
        let length = buffer
            .get("byteLength")
            .ok_or(GltfError::Broken("buffer 0 has no byteLength"))?;
        let length = first.start + length.start..first.start + length.end;
        Ok(Some((length, bytes.len().next_multiple_of(4))))
    }

    /// Returns the bytes of the file with `json` in place of its JSON.
    ///
    /// If `binary` is an offset, the binary chunk ends at this offset and `added` follows.
    fn join(&self, json: &str, binary: Option<usize>, added: &[u8]) -> Result<Vec<u8>, GltfError> {
        let Some(chunks) = &self.chunks else {
            return Ok(json.as_bytes().to_vec());
        };
        let longer: Option<(usize, Vec<u8>)> = binary.map(|start| {
            let mut longer = chunks.first().map_or(&[][..], |chunk| chunk.1).to_vec();
            longer.resize(start, 0);
            longer.extend(added);
            (0, longer)
        });
        let mut all = vec![(JSON, json.as_bytes())];
        for (number, (kind, bytes)) in chunks.iter().enumerate() {
            let replacement = longer.as_ref().filter(|(changed, _)| *changed == number);
            all.push((*kind, replacement.map_or(*bytes, |(_, longer)| longer)));
        }
        glb::join(&all).map_err(|_| GltfError::TooLarge)
    }
}

/// Returns the JSON text in `bytes` without a byte order mark and without surrounding white space.
fn text(bytes: &[u8]) -> Result<&str, GltfError> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| GltfError::Broken("the JSON of the file is not UTF-8"))?;
    Ok(text.trim_start_matches('\u{feff}').trim())
}

/// The members of a JSON object, and the byte ranges of their values in the text.
struct Members<'a> {
    text: &'a str,
    all: Vec<(String, Range<usize>)>,
}

impl<'a> Members<'a> {
    /// Parses the text of a JSON object.
    fn parse(text: &'a str) -> Result<Self, GltfError> {
        let all = items(text, ['{', '}'], |at| {
            let (key, end) = value::<String>(text, at)?;
            let colon = blank(text, end);
            Some((key, text[colon..].starts_with(':').then_some(colon + 1)?))
        });
        Ok(Self {
            text,
            all: all.ok_or(GltfError::Broken(
                "the JSON of the file has another value in place of an object",
            ))?,
        })
    }

    fn get(&self, key: &str) -> Option<Range<usize>> {
        self.all
            .iter()
            .find(|(name, _)| name == key)
            .map(|(_, range)| range.clone())
    }

    fn string(&self, key: &str) -> Option<String> {
        serde_json::from_str(&self.text[self.get(key)?]).ok()
    }

    /// Returns the byte ranges of the elements of the array `key`, or an empty list if the object has no
    /// member `key`.
    fn elements(&self, key: &str) -> Result<Vec<Range<usize>>, GltfError> {
        let Some(of) = self.get(key) else {
            return Ok(Vec::new());
        };
        let all = items(&self.text[of.clone()], ['[', ']'], |at| Some(((), at)));
        let all = all.ok_or(GltfError::Broken(
            "the JSON of the file has another value in place of an array",
        ))?;
        Ok(all
            .into_iter()
            .map(|((), r)| of.start + r.start..of.start + r.end)
            .collect())
    }
}

/// Returns the items between two brackets, each as the result of `head` and the byte range of its value.
///
/// `head` parses the text before a value, such as a key, and returns the offset after this text. The result
/// is `None` if `text` does not have this form.
fn items<T>(
    text: &str,
    brackets: [char; 2],
    head: impl Fn(usize) -> Option<(T, usize)>,
) -> Option<Vec<(T, Range<usize>)>> {
    let mut at = blank(
        text,
        blank(text, 0)
            + text[blank(text, 0)..]
                .strip_prefix(brackets[0])
                .map(|_| 1)?,
    );
    let mut all = Vec::new();
    if text[at..].starts_with(brackets[1]) {
        return Some(all);
    }
    loop {
        let (name, start) = head(at)?;
        let start = blank(text, start);
        let (IgnoredAny, end) = value(text, start)?;
        all.push((name, start..end));
        at = blank(text, end);
        let next = text[at..].chars().next()?;
        if next == brackets[1] {
            return Some(all);
        }
        at = blank(text, at + (next == ',').then_some(1)?);
    }
}

/// Parses the JSON value at offset `at` of `text`, and returns the value with the offset of its end.
fn value<T: DeserializeOwned>(text: &str, at: usize) -> Option<(T, usize)> {
    let mut values = serde_json::Deserializer::from_str(text.get(at..)?).into_iter::<T>();
    let value = values.next()?.ok()?;
    Some((value, at + values.byte_offset()))
}

/// Returns the offset of the first character at or after `at` that is not white space.
fn blank(text: &str, at: usize) -> usize {
    text.len() - text[at..].trim_start_matches([' ', '\t', '\r', '\n']).len()
}

/// The pending replacements of byte ranges in the text of a JSON object.
struct Edits<'a> {
    root: &'a Members<'a>,
    all: Vec<(Range<usize>, String)>,
}

impl Edits<'_> {
    /// Appends `item` to the object or array of the member `key`, or adds the member with this item.
    fn append(&mut self, key: &str, [open, close]: [char; 2], item: &str) {
        let edit = match self.root.get(key) {
            Some(Range { start, end }) => {
                let empty = self.root.text[start + 1..end - 1].trim().is_empty();
                (
                    end - 1..end - 1,
                    format!("{}{item}", if empty { "" } else { "," }),
                )
            }
            // The root is never empty, because every glTF names its version.
            None => (1..1, format!("{}:{open}{item}{close},", json!(key))),
        };
        self.all.push(edit);
    }

    fn apply(mut self) -> String {
        self.all.sort_by_key(|(range, _)| range.start);
        let (mut out, mut at) = (String::new(), 0);
        for (Range { start, end }, text) in &self.all {
            out += &self.root.text[at..*start];
            out += text;
            at = *end;
        }
        out + &self.root.text[at..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(json: &str, chunks: &[([u8; 4], &[u8])]) -> Vec<u8> {
        GltfFile {
            json,
            chunks: Some(chunks.to_vec()),
        }
        .join(json, None, &[])
        .unwrap()
    }

    fn added(sizes: &[u8]) -> Added {
        let mut added = Added::default();
        sizes.iter().for_each(|size| added.push(1..=*size));
        added
    }

    fn with(file: &[u8], sizes: &[u8]) -> Result<Vec<u8>, GltfError> {
        GltfFile::parse(file)?.with("X", &added(sizes), |view| json!({"view": view}))
    }

    #[test]
    fn with_changes_only_extension_members() {
        let json = "{ \"a\" : 1.50, \"extensions\":{ \"Y\":{} } ,\"extensionsUsed\":[\"Y\"], \"b\":\"},]\" }";
        let out = String::from_utf8(with(json.as_bytes(), &[]).unwrap()).unwrap();
        let expected = "{ \"a\" : 1.50, \"extensions\":{ \"Y\":{} ,\"X\":{\"view\":0}} \
                        ,\"extensionsUsed\":[\"Y\",\"X\"], \"b\":\"},]\" }";
        assert_eq!(out, expected);
        let out = with(b"\xef\xbb\xbf{\"asset\":{},\"extensions\":{}}", &[]).unwrap();
        let expected =
            "{\"extensionsUsed\":[\"X\"],\"asset\":{},\"extensions\":{\"X\":{\"view\":0}}}";
        assert_eq!(String::from_utf8(out).unwrap(), expected);
    }

    #[test]
    fn with_appends_bytes_to_binary_chunk() {
        let json = "{\"buffers\":[ { \"byteLength\" : 5 } ],\"bufferViews\":[{}]}";
        let file = glb(json, &[(BINARY, &[9; 5]), (*b"MORE", b"more")]);
        let out = with(&file, &[3, 4]).unwrap();
        let parts = GltfFile::parse(&out).unwrap();
        let json: Value = serde_json::from_str(parts.json).unwrap();
        assert_eq!(json["buffers"], json!([{"byteLength": 16}]));
        let view =
            |at: usize, size: usize| json!({"buffer": 0, "byteOffset": at, "byteLength": size});
        assert_eq!(json["bufferViews"], json!([{}, view(8, 3), view(12, 4)]));
        assert_eq!(json["extensions"]["X"]["view"], 1);
        let chunks = parts.chunks.unwrap();
        assert_eq!(
            chunks[0].1,
            [9, 9, 9, 9, 9, 0, 0, 0, 1, 2, 3, 0, 1, 2, 3, 4]
        );
        assert_eq!((chunks[1], out.len() % 4), ((*b"MORE", &b"more"[..]), 0));
        assert_eq!(
            u32::from_le_bytes(*out[8..].first_chunk().unwrap()) as usize,
            out.len()
        );
    }

    #[test]
    fn file_without_binary_chunk_rejects_bytes() {
        let beside = glb("{\"buffers\":[{\"uri\":\"a.bin\"}]}", &[(BINARY, &[0; 4])]);
        for file in [
            b"{\"asset\":{}}".to_vec(),
            glb("{\"asset\":{}}", &[]),
            beside,
        ] {
            assert!(!GltfFile::parse(&file).unwrap().takes_views().unwrap());
            assert!(matches!(with(&file, &[3]), Err(GltfError::Broken(_))));
            assert!(with(&file, &[]).is_ok());
        }
    }

    #[test]
    fn rejects_damaged_files() {
        let broken = |bytes: &[u8]| {
            matches!(
                with(bytes, &[1]).unwrap_err(),
                GltfError::Broken(_) | GltfError::Container(_)
            )
        };
        let whole = glb("{\"asset\":{}}", &[(BINARY, &[1, 2, 3, 4])]);
        assert!((4..whole.len()).all(|end| broken(&whole[..end])));
        for text in [
            "",
            "[]",
            "{\"a\":}",
            "{\"a\" 1}",
            "{\"a\":1",
            "{\"extensions\":[]}",
            "{\"bufferViews\":3}",
        ] {
            assert!(broken(text.as_bytes()), "{text}");
        }
        let there = with(b"{\"extensions\":{\"Y\":1,\"X\":{}}}", &[]).unwrap_err();
        assert_eq!(there, GltfError::There("X"));
    }

    #[test]
    fn needs_returns_external_files() {
        let needs = |text: &str| GltfFile::parse(text.as_bytes()).unwrap().needs().unwrap();
        assert_eq!(
            needs("{\"buffers\":[{\"uri\":\"data:,\"}],\"images\":[{\"bufferView\":0}]}"),
            None
        );
        let image = "{\"images\":[{\"uri\":\"a%20b.png\"}]}";
        assert_eq!(needs(image).as_deref(), Some("a%20b.png"));
    }
}
