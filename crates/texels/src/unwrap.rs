//! New texture coordinates: the crate `uvunwrap` divides each primitive into charts, and this module packs
//! the charts into one image.
//!
//! The packing of `uvunwrap` needs minutes for a hundred thousand charts. So `uvunwrap` packs the charts
//! once, small and without gaps, into an image called the page, and this module reads the charts from the
//! page. Triangles that are too thin for coordinates in single precision get neither area nor texels.

use glam::Vec3;
use sightline_scene::Scene;
use uvunwrap::{Density, MeshInput, Options, OutputMesh, Packing};

use crate::TexelsError;
use crate::atlas::{Atlas, AtlasLayout, in_texels};
use crate::error::MOST_SIDE;
use crate::file::GltfParts;
use crate::overlap::FlatTriangle;
use crate::pack::{Packed, pack};
use crate::parts::{PrimitiveInstance, PrimitiveInstances};
use crate::settings::TextureSize;
use crate::welds::cross;

/// The total number of texels of all charts on the page of `uvunwrap`. Few texels make packing fast.
const SMALL: f64 = 262_144.0;

/// Creates new texture coordinates for all primitives in `parts`.
pub(crate) fn unwrap(
    file: &GltfParts,
    scene: &Scene,
    parts: &PrimitiveInstances,
    size: TextureSize,
) -> Result<Atlas, TexelsError> {
    let area: f64 = scene
        .triangles()
        .iter()
        .map(|t| 0.5 * cross(t).length())
        .sum();
    if area == 0.0 {
        return Err(TexelsError::NoTriangles {
            file: file.name.clone(),
        });
    }
    if let TextureSize::Texel(texel) = size {
        let texels = area / (texel * texel);
        // `texels` is not finite if the side of a texel is nearly 0.
        if texels.partial_cmp(&f64::from(MOST_SIDE).powi(2)) != Some(std::cmp::Ordering::Less) {
            return Err(TexelsError::TooManyTexels {
                file: file.name.clone(),
                texels,
            });
        }
    }
    let factor = factor(scene);
    let inputs: Vec<ChartInput> = parts
        .all
        .iter()
        .map(|part| ChartInput::new(scene, part, factor))
        .collect();
    let meshes: Vec<MeshInput<'_>> = inputs
        .iter()
        .map(|i| MeshInput::new(&i.positions, &i.indices))
        .collect();
    let texels_per_unit = ((SMALL / area).sqrt() / f64::from(factor)) as f32;
    let density = Density::Fixed {
        texels_per_unit,
        page_size: None,
    };
    let options = Options {
        density,
        padding: 0,
        packing: Packing::Fast,
        ..Options::default()
    };
    let made = uvunwrap::generate(&meshes, &options)
        .map_err(|e| file.broken("geometry", e.to_string()))?;
    let per_unit = f64::from(made.texels_per_unit) * f64::from(factor);
    let page = [made.width, made.height].map(|n| f64::from(n) / per_unit);
    let charts = charts(&made.meshes, page, made.chart_count as usize);
    let sizes: Vec<[f64; 2]> = charts.iter().map(Chart::size).collect();
    let packed = pack(&file.name, &sizes, size)?;
    Ok(atlas(
        scene,
        parts,
        &made.meshes,
        &charts,
        page,
        &packed,
        &inputs,
    ))
}

/// The geometry of a primitive as input of `uvunwrap`.
struct ChartInput {
    /// The indices of the primitive's vertices that its triangles use, in increasing order.
    used: Vec<u32>,
    /// The positions of the vertices in `used`, times the factor of [`factor`].
    positions: Vec<[f32; 3]>,
    /// The corners of the triangles, as indices into `used` and `positions`.
    indices: Vec<u32>,
}

impl ChartInput {
    fn new(scene: &Scene, part: &PrimitiveInstance, factor: f32) -> Self {
        let mut used: Vec<u32> = part.corners.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        // `used` contains the vertex of every corner, so the search succeeds.
        let place = |v: &u32| used.binary_search(v).unwrap_or(0) as u32;
        let indices: Vec<u32> = part.corners.iter().flatten().map(place).collect();
        let mut positions = vec![[0.0; 3]; used.len()];
        let triangles = &scene.triangles()[part.first as usize..][..part.corners.len()];
        for (triangle, at) in triangles.iter().zip(indices.as_chunks::<3>().0) {
            for (v, i) in triangle.v.iter().zip(at) {
                positions[*i as usize] = (*v * factor + Vec3::ZERO).to_array();
            }
        }
        Self {
            used,
            positions,
            indices,
        }
    }
}

/// Returns a power of two that scales the scene's coordinates to at most 1, so that the intermediate results
/// of `uvunwrap` stay within the range of single precision.
fn factor(scene: &Scene) -> f32 {
    let bounds = scene.bounds();
    let largest = f64::from(bounds.min.abs().max(bounds.max.abs()).max_element());
    // Use the bits of the exponent, because logarithms differ between platforms.
    let exponent = ((largest.to_bits() >> 52) as i64 - 1022).clamp(-126, 126);
    f64::from_bits(((1023 - exponent) as u64) << 52) as f32
}

/// The bounding rectangle of a chart on the page of `uvunwrap`, in units of the scene.
#[derive(Clone, Copy, Debug)]
struct Chart {
    min: [f64; 2],
    max: [f64; 2],
}

impl Chart {
    /// Returns the width and height of the chart in the packed image, in units of the scene. The width is the
    /// longer side, because wide rectangles fill rows best.
    fn size(&self) -> [f64; 2] {
        let [x, y] = [0, 1].map(|k| (self.max[k] - self.min[k]).max(0.0));
        [x.max(y), x.min(y)]
    }

    /// Converts a position on the page to a position relative to the chart's upper left corner in the packed
    /// image. If the chart is higher than wide, this function rotates the chart by a quarter turn.
    fn local(&self, at: [f64; 2]) -> [f64; 2] {
        if self.max[0] - self.min[0] >= self.max[1] - self.min[1] {
            [at[0] - self.min[0], at[1] - self.min[1]]
        } else {
            [at[1] - self.min[1], self.max[0] - at[0]]
        }
    }
}

/// Converts texture coordinates of `uvunwrap` to a position on its page, in units of the scene. `page` is the
/// width and height of the page in these units.
fn on_page(uv: [f32; 2], page: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|k| f64::from(uv[k]) * page[k])
}

/// Computes the bounding rectangles of all `count` charts on the page.
fn charts(meshes: &[OutputMesh], page: [f64; 2], count: usize) -> Vec<Chart> {
    let mut all = vec![
        Chart {
            min: [f64::INFINITY; 2],
            max: [f64::NEG_INFINITY; 2]
        };
        count
    ];
    for vertex in meshes.iter().flat_map(|m| &m.vertices) {
        if let Some(chart) = vertex.chart.and_then(|c| all.get_mut(c as usize)) {
            let at = on_page(vertex.uv, page);
            chart.min = [0, 1].map(|k| chart.min[k].min(at[k]));
            chart.max = [0, 1].map(|k| chart.max[k].max(at[k]));
        }
    }
    all
}

/// Creates the atlas from the charts' positions on the page and in the packed image.
fn atlas(
    scene: &Scene,
    parts: &PrimitiveInstances,
    meshes: &[OutputMesh],
    charts: &[Chart],
    page: [f64; 2],
    packed: &Packed,
    inputs: &[ChartInput],
) -> Atlas {
    let mut triangles = vec![FlatTriangle::default(); scene.len() as usize];
    let mut layouts = Vec::with_capacity(parts.all.len());
    for ((part, mesh), input) in parts.all.iter().zip(meshes).zip(inputs) {
        let placed = |chart: Option<u32>, uv: [f32; 2]| -> [f32; 2] {
            let Some(c) = chart.map(|c| c as usize) else {
                return [0.0; 2];
            };
            let local = charts[c].local(on_page(uv, page));
            let texel = |k: usize| f64::from(packed.at[c][k]) + local[k] * packed.per_unit;
            [0, 1].map(|k| (texel(k) / f64::from(packed.size[k])).clamp(0.0, 1.0) as f32)
        };
        let vertices: Vec<(u32, [f32; 2])> = mesh
            .vertices
            .iter()
            .map(|v| (input.used[v.xref as usize], placed(v.chart, v.uv)))
            .collect();
        let corners = mesh.indices.as_chunks::<3>().0.to_vec();
        let own = &mut triangles[part.first as usize..][..corners.len()];
        for (t, at) in own.iter_mut().zip(&corners) {
            *t = at.map(|v| in_texels(vertices[v as usize].1, packed.size));
        }
        layouts.push(AtlasLayout::New { vertices, corners });
    }
    Atlas {
        size: packed.size,
        triangles,
        layouts,
        charts: charts.len() as u32,
        gap: packed.gap,
    }
}
