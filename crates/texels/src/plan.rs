//! The plan of a file: its receivers, and the conversion of their values to a texture or vertex attributes.

use std::path::Path;

use sightline_scene::{Scene, Triangle};

use crate::TexelsError;
use crate::atlas::{Atlas, AtlasLayout};
use crate::error::MOST_SIDE;
use crate::file::GltfParts;
use crate::image::{TexelImage, TexelState};
use crate::kept_coordinates::{KeptCoordinates, area};
use crate::overlap::FlatTriangle;
use crate::parts::PrimitiveInstances;
use crate::pieces::{TexelPieces, pieces};
use crate::receivers::{Receiver, ReceiverValue};
use crate::seams::{Seam, close, seams};
use crate::settings::{self, Settings, TextureSize, ValueTarget};
use crate::unwrap::unwrap;
use crate::vertices::Unknowns;
use crate::written_file::{with_texture, with_vertices};
use crate::{fill, fit, plain};

/// The number of rings of texels that are filled before UV seams are closed. Closing changes texels up to one
/// texel outside a chart.
const FIRST_RINGS: usize = 2;
/// The number of rings of texels around charts that are filled ring by ring. Texels farther from any chart
/// get values from coarse images.
const RINGS: usize = 8;

/// The plan of one file: the receivers that need a value, and the method of writing the values into the file.
#[derive(Debug)]
pub struct Plan<'a> {
    file: GltfParts,
    scene: &'a Scene,
    parts: PrimitiveInstances,
    settings: Settings,
    receivers: Vec<Receiver>,
    way: WriteMethod,
    notes: Vec<String>,
}

/// The method of writing values into the file.
#[derive(Debug)]
enum WriteMethod {
    /// A texture: the layout of the image, the texel index and area of each receiver, and the UV seams.
    Texture {
        atlas: Atlas,
        texels: Vec<u32>,
        weights: Vec<f64>,
        seams: Vec<Seam>,
    },
    /// Vertex attributes, with one unknown for each group of vertices that share a value.
    Vertices(Unknowns),
}

/// A written file with values.
#[derive(Clone, Debug)]
pub struct WrittenFile {
    /// The bytes of the GLB.
    pub glb: Vec<u8>,
    /// The counts of written elements.
    pub facts: WriteSummary,
    /// Messages for the user about the written file.
    pub notes: Vec<String>,
}

/// The counts of written elements. A primitive counts once for each node that uses its mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteSummary {
    /// The width of the image in texels, or 0 without an image.
    pub width: u32,
    /// The height of the image in texels, or 0 without an image.
    pub height: u32,
    /// The number of texels with values from their own receivers.
    pub texels: usize,
    /// The number of texels whose receivers are all inside closed solids. These texels get values of other
    /// texels.
    pub inside: usize,
    /// The number of texels outside all charts. These texels get values of other texels.
    pub dilated: usize,
    /// The number of closed UV seams: edges at which texels were changed so that both sides agree.
    pub seams: usize,
    /// The number of primitives with unchanged texture coordinates.
    pub kept: usize,
    /// The number of primitives whose existing texture coordinates were moved to a separate square of the
    /// image.
    pub moved: usize,
    /// The number of primitives with new texture coordinates.
    pub unwrapped: usize,
    /// The number of charts of new texture coordinates.
    pub charts: u32,
    /// The number of vertices with a value.
    pub vertices: usize,
    /// The number of added materials.
    pub materials: usize,
    /// The number of materials whose occlusion texture was replaced.
    pub replaced: usize,
    /// The number of primitives with an unchanged `COLOR_0`.
    pub colors_kept: usize,
}

impl<'a> Plan<'a> {
    /// Creates the plan for a file.
    ///
    /// `name` is the name of the file in errors, `bytes` is its content, `base` is its folder, and `scene` is
    /// the scene that the loader read from `bytes`. For a scene from another format than glTF, the plan
    /// creates a glTF file with a node and a mesh for each object.
    ///
    /// # Errors
    /// [`TexelsError`] if values cannot be added to the file, or the settings are out of range.
    pub fn new(
        name: &str,
        bytes: &[u8],
        base: Option<&Path>,
        scene: &'a Scene,
        settings: &Settings,
    ) -> Result<Self, TexelsError> {
        check(settings)?;
        let (file, sources) = if scene.sources().is_empty() {
            plain::file_of(name, scene)?
        } else {
            (
                GltfParts::read(name, bytes, base)?,
                scene.sources().to_vec(),
            )
        };
        let parts = PrimitiveInstances::new(&file, scene, &sources)?;
        let mut notes = Vec::new();
        let too_many = || TexelsError::TooManyPoints {
            file: name.to_owned(),
        };
        let (receivers, way): (Vec<Receiver>, WriteMethod) = match settings.target {
            ValueTarget::Texture => {
                let atlas = atlas(&file, scene, &parts, settings, &mut notes)?;
                if (1..4).contains(&atlas.gap) {
                    notes.push(format!(
                        "only {} texels separate the charts of the image; use a larger --resolution \
                         or --texel for wider gaps",
                        2 * atlas.gap
                    ));
                }
                let thin =
                    |t: &Triangle, flat: &FlatTriangle| area(flat) == 0.0 && !t.is_degenerate();
                let both = scene.triangles().iter().zip(&atlas.triangles);
                let thin = both.filter(|(t, flat)| thin(t, flat)).count();
                if thin > 0 {
                    notes.push(format!(
                        "{thin} triangles are too thin to have an area in the image"
                    ));
                }
                let TexelPieces {
                    receivers,
                    texels,
                    weights,
                } = pieces(scene, &parts, &atlas).ok_or_else(too_many)?;
                let seams = seams(scene, &parts, &atlas);
                (
                    receivers,
                    WriteMethod::Texture {
                        atlas,
                        texels,
                        weights,
                        seams,
                    },
                )
            }
            ValueTarget::Vertices => {
                let unknowns = Unknowns::from_parts(&file, scene, &parts)?.ok_or_else(too_many)?;
                (
                    unknowns.receivers(scene, &parts),
                    WriteMethod::Vertices(unknowns),
                )
            }
        };
        if receivers.is_empty() {
            return Err(TexelsError::NoTriangles {
                file: name.to_owned(),
            });
        }
        Ok(Self {
            file,
            scene,
            parts,
            settings: *settings,
            receivers,
            way,
            notes,
        })
    }

    /// Returns the receivers, for which the caller computes values.
    pub fn receivers(&self) -> &[Receiver] {
        &self.receivers
    }

    /// Returns messages for the user about the plan.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the width and height of the image in texels, or `None` for values at vertices.
    pub fn image_size(&self) -> Option<[u32; 2]> {
        match &self.way {
            WriteMethod::Texture { atlas, .. } => Some(atlas.size),
            WriteMethod::Vertices(_) => None,
        }
    }

    /// Writes the file with these values: one value for each receiver, in the order of [`Plan::receivers`].
    ///
    /// # Errors
    /// [`TexelsError`] if values are missing or out of range, or the written file is too large for a GLB.
    pub fn write(&self, values: &[ReceiverValue]) -> Result<WrittenFile, TexelsError> {
        let usable = |v: &&ReceiverValue| v.inside || (0.0..=1.0).contains(&v.open);
        if values.len() != self.receivers.len() || !values.iter().all(|v| usable(&v)) {
            let values = values.iter().filter(usable).count();
            return Err(TexelsError::Values {
                values,
                receivers: self.receivers.len(),
            });
        }
        let mut file = self.file.clone();
        let (mut facts, mut notes) = (WriteSummary::default(), Vec::new());
        match &self.way {
            WriteMethod::Texture {
                atlas,
                texels,
                weights,
                seams,
            } => {
                let given = values.iter().zip(texels.iter().zip(weights));
                let given = given.map(|(v, (texel, weight))| (*texel, *weight, v.open, v.inside));
                let image = filled(
                    TexelImage::from_samples(atlas.size, given),
                    seams,
                    &mut facts,
                );
                let png = image.png(self.settings.bits)?;
                count_layouts(atlas, &mut facts);
                let done = with_texture(&mut file, &self.parts, atlas, &png)?;
                (facts.materials, facts.replaced) = (done.added, done.replaced);
                if done.replaced > 0 {
                    notes.push(format!(
                        "{} occlusion textures of the file were replaced",
                        done.replaced
                    ));
                }
            }
            WriteMethod::Vertices(unknowns) => {
                let given: Vec<Option<f64>> = values
                    .iter()
                    .map(|v| (!v.inside).then_some(v.open))
                    .collect();
                let fitted = fit::fit(self.scene, unknowns, &given);
                let done = with_vertices(
                    &mut file,
                    &self.parts,
                    unknowns,
                    &fitted,
                    self.settings.bits,
                )?;
                (facts.vertices, facts.colors_kept) = (done.vertices, done.colors_kept);
                if done.colors_kept > 0 {
                    notes.push(format!(
                        "{} primitives already have a COLOR_0, which is unchanged: their occlusion \
                         is only in _OCCLUSION",
                        done.colors_kept
                    ));
                }
            }
        }
        Ok(WrittenFile {
            glb: file.into_glb()?,
            facts,
            notes,
        })
    }
}

/// Checks that the size of the texture is in its range.
fn check(settings: &Settings) -> Result<(), TexelsError> {
    match settings.size {
        _ if settings.target == ValueTarget::Vertices => Ok(()),
        TextureSize::Texel(size) if !(size > 0.0 && size.is_finite()) => {
            Err(TexelsError::Setting {
                option: "--texel",
                value: size.to_string(),
                rule: "the side of a texel must be more than 0, in units of the scene",
            })
        }
        TextureSize::Resolution(side) if !(16..=MOST_SIDE).contains(&side) => {
            Err(TexelsError::Setting {
                option: "--resolution",
                value: side.to_string(),
                rule: "the side of the image must be from 16 to 16384 texels",
            })
        }
        _ => Ok(()),
    }
}

/// Creates the layout of the image from the file's `TEXCOORD_1` or from new texture coordinates, and adds a
/// note for the user about the choice.
fn atlas(
    file: &GltfParts,
    scene: &Scene,
    parts: &PrimitiveInstances,
    settings: &Settings,
    notes: &mut Vec<String>,
) -> Result<Atlas, TexelsError> {
    if settings.coordinates == settings::TexCoordSource::Unwrap {
        return unwrap(file, scene, parts, settings.size);
    }
    match KeptCoordinates::read(file, scene, parts)? {
        Ok(coordinates) => {
            let atlas = coordinates.atlas(file, scene, parts, settings.size)?;
            let moved = atlas
                .layouts
                .iter()
                .any(|l| matches!(l, AtlasLayout::Moved { .. }));
            notes.push(if moved {
                "TEXCOORD_1 is used, moved so that each primitive has a separate square of the image"
                    .to_owned()
            } else {
                "TEXCOORD_1 is used unchanged".to_owned()
            });
            Ok(atlas)
        }
        Err(why) if settings.coordinates == settings::TexCoordSource::Keep => {
            let (element, reason) = (why.element, why.reason);
            Err(TexelsError::NotUsable {
                file: file.name.clone(),
                element,
                reason,
            })
        }
        Err(why) => {
            notes.push(format!(
                "new texture coordinates are computed, because TEXCOORD_1 is unusable: {}: {}",
                why.element, why.reason
            ));
            unwrap(file, scene, parts, settings.size)
        }
    }
}

/// Closes the UV seams of the image and fills its empty texels. Writes the counts of texels and seams, and
/// the size of the image, to `facts`.
fn filled(mut image: TexelImage, seams: &[Seam], facts: &mut WriteSummary) -> TexelImage {
    facts.texels = image.count(TexelState::Own);
    facts.inside = image.count(TexelState::Inside);
    facts.dilated = image.count(TexelState::Empty);
    facts.seams = seams.len();
    [facts.width, facts.height] = image.size.map(|n| n as u32);
    fill::rings(&mut image, FIRST_RINGS);
    if facts.texels > 0 {
        close(&mut image, seams);
    }
    fill::rings(&mut image, RINGS - FIRST_RINGS);
    fill::rest(&mut image);
    image
}

/// Counts the primitives in `facts` by the change of their texture coordinates.
fn count_layouts(atlas: &Atlas, facts: &mut WriteSummary) {
    facts.charts = atlas.charts;
    for layout in &atlas.layouts {
        match layout {
            AtlasLayout::Kept => facts.kept += 1,
            AtlasLayout::Moved { .. } => facts.moved += 1,
            AtlasLayout::New { .. } => facts.unwrapped += 1,
        }
    }
}
