//! New texture coordinates, by the crate `uvunwrap`: charts of each part, all packed into one image.
//!
//! Triangles that are too thin for coordinates in single precision get no area, and no texels.

use glam::Vec3;
use sightline_scene::Scene;
use uvunwrap::{Density, Error, MeshInput, Options, Packing};

use crate::TexelsError;
use crate::atlas::{Atlas, GAP, Layout, in_texels};
use crate::error::MOST_SIDE;
use crate::file::File;
use crate::overlap::Flat;
use crate::parts::Parts;
use crate::settings::Size;
use crate::welds::cross;

/// A part's vertices that its triangles use, in increasing order, and the triangles by their places in that
/// list.
fn compact(corners: &[[u32; 3]]) -> (Vec<u32>, Vec<u32>) {
    let mut used: Vec<u32> = corners.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    // Every corner is in the list.
    let place = |v: &u32| used.binary_search(v).unwrap_or(0) as u32;
    let indices = corners.iter().flatten().map(place).collect();
    (used, indices)
}

/// New texture coordinates for all parts.
pub(crate) fn unwrap(file: &File, scene: &Scene, parts: &Parts, size: Size) -> Result<Atlas, TexelsError> {
    let (density, page, factor) = density(file, scene, size)?;
    let mut vertices = Vec::with_capacity(parts.all.len());
    for part in &parts.all {
        let (used, indices) = compact(&part.corners);
        let mut positions = vec![[0.0f32; 3]; used.len()];
        let triangles = &scene.triangles()[part.first as usize..][..part.corners.len()];
        for (triangle, at) in triangles.iter().zip(indices.as_chunks::<3>().0) {
            for (v, i) in triangle.v.iter().zip(at) {
                positions[*i as usize] = (*v * factor + Vec3::ZERO).to_array();
            }
        }
        vertices.push((used, positions, indices));
    }
    let meshes: Vec<MeshInput<'_>> =
        vertices.iter().map(|(_, positions, indices)| MeshInput::new(positions, indices)).collect();
    // The other packing finds a place for each chart by its shape, and takes minutes for ten thousand of
    // them.
    let options = Options { density, padding: GAP, packing: Packing::Fast, ..Options::default() };
    let made = uvunwrap::generate(&meshes, &options).map_err(|e| refused(file, &e, page))?;
    if made.page_count > 1 {
        let side = page.unwrap_or(MOST_SIDE);
        return Err(TexelsError::TooManyCharts { file: file.name.clone(), charts: made.chart_count, side });
    }
    if made.width > MOST_SIDE || made.height > MOST_SIDE {
        let texels = f64::from(made.width) * f64::from(made.height);
        return Err(TexelsError::TooManyTexels { file: file.name.clone(), texels });
    }
    let size = [made.width.max(1), made.height.max(1)];
    let mut triangles = vec![Flat::default(); scene.len() as usize];
    let mut layouts = Vec::with_capacity(parts.all.len());
    for ((part, mesh), (used, ..)) in parts.all.iter().zip(&made.meshes).zip(&vertices) {
        let corners = mesh.indices.as_chunks::<3>().0.to_vec();
        let own = &mut triangles[part.first as usize..][..corners.len()];
        for (t, at) in own.iter_mut().zip(&corners) {
            let charted = at.iter().all(|v| mesh.vertices[*v as usize].chart.is_some());
            if charted {
                *t = at.map(|v| in_texels(mesh.vertices[v as usize].uv, size));
            }
        }
        let vertices = mesh.vertices.iter().map(|v| (used[v.xref as usize], v.uv)).collect();
        layouts.push(Layout::New { vertices, corners });
    }
    Ok(Atlas { size, triangles, layouts, charts: made.chart_count })
}

/// What to ask for, the side of the image if it is given, and a power of two that coordinates are
/// multiplied with, so that those of no scene leave the range of single precision on the way.
fn density(file: &File, scene: &Scene, size: Size) -> Result<(Density, Option<u32>, f32), TexelsError> {
    let (min, max) = (scene.bounds().min, scene.bounds().max);
    let largest = f64::from(min.abs().max(max.abs()).max_element()).max(f64::from(f32::MIN_POSITIVE));
    // From the bits of its exponent: platforms differ in their logarithms.
    let exponent = ((largest.to_bits() >> 52) as i64 - 1022).clamp(-126, 126);
    let factor = f64::from_bits(((1023 - exponent) as u64) << 52);
    let density = match size {
        Size::Resolution(side) => Density::Auto { page_size: side },
        Size::Texel(texel) => {
            let area: f64 = scene.triangles().iter().map(|t| 0.5 * cross(t).length()).sum();
            let texels = area / (texel * texel);
            let per_unit = 1.0 / (texel * factor);
            if !(texels <= f64::from(MOST_SIDE) * f64::from(MOST_SIDE) && per_unit <= f64::from(f32::MAX)) {
                return Err(TexelsError::TooManyTexels { file: file.name.clone(), texels });
            }
            // Coarser than any surface: a texel for each chart.
            let texels_per_unit = (per_unit as f32).max(1e-6);
            Density::Fixed { texels_per_unit, page_size: None }
        }
    };
    let page = match size {
        Size::Resolution(side) => Some(side),
        Size::Texel(_) => None,
    };
    Ok((density, page, factor as f32))
}

/// What the crate's error means here.
fn refused(file: &File, error: &Error, page: Option<u32>) -> TexelsError {
    let name = file.name.clone();
    match error {
        Error::AtlasTooLarge { texels } => TexelsError::TooManyTexels { file: name, texels: *texels as f64 },
        Error::ChartTooLarge { .. } => {
            TexelsError::TooManyCharts { file: name, charts: 1, side: page.unwrap_or(MOST_SIDE) }
        }
        Error::InvalidOption { .. } => TexelsError::Setting {
            option: "--resolution",
            value: page.map_or_else(|| "missing".to_owned(), |p| p.to_string()),
            rule: "it must be more than 8",
        },
        other => file.broken("geometry", other.to_string()),
    }
}
