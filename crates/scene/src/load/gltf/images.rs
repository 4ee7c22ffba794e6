//! Textures, images and samplers of a glTF file, and the bytes of images: in a buffer view, a data URI or a
//! separate file. Images are read only if a mask needs them.

use std::borrow::Cow;

use serde::Deserialize;
use serde_json::Value;

use super::buffers::{self, Buffers};
use super::json;
use super::source::GltfContext;
use super::texels::MOST_TEXELS;
use crate::SceneError;
use crate::masks::WrapMode;

/// Maximum size of an image file in bytes: eight per texel.
const MOST_BYTES: u64 = 8 * MOST_TEXELS;

/// The arrays of a glTF document that describe textures. Indices are unchecked values from the file.
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

/// The image of a texture, and the wrap modes of the texture.
pub(super) struct Image<'a> {
    number: usize,
    field: &'a ImageField,
    pub(super) wrap: [WrapMode; 2],
}

impl Document {
    /// Reads the textures of a document.
    pub(super) fn read(source: &GltfContext<'_>, json: &[u8]) -> Result<Self, SceneError> {
        serde_json::from_slice(json).map_err(|e| source.bad("glTF JSON, textures", e.to_string()))
    }

    /// Returns the indices of the buffer views that contain images of `textures`. Skips textures whose image
    /// is not in a buffer view.
    pub(super) fn views(&self, textures: impl Iterator<Item = usize>) -> Vec<usize> {
        textures
            .filter_map(|t| self.image(t).ok()?.field.buffer_view)
            .collect()
    }

    /// Returns the image of the texture with index `texture`. The error describes the fault of the texture.
    pub(super) fn image(&self, texture: usize) -> Result<Image<'_>, String> {
        let count = self.textures.len();
        let texture_entry = self.textures.get(texture).ok_or(format!(
            "the texture does not exist, because the file has {count} textures"
        ))?;
        let number = texture_entry.source.ok_or_else(|| {
            // Images of other formats are in an extension. Many files also contain a PNG or JPEG.
            let extensions = texture_entry.extensions.as_ref().and_then(Value::as_object);
            let names: Vec<String> = extensions
                .into_iter()
                .flat_map(|e| e.keys())
                .cloned()
                .collect();
            match names.is_empty() {
                true => "the texture refers to no image".to_owned(),
                false => {
                    let shown: String = names.join(", ").chars().take(80).collect();
                    format!("the texture has only an image for {shown}; supported formats are PNG and JPEG")
                }
            }
        })?;
        let count = self.images.len();
        let field = self.images.get(number).ok_or(format!(
            "the texture refers to image {number}, but the file has {count} images"
        ))?;
        let sampler = match texture_entry.sampler {
            None => None,
            Some(s) => Some(self.samplers.get(s).ok_or(format!(
                "the texture refers to sampler {s}, but the file has {} samplers",
                self.samplers.len()
            ))?),
        };
        let wrap = |mode: Option<u32>| match mode {
            None | Some(10497) => Ok(WrapMode::Repeat),
            Some(33648) => Ok(WrapMode::Mirror),
            Some(33071) => Ok(WrapMode::Clamp),
            Some(other) => Err(format!("the sampler has the unknown wrap mode {other}")),
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
    /// Returns the image's index with the URI or the name of the image, for errors.
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

    /// Returns the bytes of the image file. `element` is the name of the image in errors.
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
            _ => Err(source.bad(element, "the image must have either a uri or a buffer view")),
        }
    }
}
