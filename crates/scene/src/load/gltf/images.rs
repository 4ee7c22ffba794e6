//! Textures, images and samplers of a glTF file, and the bytes of images: in a buffer view, a data URI or a
//! file beside the scene. They are read only when a mask needs them.

use std::borrow::Cow;

use serde::Deserialize;
use serde_json::Value;

use super::buffers::{self, Buffers};
use super::json;
use super::source::GltfContext;
use super::texels::MOST_TEXELS;
use crate::SceneError;
use crate::masks::Wrap;

/// Most bytes of an image file: eight a texel.
const MOST_BYTES: u64 = 8 * MOST_TEXELS;

/// The part of a glTF document that says where textures are. Indices are as the file gives them.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Document {
    #[serde(default)]
    textures: Vec<Texture>,
    #[serde(default)]
    images: Vec<ImageField>,
    #[serde(default)]
    samplers: Vec<Sampler>,
}

#[derive(Debug, Deserialize)]
struct Texture {
    source: Option<usize>,
    sampler: Option<usize>,
    extensions: Option<Value>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct ImageField {
    uri: Option<String>,
    buffer_view: Option<usize>,
    name: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Sampler {
    wrap_s: Option<u32>,
    wrap_t: Option<u32>,
}

/// The image of a texture, and how the texture wraps.
pub(super) struct Image<'a> {
    number: usize,
    field: &'a ImageField,
    pub(super) wrap: [Wrap; 2],
}

impl Document {
    /// The textures of a document.
    pub(super) fn read(source: &GltfContext<'_>, json: &[u8]) -> Result<Self, SceneError> {
        serde_json::from_slice(json).map_err(|e| source.bad("glTF JSON, textures", e.to_string()))
    }

    /// The buffer views of the images of these textures, as far as there are such images.
    pub(super) fn views(&self, textures: impl Iterator<Item = usize>) -> Vec<usize> {
        textures
            .filter_map(|t| self.image(t).ok()?.field.buffer_view)
            .collect()
    }

    /// The image of a texture; the fault in words when it has none that is there.
    pub(super) fn image(&self, texture: usize) -> Result<Image<'_>, String> {
        let count = self.textures.len();
        let texture_entry = self
            .textures
            .get(texture)
            .ok_or(format!("there are {count} textures"))?;
        let number = texture_entry.source.ok_or_else(|| {
            // Images of other formats are in an extension. Many files have a PNG or JPEG beside them.
            let extensions = texture_entry.extensions.as_ref().and_then(Value::as_object);
            let names: Vec<String> = extensions
                .into_iter()
                .flat_map(|e| e.keys())
                .cloned()
                .collect();
            match names.is_empty() {
                true => "it names no image".to_owned(),
                false => {
                    let shown: String = names.join(", ").chars().take(80).collect();
                    format!("it has an image for {shown} alone, and PNG and JPEG are read")
                }
            }
        })?;
        let count = self.images.len();
        let field = self
            .images
            .get(number)
            .ok_or(format!("it names image {number} of {count}"))?;
        let sampler = match texture_entry.sampler {
            None => None,
            Some(s) => Some(
                self.samplers
                    .get(s)
                    .ok_or(format!("it names sampler {s} of {}", self.samplers.len()))?,
            ),
        };
        let wrap = |mode: Option<u32>| match mode {
            None | Some(10497) => Ok(Wrap::Repeat),
            Some(33648) => Ok(Wrap::Mirror),
            Some(33071) => Ok(Wrap::Clamp),
            Some(other) => Err(format!("its sampler has the unknown wrap mode {other}")),
        };
        let wrap = [
            wrap(sampler.and_then(|s| s.wrap_s))?,
            wrap(sampler.and_then(|s| s.wrap_t))?,
        ];
        Ok(Image {
            number,
            field,
            wrap,
        })
    }
}

impl<'a> Image<'a> {
    /// Its number and name, or the name of its file.
    pub(super) fn label(&self) -> String {
        let uri = self
            .field
            .uri
            .as_deref()
            .filter(|uri| !uri.starts_with("data:"));
        match uri.or(self.field.name.as_deref()) {
            Some(name) => format!(
                "image {} ({})",
                self.number,
                name.chars().take(80).collect::<String>()
            ),
            None => format!("image {}", self.number),
        }
    }

    /// The bytes of the image file.
    pub(super) fn bytes(
        &self,
        source: &GltfContext<'_>,
        root: &json::Root,
        buffers: &'a Buffers<'_>,
        element: &str,
    ) -> Result<Cow<'a, [u8]>, SceneError> {
        match (&self.field.uri, self.field.buffer_view) {
            (None, Some(view)) => Ok(Cow::Borrowed(buffers.view(source, root, view)?)),
            (Some(uri), None) => Ok(Cow::Owned(match uri.strip_prefix("data:") {
                Some(data) => buffers::decode_data(data).map_err(|why| source.bad(element, why))?,
                None => buffers::beside(source, element, uri, MOST_BYTES)?,
            })),
            _ => Err(source.bad(element, "it must have either a uri or a buffer view")),
        }
    }
}
