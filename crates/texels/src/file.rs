//! A glTF file as its JSON and the bytes of its buffers, and its conversion to a GLB that contains
//! everything.
//!
//! The JSON is stored completely and in its order, so members that this crate does not interpret stay
//! unchanged.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};
use sightline_formats::glb;
use sightline_scene::load::uri_bytes;

use crate::TexelsError;

/// The extensions that compress buffer views.
const COMPRESSED_VIEWS: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
/// The alignment of a buffer view's start, in bytes. The largest component of an accessor has four bytes, and
/// some extensions require eight.
const ALIGNMENT: usize = 8;

/// A glTF file: its document and its buffers.
#[derive(Clone, Debug)]
pub(crate) struct GltfParts {
    /// The name of the file as the user gave it.
    pub name: String,
    /// The members of the document.
    pub root: Map<String, Value>,
    /// The bytes of the buffers.
    pub buffers: Vec<Vec<u8>>,
    /// The chunks of a GLB other than its JSON and binary chunk, each as its type and data.
    others: Vec<([u8; 4], Vec<u8>)>,
    /// The folder that relative paths of the document start from, if the file has a folder.
    base: Option<PathBuf>,
}

impl GltfParts {
    /// Reads a glTF or GLB file, and the buffer files that it references. `base` is the folder of the file.
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

    /// Creates the error that an element of this file violates the glTF specification.
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

    /// Returns the elements of an array of the document, or an empty slice if the array does not exist.
    pub(crate) fn array(&self, key: &str) -> &[Value] {
        self.root
            .get(key)
            .and_then(Value::as_array)
            .map_or(&[], Vec::as_slice)
    }

    /// Returns the array of the document with the name `key`. Creates an empty array if the document does not
    /// have the array.
    pub(crate) fn array_mut(&mut self, key: &str) -> Result<&mut Vec<Value>, TexelsError> {
        let name = self.name.clone();
        let array = self.root.entry(key).or_insert_with(|| json!([]));
        array.as_array_mut().ok_or_else(|| TexelsError::Broken {
            file: name,
            element: key.to_owned(),
            reason: "this member of the document must be an array".to_owned(),
        })
    }

    /// Adds an element to an array of the document, and returns the index of the element in the array.
    pub(crate) fn push(&mut self, key: &str, value: Value) -> Result<usize, TexelsError> {
        let array = self.array_mut(key)?;
        array.push(value);
        Ok(array.len() - 1)
    }

    /// Returns the bytes of buffer view `v`.
    pub(crate) fn view(&self, v: usize) -> Result<&[u8], TexelsError> {
        let element = || format!("buffer view {v}");
        let view = self.array("bufferViews").get(v);
        let view = view.ok_or_else(|| self.broken(element(), "the file contains no such view"))?;
        let number = |key: &str| view.get(key).and_then(Value::as_u64);
        let (offset, length) = (number("byteOffset").unwrap_or(0), number("byteLength"));
        let buffer = member(view, "buffer").and_then(|b| self.buffers.get(b));
        let range = length.and_then(|l| {
            Some(usize::try_from(offset).ok()?..usize::try_from(offset.checked_add(l)?).ok()?)
        });
        let bytes = buffer.zip(range).and_then(|(b, range)| b.get(range));
        bytes.ok_or_else(|| {
            self.broken(
                element(),
                "the view has no byteLength or exceeds its buffer",
            )
        })
    }

    /// Returns the number of bytes of all buffers, which limits the element count of an accessor without a
    /// buffer view.
    pub(crate) fn size(&self) -> usize {
        self.buffers.iter().map(Vec::len).sum()
    }

    /// Adds bytes as a buffer view of the last buffer, and returns the index of the buffer view.
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

    /// Converts the file to a GLB that contains all buffers and images.
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
            // Other members of the first buffer, such as its name, stay unchanged.
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
        let length =
            length.ok_or_else(|| self.broken(element.as_str(), "the buffer has no byteLength"))?;
        let mut bytes = match buffer.get("uri").and_then(Value::as_str) {
            Some(uri) => uri_bytes(&self.name, &element, uri, self.base.as_deref(), length)?,
            None if i == 0 && binary.is_some() => binary.unwrap_or_default().to_vec(),
            None => {
                return Err(self.broken(
                    element,
                    "the buffer has no uri and is not the binary chunk of a GLB",
                ));
            }
        };
        match usize::try_from(length).ok().filter(|l| *l <= bytes.len()) {
            Some(length) => bytes.truncate(length),
            None => {
                return Err(self.broken(
                    element,
                    format!("only {} of its {length} bytes exist", bytes.len()),
                ));
            }
        }
        Ok(bytes)
    }

    /// Moves images from separate files into buffer views.
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
                &self.name,
                &element,
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

/// Returns the value of an object's member as an index, or `None` if the member is missing or not an index.
pub(crate) fn member(object: &Value, key: &str) -> Option<usize> {
    object
        .get(key)?
        .as_u64()
        .and_then(|n| usize::try_from(n).ok())
}

/// Returns the media type of an image, from the first bytes of the image or from the ending of `uri`.
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
