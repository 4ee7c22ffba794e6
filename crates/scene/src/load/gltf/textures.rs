//! The masks of primitives whose textures are read, each texture once.
//!
//! Where the alpha is the same everywhere and blocks, no mask is needed: the triangles are opaque. Where
//! it depends on more than the texture (vertex colours) or the texture cannot be placed (no texture
//! coordinates), they are see-through as a whole, with a warning: that hides nothing.

use std::collections::BTreeMap;

use super::accessor::Accessors;
use super::alpha::{Alpha, MASK};
use super::buffers::Buffers;
use super::images::Document;
use super::json;
use super::nodes::Draw;
use super::source::GltfContext;
use super::texels::{self, MOST_TEXELS};
use super::uses::Role;
use crate::SceneError;
use crate::kinds::Kind;
use crate::load::marks::{Mark, Marks};
use crate::masks::{Mask, Wrap};

/// The reason of triangles that no texel lets a line through.
const CLOSED: &str = "alphaMode MASK, opaque everywhere";
/// Most texels of all masks of a scene; half a gigabyte.
const MOST_TEXELS_IN_ALL: u64 = 1 << 32;
/// Remedy for textures that cannot be used.
const REMEDY: &str = "repair or replace the texture (PNG or JPEG), or leave out --alpha-textures: masked \
                      geometry is then see-through as a whole";

/// What the alpha of a primitive makes of its triangles.
pub(super) enum Resolved {
    /// One kind for all points of them.
    Whole(Mark),
    /// The mask of this number decides.
    Mask(u32),
}

/// The masks that are read so far.
pub(super) struct Textures<'a> {
    source: &'a GltfContext<'a>,
    root: &'a json::Root,
    buffers: &'a Buffers<'a>,
    document: &'a Document,
    masks: Vec<Mask>,
    /// By texture, factor and cutoff; none where all texels block.
    known: BTreeMap<(Option<usize>, u64, u64), Option<u32>>,
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

    /// What `alpha`, that of material `material`, makes of the triangles of primitive `p`.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when the texture cannot be used.
    pub(super) fn resolve(
        &mut self,
        accessors: &Accessors<'_>,
        draw: &Draw,
        p: usize,
        (material, alpha): (&str, &Result<Alpha, String>),
        marks: &mut Marks,
    ) -> Result<Resolved, SceneError> {
        marks.met_alpha();
        let bad =
            |element: &str, why: String| SceneError::bad(self.source.file, element, why, REMEDY);
        let alpha = alpha.as_ref().map_err(|why| bad(material, why.clone()))?;
        let attributes = &self.root.meshes[draw.mesh].primitives[p].attributes;
        let mut whole = |why: String| {
            marks.warn(format!(
                "mesh {}, primitive {p}: {why}, so it is see-through as a whole",
                draw.mesh
            ));
            Ok(Resolved::Whole(Mark::of(Kind::SeeThrough, MASK)))
        };
        // Colours of three components have no accessor in this role, and no alpha.
        let colors = attributes.color_0.map(|c| accessors.get(Role::Colors, c));
        if colors.is_some_and(|c| (0..c.count()).any(|i| c.alpha(i) < 1.0)) {
            return whole("its vertex colours (COLOR_0) have alpha below 1".to_owned());
        }
        if alpha.texture.is_some() && attributes.coordinates(alpha.set).is_none() {
            return whole(format!(
                "it has no texture coordinates TEXCOORD_{}",
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
            Some(number) => Resolved::Mask(number),
            None => Resolved::Whole(Mark::of(Kind::Opaque, CLOSED)),
        })
    }

    /// Decodes the mask of a material; an error names the element and the reason.
    fn mask(&self, alpha: &Alpha) -> Result<Mask, (String, String)> {
        let Some(texture) = alpha.texture else {
            let mut mask = Mask::open([1, 1], [Wrap::Clamp; 2]);
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

    /// All masks, by number.
    pub(super) fn into_masks(self) -> Vec<Mask> {
        self.masks
    }
}
