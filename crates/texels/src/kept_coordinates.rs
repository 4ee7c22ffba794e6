//! The existing texture coordinates of a file: checks of `TEXCOORD_1`, and the placement of the primitives in
//! one image.

use sightline_scene::Scene;

use crate::TexelsError;
use crate::accessor::{CheckedElements, FLOAT};
use crate::atlas::{Atlas, AtlasLayout, in_texels};
use crate::error::MOST_SIDE;
use crate::file::{GltfParts, member};
use crate::overlap::{FlatTriangle, SLACK, overlap};
use crate::pack::pack;
use crate::parts::{PrimitiveInstance, PrimitiveInstances, primitive_of};
use crate::settings::TextureSize;
use crate::welds::cross;

/// Maximum fraction of a primitive's surface that may have no area in `TEXCOORD_1`.
const WITHOUT_AREA: f64 = 0.01;

/// The reason why `TEXCOORD_1` cannot be used: the element at fault, and the fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Unusable {
    /// The primitive, and the indices of its triangles if triangles are at fault.
    pub element: String,
    /// The fault of the texture coordinates.
    pub reason: String,
}

/// The usable `TEXCOORD_1` coordinates of all primitives.
pub(crate) struct KeptCoordinates {
    /// The corners of each triangle of the scene, in texture coordinates from 0 to 1.
    triangles: Vec<FlatTriangle>,
    /// True if triangles of different primitives overlap, so that each primitive needs a separate square of
    /// the image.
    apart: bool,
}

/// Computes twice the signed area of a triangle in the image or in texture coordinates.
pub(crate) fn area(t: &FlatTriangle) -> f64 {
    (t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[1][1] - t[0][1]) * (t[2][0] - t[0][0])
}

impl KeptCoordinates {
    /// Reads `TEXCOORD_1` of all primitives in `parts`. The inner error is the reason why the coordinates
    /// cannot be used; the outer error is a fault of the file.
    pub(crate) fn read(
        file: &GltfParts,
        scene: &Scene,
        parts: &PrimitiveInstances,
    ) -> Result<Result<Self, Unusable>, TexelsError> {
        let mut triangles: Vec<FlatTriangle> = vec![FlatTriangle::default(); scene.len() as usize];
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
                return unusable(label, "the primitive has no TEXCOORD_1");
            };
            let (mut without, mut all) = (0.0, 0.0);
            for (k, t) in own.iter().enumerate() {
                if !t
                    .iter()
                    .flatten()
                    .all(|c| (-SLACK..=1.0 + SLACK).contains(c))
                {
                    let element = format!("{label}, triangle {k}");
                    return unusable(element, "a corner has TEXCOORD_1 outside 0 to 1");
                }
                let surface = cross(&scene.triangles()[part.first as usize + k]).length();
                all += surface;
                without += if area(t) == 0.0 { surface } else { 0.0 };
            }
            if without > all * WITHOUT_AREA {
                let reason = "more than 1 % of the surface has no area in TEXCOORD_1";
                return unusable(label, reason);
            }
            let counts = |_: usize, _: usize| true;
            if let Some((a, b)) = overlap(&own, &counts) {
                return unusable(
                    format!("{label}, triangles {a} and {b}"),
                    "the triangles overlap in TEXCOORD_1",
                );
            }
            let range = part.first as usize..part.first as usize + own.len();
            triangles[range.clone()].copy_from_slice(&own);
            part_of[range].fill(number);
        }
        let apart = overlap(&triangles, &|a, b| part_of[a] != part_of[b]).is_some();
        Ok(Ok(Self { triangles, apart }))
    }

    /// Creates the layout of the image from these coordinates. `size` determines the number of texels.
    pub(crate) fn atlas(
        self,
        file: &GltfParts,
        scene: &Scene,
        parts: &PrimitiveInstances,
        size: TextureSize,
    ) -> Result<Atlas, TexelsError> {
        let layouts = vec![AtlasLayout::Kept; parts.all.len()];
        let mut atlas = Atlas {
            size: [1, 1],
            triangles: self.triangles,
            layouts,
            charts: 0,
            gap: 0,
        };
        // The length in units of the scene that corresponds to 1 in texture coordinates, from the areas of
        // the triangles in the scene and in texture coordinates.
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
                TextureSize::Resolution(side) => f64::from(side),
                TextureSize::Texel(texel) => {
                    (units(0..scene.len() as usize) / texel).ceil().max(1.0)
                }
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
        let side =
            |p: &PrimitiveInstance| units(p.first as usize..p.first as usize + p.corners.len());
        let sides: Vec<f64> = parts.all.iter().map(side).collect();
        let squares: Vec<[f64; 2]> = sides.iter().map(|s| [*s; 2]).collect();
        let packed = pack(&file.name, &squares, size)?;
        (atlas.size, atlas.gap) = (packed.size, packed.gap);
        for (i, part) in parts.all.iter().enumerate() {
            let scale = packed
                .size
                .map(|n| sides[i] * packed.per_unit / f64::from(n));
            let offset = [0, 1].map(|k| f64::from(packed.at[i][k]) / f64::from(packed.size[k]));
            atlas.layouts[i] = AtlasLayout::Moved { scale, offset };
            let own = &mut atlas.triangles[part.first as usize..][..part.corners.len()];
            for corner in own.iter_mut().flatten() {
                *corner = in_texels(AtlasLayout::moved(scale, offset, *corner), packed.size);
            }
        }
        Ok(atlas)
    }
}

/// Returns the name of a primitive for messages: the indices of its mesh, primitive and node.
pub(crate) fn label(parts: &PrimitiveInstances, part: &PrimitiveInstance) -> String {
    let draw = parts.draws[part.draw];
    format!(
        "mesh {}, primitive {} (at node {})",
        draw.mesh, part.primitive, draw.node
    )
}

/// Reads `TEXCOORD_1` at the corners of a primitive's triangles. Returns `None` if the primitive has no
/// `TEXCOORD_1`.
fn coordinates(
    file: &GltfParts,
    parts: &PrimitiveInstances,
    part: &PrimitiveInstance,
) -> Result<Option<Vec<FlatTriangle>>, TexelsError> {
    let primitive = primitive_of(file, parts.draws[part.draw].mesh, part.primitive);
    let accessor = primitive
        .and_then(|p| p.get("attributes"))
        .and_then(|a| member(a, "TEXCOORD_1"));
    let Some(accessor) = accessor else {
        return Ok(None);
    };
    let elements = CheckedElements::read(file, accessor)?;
    if elements.components != 2 || !(elements.normalized || elements.component == FLOAT) {
        return Err(file.broken(
            format!("accessor {accessor}"),
            "TEXCOORD_1 must consist of two floats or two normalized integers",
        ));
    }
    if elements.count < part.vertices as usize {
        return Err(file.broken(
            format!("accessor {accessor}"),
            "TEXCOORD_1 has fewer elements than the primitive has vertices",
        ));
    }
    let corner = |v: u32| [0, 1].map(|c| elements.number(v as usize, c));
    Ok(Some(part.corners.iter().map(|t| t.map(corner)).collect()))
}
