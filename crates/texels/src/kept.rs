//! Texture coordinates that the file has: whether `TEXCOORD_1` can be used, and how its parts share an image.

use sightline_scene::Scene;

use crate::TexelsError;
use crate::accessor::{Elements, FLOAT};
use crate::atlas::{Atlas, Layout, in_texels};
use crate::error::MOST_SIDE;
use crate::file::{File, member};
use crate::overlap::{Flat, SLACK, overlap};
use crate::pack::pack;
use crate::parts::{Part, Parts, primitive_of};
use crate::settings::Size;
use crate::welds::cross;

/// Largest part of a primitive's surface that may have no area in the image.
const WITHOUT_AREA: f64 = 0.01;

/// Why `TEXCOORD_1` cannot be used: the element at fault, and the fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Unusable {
    /// The primitive, and triangles of it.
    pub element: String,
    /// The fault.
    pub reason: String,
}

/// What `TEXCOORD_1` of all parts says, if it can be used.
pub(crate) struct KeptCoordinates {
    /// The corners of each triangle of the scene, from 0 to 1.
    triangles: Vec<Flat>,
    /// Whether parts lie upon each other, so that each needs a place of its own.
    apart: bool,
}

/// Twice the area of a triangle.
pub(crate) fn area(t: &Flat) -> f64 {
    (t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[1][1] - t[0][1]) * (t[2][0] - t[0][0])
}

impl KeptCoordinates {
    /// `TEXCOORD_1` of all parts, or why it cannot be used.
    pub(crate) fn read(
        file: &File,
        scene: &Scene,
        parts: &Parts,
    ) -> Result<Result<Self, Unusable>, TexelsError> {
        let mut triangles: Vec<Flat> = vec![Flat::default(); scene.len() as usize];
        let mut part_of = vec![0u32; scene.len() as usize];
        for (number, part) in (0u32..).zip(&parts.all) {
            let label = label(parts, part);
            let unusable = |element: String, reason: &str| {
                Ok(Err(Unusable {
                    element,
                    reason: reason.to_owned(),
                }))
            };
            let Some(own) = coordinates(file, parts, part)? else {
                return unusable(label, "it has no TEXCOORD_1");
            };
            let (mut without, mut all) = (0.0, 0.0);
            for (k, t) in own.iter().enumerate() {
                if !t
                    .iter()
                    .flatten()
                    .all(|c| (-SLACK..=1.0 + SLACK).contains(c))
                {
                    let element = format!("{label}, triangle {k}");
                    return unusable(element, "its TEXCOORD_1 is not within 0 and 1");
                }
                let surface = cross(&scene.triangles()[part.first as usize + k]).length();
                all += surface;
                without += if area(t) == 0.0 { surface } else { 0.0 };
            }
            if without > all * WITHOUT_AREA {
                return unusable(label, "TEXCOORD_1 gives a part of its surface no area");
            }
            let counts = |_: usize, _: usize| true;
            if let Some((a, b)) = overlap(&own, &counts) {
                return unusable(
                    format!("{label}, triangles {a} and {b}"),
                    "they overlap in TEXCOORD_1",
                );
            }
            let range = part.first as usize..part.first as usize + own.len();
            triangles[range.clone()].copy_from_slice(&own);
            part_of[range].fill(number);
        }
        let apart = overlap(&triangles, &|a, b| part_of[a] != part_of[b]).is_some();
        Ok(Ok(Self { triangles, apart }))
    }

    /// The image of these coordinates.
    pub(crate) fn atlas(
        self,
        file: &File,
        scene: &Scene,
        parts: &Parts,
        size: Size,
    ) -> Result<Atlas, TexelsError> {
        let layouts = vec![Layout::Kept; parts.all.len()];
        let mut atlas = Atlas {
            size: [1, 1],
            triangles: self.triangles,
            layouts,
            charts: 0,
            gap: 0,
        };
        // Units of the scene for one side of the image, from the areas of both.
        let units = |range: std::ops::Range<usize>| {
            let flat: f64 = atlas.triangles[range.clone()]
                .iter()
                .map(|t| area(t).abs())
                .sum();
            let surface: f64 = scene.triangles()[range]
                .iter()
                .map(|t| cross(t).length())
                .sum();
            if flat > 0.0 && surface > 0.0 {
                (surface / flat).sqrt()
            } else {
                0.0
            }
        };
        if !self.apart {
            let side = match size {
                Size::Resolution(side) => f64::from(side),
                Size::Texel(texel) => (units(0..scene.len() as usize) / texel).ceil().max(1.0),
            };
            if side > f64::from(MOST_SIDE) {
                return Err(TexelsError::TooManyTexels {
                    file: file.name.clone(),
                    texels: side * side,
                });
            }
            atlas.size = [side as u32; 2];
            for corner in atlas.triangles.iter_mut().flatten() {
                *corner = in_texels(corner.map(|c| c.clamp(0.0, 1.0) as f32), atlas.size);
            }
            return Ok(atlas);
        }
        let side = |p: &Part| units(p.first as usize..p.first as usize + p.corners.len());
        let sides: Vec<f64> = parts.all.iter().map(side).collect();
        let squares: Vec<[f64; 2]> = sides.iter().map(|s| [*s; 2]).collect();
        let packed = pack(&file.name, &squares, size)?;
        (atlas.size, atlas.gap) = (packed.size, packed.gap);
        for (i, part) in parts.all.iter().enumerate() {
            let scale = packed
                .size
                .map(|n| sides[i] * packed.per_unit / f64::from(n));
            let offset = [0, 1].map(|k| f64::from(packed.at[i][k]) / f64::from(packed.size[k]));
            atlas.layouts[i] = Layout::Moved { scale, offset };
            let own = &mut atlas.triangles[part.first as usize..][..part.corners.len()];
            for corner in own.iter_mut().flatten() {
                *corner = in_texels(Layout::moved(scale, offset, *corner), packed.size);
            }
        }
        Ok(atlas)
    }
}

/// A primitive in messages.
pub(crate) fn label(parts: &Parts, part: &Part) -> String {
    let draw = parts.draws[part.draw];
    format!(
        "mesh {}, primitive {} (at node {})",
        draw.mesh, part.primitive, draw.node
    )
}

/// `TEXCOORD_1` of a part's triangles; none if it has none.
fn coordinates(file: &File, parts: &Parts, part: &Part) -> Result<Option<Vec<Flat>>, TexelsError> {
    let primitive = primitive_of(file, parts.draws[part.draw].mesh, part.primitive);
    let accessor = primitive
        .and_then(|p| p.get("attributes"))
        .and_then(|a| member(a, "TEXCOORD_1"));
    let Some(accessor) = accessor else {
        return Ok(None);
    };
    let elements = Elements::read(file, accessor)?;
    if elements.components != 2 || !(elements.normalized || elements.component == FLOAT) {
        return Err(file.broken(
            format!("accessor {accessor}"),
            "its elements are no texture coordinates",
        ));
    }
    if elements.count < part.vertices as usize {
        return Err(file.broken(
            format!("accessor {accessor}"),
            "it has fewer elements than there are vertices",
        ));
    }
    let corner = |v: u32| [0, 1].map(|c| elements.number(v as usize, c));
    Ok(Some(part.corners.iter().map(|t| t.map(corner)).collect()))
}
