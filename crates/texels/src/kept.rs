//! Texture coordinates that the file has: whether `TEXCOORD_1` can be used, and how its parts share an image.

use sightline_scene::Scene;

use crate::TexelsError;
use crate::accessor::{Elements, FLOAT};
use crate::atlas::{Atlas, GAP, Layout, in_texels};
use crate::error::MOST_SIDE;
use crate::file::{File, member};
use crate::overlap::{Flat, SLACK, overlap};
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
pub(crate) struct Coordinates {
    /// The corners of each triangle of the scene, from 0 to 1.
    triangles: Vec<Flat>,
    /// Whether parts lie upon each other, so that each needs a place of its own.
    apart: bool,
}

/// Twice the area of a triangle.
pub(crate) fn area(t: &Flat) -> f64 {
    (t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[1][1] - t[0][1]) * (t[2][0] - t[0][0])
}

impl Coordinates {
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
            let unusable =
                |element: String, reason: &str| Ok(Err(Unusable { element, reason: reason.to_owned() }));
            let Some(own) = coordinates(file, parts, part)? else {
                return unusable(label, "it has no TEXCOORD_1");
            };
            let (mut without, mut all) = (0.0, 0.0);
            for (k, t) in own.iter().enumerate() {
                if !t.iter().flatten().all(|c| (-SLACK..=1.0 + SLACK).contains(c)) {
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
                return unusable(format!("{label}, triangles {a} and {b}"), "they overlap in TEXCOORD_1");
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
        let mut atlas = Atlas { size: [1, 1], triangles: self.triangles, layouts, charts: 0 };
        // Units of the scene for one side of the image, from the areas of both.
        let units = |range: std::ops::Range<usize>| {
            let flat: f64 = atlas.triangles[range.clone()].iter().map(|t| area(t).abs()).sum();
            let surface: f64 = scene.triangles()[range].iter().map(|t| cross(t).length()).sum();
            if flat > 0.0 && surface > 0.0 { (surface / flat).sqrt() } else { 0.0 }
        };
        if !self.apart {
            let side = match size {
                Size::Resolution(side) => f64::from(side),
                Size::Texel(texel) => (units(0..scene.len() as usize) / texel).ceil().max(1.0),
            };
            let side = within(file, side, side)?;
            atlas.size = [side; 2];
            for corner in atlas.triangles.iter_mut().flatten() {
                *corner = in_texels(corner.map(|c| c.clamp(0.0, 1.0) as f32), atlas.size);
            }
            return Ok(atlas);
        }
        let sides: Vec<f64> =
            parts.all.iter().map(|p| units(p.first as usize..p.first as usize + p.corners.len())).collect();
        let (places, image) = arrange(file, &sides, size)?;
        atlas.size = image;
        for ((part, place), layout) in parts.all.iter().zip(&places).zip(&mut atlas.layouts) {
            let scale = image.map(|n| f64::from(place.side) / f64::from(n));
            let offset = [0, 1].map(|k| f64::from(place.at[k]) / f64::from(image[k]));
            *layout = Layout::Moved { scale, offset };
            let own = &mut atlas.triangles[part.first as usize..][..part.corners.len()];
            for corner in own.iter_mut().flatten() {
                *corner = in_texels(Layout::moved(scale, offset, *corner), image);
            }
        }
        Ok(atlas)
    }
}

/// A primitive in messages.
pub(crate) fn label(parts: &Parts, part: &Part) -> String {
    let draw = parts.draws[part.draw];
    format!("mesh {}, primitive {} (at node {})", draw.mesh, part.primitive, draw.node)
}

/// `TEXCOORD_1` of a part's triangles; none if it has none.
fn coordinates(file: &File, parts: &Parts, part: &Part) -> Result<Option<Vec<Flat>>, TexelsError> {
    let primitive = primitive_of(file, parts.draws[part.draw].mesh, part.primitive);
    let accessor = primitive.and_then(|p| p.get("attributes")).and_then(|a| member(a, "TEXCOORD_1"));
    let Some(accessor) = accessor else { return Ok(None) };
    let elements = Elements::read(file, accessor)?;
    if elements.components != 2 || !(elements.normalized || elements.component == FLOAT) {
        return Err(file.broken(format!("accessor {accessor}"), "its elements are no texture coordinates"));
    }
    if elements.count < part.vertices as usize {
        return Err(
            file.broken(format!("accessor {accessor}"), "it has fewer elements than there are vertices")
        );
    }
    let corner = |v: u32| [0, 1].map(|c| elements.number(v as usize, c));
    Ok(Some(part.corners.iter().map(|t| t.map(corner)).collect()))
}

/// The side of an image as a number of texels, unless it is too large.
fn within(file: &File, side: f64, other: f64) -> Result<u32, TexelsError> {
    if side <= f64::from(MOST_SIDE) && other <= f64::from(MOST_SIDE) {
        Ok(side as u32)
    } else {
        Err(TexelsError::TooManyTexels { file: file.name.clone(), texels: side * other })
    }
}

/// A square of the image.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    at: [u32; 2],
    side: u32,
}

/// A square for each side, given in units of the scene, and the size of the image.
fn arrange(file: &File, sides: &[f64], size: Size) -> Result<(Vec<Place>, [u32; 2]), TexelsError> {
    let texels =
        |per_unit: f64| -> Vec<f64> { sides.iter().map(|s| (s * per_unit).ceil().max(1.0)).collect() };
    let gap = f64::from(2 * GAP);
    match size {
        Size::Texel(texel) => {
            let sides = texels(1.0 / texel);
            let total: f64 = sides.iter().map(|s| (s + gap) * (s + gap)).sum();
            let largest = sides.iter().copied().fold(1.0, f64::max) + gap;
            let mut width = total.sqrt().ceil().max(largest);
            loop {
                let side = within(file, width, width)?;
                let (places, height) = shelves(&sides, side);
                if height <= side {
                    return Ok((places, [side, height]));
                }
                width = (width * 1.05).ceil();
            }
        }
        Size::Resolution(side) => {
            let fits = |per_unit: f64| {
                let sides = texels(per_unit);
                let widest = sides.iter().copied().fold(0.0, f64::max) + gap <= f64::from(side);
                widest.then(|| shelves(&sides, side)).filter(|(_, height)| *height <= side)
            };
            // All sides become one texel at the least.
            let (mut low, mut high) =
                (0.0, f64::from(side) / sides.iter().copied().fold(f64::MIN_POSITIVE, f64::max));
            let mut best = fits(low).ok_or_else(|| TexelsError::TooManyCharts {
                file: file.name.clone(),
                charts: sides.len() as u32,
                side,
            })?;
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                match fits(middle) {
                    Some(found) => (best, low) = (found, middle),
                    None => high = middle,
                }
            }
            Ok((best.0, [side; 2]))
        }
    }
}

/// Squares in rows, the largest first, and the height of all rows.
fn shelves(sides: &[f64], width: u32) -> (Vec<Place>, u32) {
    let mut order: Vec<usize> = (0..sides.len()).collect();
    order.sort_by(|a, b| sides[*b].total_cmp(&sides[*a]).then(a.cmp(b)));
    let mut places = vec![Place::default(); sides.len()];
    let (mut at, mut row) = ([0u32; 2], 0u32);
    for i in order {
        let side = sides[i] as u32;
        let with_gaps = side.saturating_add(2 * GAP);
        if at[0].saturating_add(with_gaps) > width {
            at = [0, at[1].saturating_add(row)];
            row = 0;
        }
        row = row.max(with_gaps);
        places[i] = Place { at: [at[0] + GAP, at[1].saturating_add(GAP)], side };
        at[0] += with_gaps;
    }
    (places, at[1].saturating_add(row))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shelves_do_not_overlap() {
        let sides: Vec<f64> = (0..60).map(|i| f64::from(1 + i * 7 % 23)).collect();
        let (places, height) = shelves(&sides, 100);
        let mut owner = vec![false; 100 * height as usize];
        for place in places {
            for y in place.at[1] - GAP..place.at[1] + place.side + GAP {
                for x in place.at[0] - GAP..place.at[0] + place.side + GAP {
                    assert!(!std::mem::replace(&mut owner[(y * 100 + x) as usize], true));
                }
            }
        }
    }
}
