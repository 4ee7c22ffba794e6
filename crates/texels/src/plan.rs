//! What a file needs: the receivers, and what is done with their values.

use std::path::Path;

use sightline_scene::{Scene, Triangle};

use crate::TexelsError;
use crate::atlas::{Atlas, Layout};
use crate::error::MOST_SIDE;
use crate::file::File;
use crate::image::{Image, State};
use crate::kept::{KeptCoordinates, area};
use crate::overlap::Flat;
use crate::parts::Parts;
use crate::pieces::{Pieces, pieces};
use crate::receivers::{Receiver, Value};
use crate::seams::{Seam, close, seams};
use crate::settings::{self, Settings, Size, Target};
use crate::unwrap::unwrap;
use crate::vertices::Unknowns;
use crate::written::{with_texture, with_vertices};
use crate::{fill, fit, plain};

/// Rings of texels that are filled before seams are closed, which reach one texel far.
const FIRST_RINGS: usize = 2;
/// Rings in all. What is farther from any chart is filled more coarsely.
const RINGS: usize = 8;

/// A file, the points whose values it needs, and how values get into it.
#[derive(Debug)]
pub struct Plan<'a> {
    file: File,
    scene: &'a Scene,
    parts: Parts,
    settings: Settings,
    receivers: Vec<Receiver>,
    way: Way,
    notes: Vec<String>,
}

/// How values get into the file.
#[derive(Debug)]
enum Way {
    /// By texels: of each receiver the texel and the area.
    Texture {
        atlas: Atlas,
        texels: Vec<u32>,
        weights: Vec<f64>,
        seams: Vec<Seam>,
    },
    /// By vertices.
    Vertices(Unknowns),
}

/// A file with values.
#[derive(Clone, Debug)]
pub struct Written {
    /// The bytes of the GLB.
    pub glb: Vec<u8>,
    /// What is in it.
    pub facts: Facts,
    /// What a user should know, in sentences.
    pub notes: Vec<String>,
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// Width of the image in texels; 0 without one.
    pub width: u32,
    /// Its height.
    pub height: u32,
    /// Texels with values of their own.
    pub texels: usize,
    /// Texels that only have receivers inside of closed solids, and took values of their neighbours.
    pub inside: usize,
    /// Texels outside of all charts, which were filled.
    pub dilated: usize,
    /// UV seams that were closed.
    pub seams: usize,
    /// Primitives whose texture coordinates stayed.
    pub kept: usize,
    /// Primitives with texture coordinates of their own that were moved to a place of their own.
    pub moved: usize,
    /// Primitives with new texture coordinates.
    pub unwrapped: usize,
    /// Charts of new texture coordinates.
    pub charts: u32,
    /// Vertices with a value.
    pub vertices: usize,
    /// Materials that were added.
    pub materials: usize,
    /// Occlusion textures that were replaced.
    pub replaced: usize,
    /// Primitives whose `COLOR_0` stayed.
    pub colors_kept: usize,
}

impl<'a> Plan<'a> {
    /// The plan for a file. `name` appears in errors, `base` is the folder of the file, and `scene` what
    /// the loader of scenes made of its bytes. For a scene that is not from a glTF file a file is made,
    /// with a node and a mesh for each object.
    ///
    /// # Errors
    /// [`TexelsError`] when the file cannot take values, or the settings are out of range.
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
            (File::read(name, bytes, base)?, scene.sources().to_vec())
        };
        let parts = Parts::of(&file, scene, &sources)?;
        let mut notes = Vec::new();
        let too_many = || TexelsError::TooManyPoints {
            file: name.to_owned(),
        };
        let (receivers, way): (Vec<Receiver>, Way) = match settings.target {
            Target::Texture => {
                let atlas = atlas(&file, scene, &parts, settings, &mut notes)?;
                if (1..4).contains(&atlas.gap) {
                    notes.push(format!(
                        "only {} texels are left between charts: give a larger --resolution for more room",
                        2 * atlas.gap
                    ));
                }
                let thin = |t: &Triangle, flat: &Flat| area(flat) == 0.0 && !t.is_degenerate();
                let both = scene.triangles().iter().zip(&atlas.triangles);
                let thin = both.filter(|(t, flat)| thin(t, flat)).count();
                if thin > 0 {
                    notes.push(format!(
                        "{thin} triangles are too thin to have a place in the image"
                    ));
                }
                let Pieces {
                    receivers,
                    texels,
                    weights,
                } = pieces(scene, &parts, &atlas).ok_or_else(too_many)?;
                let seams = seams(scene, &parts, &atlas);
                (
                    receivers,
                    Way::Texture {
                        atlas,
                        texels,
                        weights,
                        seams,
                    },
                )
            }
            Target::Vertices => {
                let unknowns = Unknowns::of(&file, scene, &parts)?.ok_or_else(too_many)?;
                (unknowns.receivers(scene, &parts), Way::Vertices(unknowns))
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

    /// The points whose values are asked for.
    pub fn receivers(&self) -> &[Receiver] {
        &self.receivers
    }

    /// What a user should know of the plan, in sentences.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The width and height of the image in texels, if there will be one.
    pub fn image_size(&self) -> Option<[u32; 2]> {
        match &self.way {
            Way::Texture { atlas, .. } => Some(atlas.size),
            Way::Vertices(_) => None,
        }
    }

    /// The file with these values, one for each receiver in their order.
    ///
    /// # Errors
    /// [`TexelsError`] when values are missing or out of range, or the result is too large for a GLB.
    pub fn write(&self, values: &[Value]) -> Result<Written, TexelsError> {
        let usable = |v: &&Value| v.inside || (0.0..=1.0).contains(&v.open);
        if values.len() != self.receivers.len() || !values.iter().all(|v| usable(&v)) {
            let values = values.iter().filter(usable).count();
            return Err(TexelsError::Values {
                values,
                receivers: self.receivers.len(),
            });
        }
        let mut file = self.file.clone();
        let (mut facts, mut notes) = (Facts::default(), Vec::new());
        match &self.way {
            Way::Texture {
                atlas,
                texels,
                weights,
                seams,
            } => {
                let given = values.iter().zip(texels.iter().zip(weights));
                let given = given.map(|(v, (texel, weight))| (*texel, *weight, v.open, v.inside));
                let image = filled(Image::of(atlas.size, given), seams, &mut facts);
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
            Way::Vertices(unknowns) => {
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
                        "{} primitives have a COLOR_0, which was kept: they have _OCCLUSION alone",
                        done.colors_kept
                    ));
                }
            }
        }
        Ok(Written {
            glb: file.into_glb()?,
            facts,
            notes,
        })
    }
}

/// Refuses settings that are out of range.
fn check(settings: &Settings) -> Result<(), TexelsError> {
    match settings.size {
        _ if settings.target == Target::Vertices => Ok(()),
        Size::Texel(size) if !(size > 0.0 && size.is_finite()) => Err(TexelsError::Setting {
            option: "--texel",
            value: size.to_string(),
            rule: "it must be more than 0, in units of the scene",
        }),
        Size::Resolution(side) if !(16..=MOST_SIDE).contains(&side) => Err(TexelsError::Setting {
            option: "--resolution",
            value: side.to_string(),
            rule: "it must be from 16 to 16384 texels",
        }),
        _ => Ok(()),
    }
}

/// The image of a file, by the texture coordinates that it has or by new ones.
fn atlas(
    file: &File,
    scene: &Scene,
    parts: &Parts,
    settings: &Settings,
    notes: &mut Vec<String>,
) -> Result<Atlas, TexelsError> {
    if settings.coordinates == settings::Coordinates::Unwrap {
        return unwrap(file, scene, parts, settings.size);
    }
    match KeptCoordinates::read(file, scene, parts)? {
        Ok(coordinates) => {
            let atlas = coordinates.atlas(file, scene, parts, settings.size)?;
            let moved = atlas
                .layouts
                .iter()
                .any(|l| matches!(l, Layout::Moved { .. }));
            notes.push(if moved {
                "TEXCOORD_1 is used, moved so that parts have places of their own in one image"
                    .to_owned()
            } else {
                "TEXCOORD_1 is used as it is".to_owned()
            });
            Ok(atlas)
        }
        Err(why) if settings.coordinates == settings::Coordinates::Keep => {
            let (element, reason) = (why.element, why.reason);
            Err(TexelsError::NotUsable {
                file: file.name.clone(),
                element,
                reason,
            })
        }
        Err(why) => {
            notes.push(format!(
                "new texture coordinates are made: {}: {}",
                why.element, why.reason
            ));
            unwrap(file, scene, parts, settings.size)
        }
    }
}

/// The image without holes.
fn filled(mut image: Image, seams: &[Seam], facts: &mut Facts) -> Image {
    facts.texels = image.count(State::Own);
    facts.inside = image.count(State::Inside);
    facts.dilated = image.count(State::Empty);
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

/// Counts what became of texture coordinates.
fn count_layouts(atlas: &Atlas, facts: &mut Facts) {
    facts.charts = atlas.charts;
    for layout in &atlas.layouts {
        match layout {
            Layout::Kept => facts.kept += 1,
            Layout::Moved { .. } => facts.moved += 1,
            Layout::New { .. } => facts.unwrapped += 1,
        }
    }
}
