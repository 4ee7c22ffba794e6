//! A glTF file as its JSON and the bytes of its buffers, and the GLB that holds all of it.
//!
//! The JSON is kept as a whole, in its order, so that what this crate does not know stays as it was.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};
use sightline_formats::glb;
use sightline_scene::load::uri_bytes;

use crate::TexelsError;

/// Compressions of buffer views.
const COMPRESSED_VIEWS: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
/// Bytes that a buffer view's start is a multiple of: the largest component of an accessor has four, and some
/// extensions ask for eight.
const ALIGNMENT: usize = 8;

/// A file in its parts.
#[derive(Clone, Debug)]
pub(crate) struct File {
    /// As the user named it.
    pub name: String,
    /// The members of the document.
    pub root: Map<String, Value>,
    /// The bytes of the buffers.
    pub buffers: Vec<Vec<u8>>,
    /// Chunks of a GLB after its binary one.
    others: Vec<([u8; 4], Vec<u8>)>,
    /// Where files beside it are.
    base: Option<PathBuf>,
}

impl File {
    /// Reads a glTF or GLB file, and the buffers beside it. `base` is the folder of the file.
    pub(crate) fn read(name: &str, bytes: &[u8], base: Option<&Path>) -> Result<Self, TexelsError> {
        let broken = |element: &str, reason: String| TexelsError::Broken {
            file: name.to_owned(),
            element: element.to_owned(),
            reason,
        };
        let (mut json, mut binary, mut others) = (bytes, None, Vec::new());
        if glb::is_glb(bytes) {
            let chunks =
                glb::chunks(bytes).map_err(|fault| broken(&fault.element(), fault.to_string()))?;
            let mut chunks = chunks.into_iter();
            json = chunks.next().unwrap_or_default().1;
            for (i, (kind, data)) in chunks.enumerate() {
                match (i, kind) {
                    (0, glb::BINARY) => binary = Some(data),
                    _ => others.push((kind, data.to_vec())),
                }
            }
        }
        let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
        let root: Map<String, Value> =
            serde_json::from_slice(json).map_err(|e| broken("glTF JSON", e.to_string()))?;
        let base = base.map(Path::to_owned);
        let mut file = Self {
            name: name.to_owned(),
            root,
            buffers: Vec::new(),
            others,
            base,
        };
        file.refuse_compressed_views()?;
        file.buffers = (0..file.array("buffers").len())
            .map(|i| file.buffer(i, binary))
            .collect::<Result<_, TexelsError>>()?;
        Ok(file)
    }

    /// An error about an element of this file.
    pub(crate) fn broken(
        &self,
        element: impl Into<String>,
        reason: impl Into<String>,
    ) -> TexelsError {
        TexelsError::Broken {
            file: self.name.clone(),
            element: element.into(),
            reason: reason.into(),
        }
    }

    /// The elements of an array of the document; none where there is no such array.
    pub(crate) fn array(&self, key: &str) -> &[Value] {
        self.root
            .get(key)
            .and_then(Value::as_array)
            .map_or(&[], Vec::as_slice)
    }

    /// The array of the document with this name, which is made if there is none.
    pub(crate) fn array_mut(&mut self, key: &str) -> Result<&mut Vec<Value>, TexelsError> {
        let name = self.name.clone();
        let array = self.root.entry(key).or_insert_with(|| json!([]));
        array.as_array_mut().ok_or_else(|| TexelsError::Broken {
            file: name,
            element: key.to_owned(),
            reason: "it is no array".to_owned(),
        })
    }

    /// Adds an element to an array of the document, and returns its number.
    pub(crate) fn push(&mut self, key: &str, value: Value) -> Result<usize, TexelsError> {
        let array = self.array_mut(key)?;
        array.push(value);
        Ok(array.len() - 1)
    }

    /// The bytes of buffer view `v`.
    pub(crate) fn view(&self, v: usize) -> Result<&[u8], TexelsError> {
        let element = || format!("buffer view {v}");
        let view = self.array("bufferViews").get(v);
        let view = view.ok_or_else(|| self.broken(element(), "there is no such buffer view"))?;
        let number = |key: &str| view.get(key).and_then(Value::as_u64);
        let (offset, length) = (number("byteOffset").unwrap_or(0), number("byteLength"));
        let buffer = member(view, "buffer").and_then(|b| self.buffers.get(b));
        let range = length.and_then(|l| {
            Some(usize::try_from(offset).ok()?..usize::try_from(offset.checked_add(l)?).ok()?)
        });
        let bytes = buffer.zip(range).and_then(|(b, range)| b.get(range));
        bytes.ok_or_else(|| self.broken(element(), "it reaches beyond its buffer"))
    }

    /// Bytes of all buffers, which bound what an accessor without bytes may stand for.
    pub(crate) fn size(&self) -> usize {
        self.buffers.iter().map(Vec::len).sum()
    }

    /// Adds bytes as a buffer view of the last buffer, and returns its number.
    pub(crate) fn add_view(
        &mut self,
        bytes: &[u8],
        target: Option<u32>,
    ) -> Result<usize, TexelsError> {
        if self.buffers.is_empty() {
            self.buffers.push(Vec::new());
            self.push("buffers", json!({ "byteLength": 0 }))?;
        }
        let buffer = self.buffers.len() - 1;
        if self.size().saturating_add(bytes.len()) > u32::MAX as usize {
            return Err(TexelsError::TooLarge {
                file: self.name.clone(),
            });
        }
        let to = &mut self.buffers[buffer];
        to.resize(to.len().next_multiple_of(ALIGNMENT), 0);
        let mut view =
            json!({ "buffer": buffer, "byteOffset": to.len(), "byteLength": bytes.len() });
        to.extend_from_slice(bytes);
        if let (Some(target), Some(view)) = (target, view.as_object_mut()) {
            view.insert("target".to_owned(), json!(target));
        }
        self.push("bufferViews", view)
    }

    /// The file as a GLB with everything inside.
    pub(crate) fn into_glb(mut self) -> Result<Vec<u8>, TexelsError> {
        self.embed_images()?;
        let mut binary = Vec::new();
        let mut starts = Vec::with_capacity(self.buffers.len());
        for buffer in std::mem::take(&mut self.buffers) {
            binary.resize(binary.len().next_multiple_of(ALIGNMENT), 0);
            starts.push(binary.len() as u64);
            binary.extend(buffer);
        }
        binary.resize(binary.len().next_multiple_of(4), 0);
        if self.root.contains_key("bufferViews") {
            for view in self.array_mut("bufferViews")? {
                let start = member(view, "buffer")
                    .and_then(|b| starts.get(b))
                    .copied()
                    .unwrap_or(0);
                let offset = view.get("byteOffset").and_then(Value::as_u64).unwrap_or(0);
                if let Some(view) = view.as_object_mut() {
                    view.insert("buffer".to_owned(), json!(0));
                    view.insert("byteOffset".to_owned(), json!(offset.saturating_add(start)));
                }
            }
        }
        if !starts.is_empty() {
            // What else the first buffer has, such as its name, stays.
            let mut all = self
                .array("buffers")
                .first()
                .cloned()
                .unwrap_or_else(|| json!({}));
            if let Some(all) = all.as_object_mut() {
                all.shift_remove("uri");
                all.insert("byteLength".to_owned(), json!(binary.len()));
            }
            self.root.insert("buffers".to_owned(), json!([all]));
        }
        let text = serde_json::to_vec(&self.root)?;
        let mut chunks: Vec<glb::Chunk<'_>> = vec![(glb::JSON, &text)];
        if !starts.is_empty() {
            chunks.push((glb::BINARY, &binary));
        }
        chunks.extend(
            self.others
                .iter()
                .map(|(kind, data)| (*kind, data.as_slice())),
        );
        glb::join(&chunks).map_err(|_| TexelsError::TooLarge { file: self.name })
    }

    fn refuse_compressed_views(&self) -> Result<(), TexelsError> {
        for (i, view) in self.array("bufferViews").iter().enumerate() {
            let extensions = view.get("extensions");
            let met = |e: &&str| extensions.is_some_and(|all| all.get(*e).is_some());
            if let Some(extension) = COMPRESSED_VIEWS.into_iter().find(|e| met(e)) {
                let element = format!("buffer view {i}");
                return Err(TexelsError::Compressed {
                    file: self.name.clone(),
                    element,
                    extension,
                });
            }
        }
        Ok(())
    }

    fn buffer(&self, i: usize, binary: Option<&[u8]>) -> Result<Vec<u8>, TexelsError> {
        let element = format!("buffer {i}");
        let buffer = &self.array("buffers")[i];
        let length = buffer.get("byteLength").and_then(Value::as_u64);
        let length = length.ok_or_else(|| self.broken(element.as_str(), "it has no byteLength"))?;
        let mut bytes = match buffer.get("uri").and_then(Value::as_str) {
            Some(uri) => uri_bytes((&self.name, &element), uri, self.base.as_deref(), length)?,
            None if i == 0 && binary.is_some() => binary.unwrap_or_default().to_vec(),
            None => {
                return Err(self.broken(
                    element,
                    "it has no uri and is not the binary chunk of a GLB",
                ));
            }
        };
        match usize::try_from(length).ok().filter(|l| *l <= bytes.len()) {
            Some(length) => bytes.truncate(length),
            None => {
                return Err(self.broken(
                    element,
                    format!("{} bytes of {length} are there", bytes.len()),
                ));
            }
        }
        Ok(bytes)
    }

    /// Puts the images that are files of their own into buffer views.
    fn embed_images(&mut self) -> Result<(), TexelsError> {
        for i in 0..self.array("images").len() {
            let image = &self.array("images")[i];
            let Some(uri) = image
                .get("uri")
                .and_then(Value::as_str)
                .filter(|u| !u.starts_with("data:"))
            else {
                continue;
            };
            let element = format!("image {i}");
            let bytes = uri_bytes(
                (&self.name, &element),
                uri,
                self.base.as_deref(),
                u64::from(u32::MAX),
            )?;
            let kind = image
                .get("mimeType")
                .and_then(Value::as_str)
                .map_or_else(|| mime(uri, &bytes), str::to_owned);
            let view = self.add_view(&bytes, None)?;
            if let Some(image) = self.array_mut("images")?[i].as_object_mut() {
                image.shift_remove("uri");
                image.insert("bufferView".to_owned(), json!(view));
                image.insert("mimeType".to_owned(), json!(kind));
            }
        }
        Ok(())
    }
}

/// A member of an object that is an index.
pub(crate) fn member(of: &Value, key: &str) -> Option<usize> {
    of.get(key)?.as_u64().and_then(|n| usize::try_from(n).ok())
}

/// The media type of an image.
fn mime(uri: &str, bytes: &[u8]) -> String {
    let ending = uri
        .rsplit('.')
        .next()
        .unwrap_or_default()
        .to_ascii_lowercase();
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => "image/png",
        [0xff, 0xd8, ..] => "image/jpeg",
        [0xab, b'K', b'T', b'X', ..] => "image/ktx2",
        [b'R', b'I', b'F', b'F', ..] => "image/webp",
        [b'D', b'D', b'S', ..] => "image/vnd-ms.dds",
        _ if ending == "png" => "image/png",
        _ => "image/jpeg",
    }
    .to_owned()
}
