//! The masks of primitives whose textures are read. Each texture is read once.
//!
//! If the alpha is uniform and blocks, no mask is needed: the triangles are opaque. If the alpha also depends
//! on vertex colours, or the texture has no texture coordinates, the triangles are completely see-through,
//! with a warning. A see-through triangle does not hide other triangles.

use std::collections::BTreeMap;

use super::accessor::Accessors;
use super::alpha::{Alpha, MASK};
use super::buffers::Buffers;
use super::images::Document;
use super::json;
use super::nodes::PlacedMesh;
use super::source::GltfContext;
use super::texels::{self, MOST_TEXELS};
use super::uses::AccessorRole;
use crate::SceneError;
use crate::kinds::SurfaceKind;
use crate::load::marks::{Mark, Marks};
use crate::masks::{Mask, WrapMode};

/// The reason for the kind of triangles whose texels all block.
const CLOSED: &str = "alphaMode MASK, opaque everywhere";
/// Maximum number of texels of all masks of a scene, which have half a gigabyte.
const MOST_TEXELS_IN_ALL: u64 = 1 << 32;
/// The remedy for textures that cannot be used.
const REMEDY: &str = "repair or replace the texture (PNG or JPEG), or omit --alpha-textures: \
                      masked geometry is then see-through as a whole";

/// The effect of a primitive's alpha on its triangles.
pub(super) enum AlphaEffect {
    /// A kind that applies to all points of the triangles.
    Whole(Mark),
    /// The index of the mask that determines the points at which the triangles block.
    Mask(u32),
}

/// The masks that were read so far.
pub(super) struct Textures<'a> {
    source: &'a GltfContext<'a>,
    root: &'a json::Root,
    buffers: &'a Buffers<'a>,
    document: &'a Document,
    masks: Vec<Mask>,
    /// The indices of masks by texture index, bits of the factor and bits of the cutoff. `None` if all texels
    /// block.
    known: BTreeMap<(Option<usize>, u64, u64), Option<u32>>,
    /// The number of texels of all masks that were read.
    texels: u64,
}

impl<'a> Textures<'a> {
    pub(super) fn new(
        source: &'a GltfContext<'a>,
        root: &'a json::Root,
        buffers: &'a Buffers<'a>,
        document: &'a Document,
    ) -> Self {
        let (masks, known) = (Vec::new(), BTreeMap::new());
        Self {
            source,
            root,
            buffers,
            document,
            masks,
            known,
            texels: 0,
        }
    }

    /// Returns the effect of `alpha` on the triangles of primitive `p`, and reads the mask if necessary.
    /// `material` is the name in errors of the material with these alpha properties.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the texture cannot be used.
    pub(super) fn resolve(
        &mut self,
        accessors: &Accessors<'_>,
        draw: &PlacedMesh,
        p: usize,
        material: &str,
        alpha: &Result<Alpha, String>,
        marks: &mut Marks,
    ) -> Result<AlphaEffect, SceneError> {
        marks.met_alpha();
        let bad =
            |element: &str, why: String| SceneError::bad(self.source.file, element, why, REMEDY);
        let alpha = alpha.as_ref().map_err(|why| bad(material, why.clone()))?;
        let attributes = &self.root.meshes[draw.mesh].primitives[p].attributes;
        let mut whole = |why: String| {
            marks.warn(format!(
                "mesh {}, primitive {p}: {why}, so the primitive is see-through as a whole",
                draw.mesh
            ));
            Ok(AlphaEffect::Whole(Mark::new(SurfaceKind::SeeThrough, MASK)))
        };
        // Vertex colours of three components have no alpha, and `uses` does not list their accessor.
        let colors = attributes
            .color_0
            .map(|c| accessors.get(AccessorRole::Colors, c));
        if colors.is_some_and(|c| (0..c.count()).any(|i| c.alpha(i) < 1.0)) {
            return whole("the vertex colours (COLOR_0) have alpha below 1".to_owned());
        }
        if alpha.texture.is_some() && attributes.coordinates(alpha.set).is_none() {
            return whole(format!(
                "the primitive has no texture coordinates TEXCOORD_{}",
                alpha.set
            ));
        }
        let key = (
            alpha.texture,
            alpha.cutoff.factor.to_bits(),
            alpha.cutoff.least.to_bits(),
        );
        let known = match self.known.get(&key) {
            Some(known) => *known,
            None => {
                let mask = self.mask(alpha);
                let mask =
                    mask.map_err(|(element, why)| bad(&format!("{material}, {element}"), why))?;
                let [width, height] = mask.size();
                self.texels += u64::from(width) * u64::from(height);
                let number = (!mask.all_closed()).then(|| {
                    self.masks.push(mask);
                    self.masks.len() as u32 - 1
                });
                self.known.insert(key, number);
                number
            }
        };
        Ok(match known {
            Some(number) => AlphaEffect::Mask(number),
            None => AlphaEffect::Whole(Mark::new(SurfaceKind::Opaque, CLOSED)),
        })
    }

    /// Decodes the mask of a material. An error contains the faulty element and the reason.
    fn mask(&self, alpha: &Alpha) -> Result<Mask, (String, String)> {
        let Some(texture) = alpha.texture else {
            let mut mask = Mask::open([1, 1], [WrapMode::Clamp; 2]);
            if alpha.cutoff.closes(1.0) {
                mask.close(0);
            }
            return Ok(mask);
        };
        let image = self
            .document
            .image(texture)
            .map_err(|why| (format!("texture {texture}"), why))?;
        let element = format!("texture {texture}, {}", image.label());
        let bytes = image.bytes(self.source, self.root, self.buffers, &element);
        let bytes = bytes.map_err(|e| match e {
            SceneError::Bad { reason, .. } => (element.clone(), reason),
            other => (element.clone(), other.to_string()),
        })?;
        let most = MOST_TEXELS.min(MOST_TEXELS_IN_ALL - self.texels);
        texels::mask(&bytes, image.wrap, alpha.cutoff, most).map_err(|why| (element, why))
    }

    /// Returns all masks, by index.
    pub(super) fn into_masks(self) -> Vec<Mask> {
        self.masks
    }
}
