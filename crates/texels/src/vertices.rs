//! The unknown values at vertices, and the receivers to which the values are fitted.
//!
//! If a primitive has normals, the vertices of one mesh instance with the same position and the same normal
//! share a value, even if other attributes differ, so seams of texture coordinates are invisible. A vertex
//! that several faces share in the file has one value.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;
use sightline_scene::{Scene, TriangleId};

use crate::TexelsError;
use crate::accessor::CheckedElements;
use crate::file::{GltfParts, member};
use crate::parts::{PrimitiveInstance, PrimitiveInstances, primitive_of};
use crate::receivers::Receiver;
use crate::welds::{cross, places};

/// The entry of [`VertexSet::unknowns`] for a vertex without a triangle, which has no unknown.
pub(crate) const NONE: u32 = u32::MAX;

/// The vertices of one accessor of positions in one mesh instance.
#[derive(Clone, Debug)]
pub(crate) struct VertexSet {
    /// The index of the unknown of each vertex, or [`NONE`].
    pub unknowns: Vec<u32>,
}

/// The unknowns of all primitives: one value for each group of vertices that share a value.
#[derive(Clone, Debug)]
pub(crate) struct Unknowns {
    /// The number of unknowns.
    pub count: usize,
    /// The indices of the unknowns at the corners of each triangle of the scene.
    pub corners: Vec<[u32; 3]>,
    /// The sets of vertices, in the order in which primitives first use them.
    pub sets: Vec<VertexSet>,
    /// The index of each primitive's set in `sets`.
    pub set_of: Vec<usize>,
    /// For each triangle, the number of equal parts into which each edge is divided, from 0 to 8. The number
    /// of the triangle's receivers is the square.
    pub divisions: Vec<u8>,
}

/// The key of an unknown. With normals: mesh instance, position number, bits of the normal, `true`. Without
/// normals: vertex set, vertex, zeros, `false`.
type UnknownKey = (usize, u32, [u32; 3], bool);

/// Maximum number of vertices of all sets.
const MOST_VERTICES: u64 = 1 << 28;

impl Unknowns {
    /// Numbers the unknowns of the primitives of a file. Returns `None` if the vertex sets together have more
    /// than 2²⁸ vertices.
    pub(crate) fn from_parts(
        file: &GltfParts,
        scene: &Scene,
        parts: &PrimitiveInstances,
    ) -> Result<Option<Self>, TexelsError> {
        let places = places(scene.triangles());
        let mut numbers: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        let (mut keys, mut set_of): (Vec<Vec<Option<UnknownKey>>>, Vec<usize>) =
            (Vec::new(), Vec::new());
        let mut total = 0u64;
        for part in &parts.all {
            let mut new = false;
            let set = *numbers
                .entry((part.draw, part.positions))
                .or_insert_with(|| {
                    new = true;
                    keys.len()
                });
            if new {
                total += u64::from(part.vertices);
                if total > MOST_VERTICES {
                    return Ok(None);
                }
                keys.push(vec![None; part.vertices as usize]);
            }
            set_of.push(set);
            let normals = normals(file, parts, part)?;
            for (corners, places) in part.corners.iter().zip(&places[part.first as usize..]) {
                for (vertex, place) in corners.iter().zip(places) {
                    let slot = &mut keys[set][*vertex as usize];
                    let key = || match &normals {
                        Some(n) => {
                            let normal = [0, 1, 2]
                                .map(|c| (n.number(*vertex as usize, c) as f32 + 0.0).to_bits());
                            (part.draw, *place, normal, true)
                        }
                        None => (set, *vertex, [0; 3], false),
                    };
                    *slot = Some(slot.unwrap_or_else(key));
                }
            }
        }
        let mut all: Vec<UnknownKey> = keys.iter().flatten().flatten().copied().collect();
        all.sort_unstable();
        all.dedup();
        let number = |key: &Option<UnknownKey>| {
            key.map_or(NONE, |k| all.binary_search(&k).map_or(NONE, |i| i as u32))
        };
        let sets: Vec<VertexSet> = keys
            .par_iter()
            .map(|k| VertexSet {
                unknowns: k.iter().map(number).collect(),
            })
            .collect();
        let mut corners = vec![[0; 3]; scene.len() as usize];
        for (part, set) in parts.all.iter().zip(&set_of) {
            for (to, vertices) in corners[part.first as usize..].iter_mut().zip(&part.corners) {
                *to = vertices.map(|v| sets[*set].unknowns[v as usize]);
            }
        }
        let divisions = divisions(scene);
        Ok(Some(Self {
            count: all.len(),
            corners,
            sets,
            set_of,
            divisions,
        }))
    }

    /// Creates the receivers of all triangles, in the order of the triangles.
    pub(crate) fn receivers(&self, scene: &Scene, parts: &PrimitiveInstances) -> Vec<Receiver> {
        let mut all =
            Vec::with_capacity(self.divisions.iter().map(|k| usize::from(*k).pow(2)).sum());
        for part in &parts.all {
            for id in part.first..part.first + part.corners.len() as u32 {
                let triangle = &scene.triangles()[id as usize];
                let normal = cross(triangle).normalize_or_zero() * part.front;
                let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
                let at = |[x, y, z]: [f64; 3]| -> DVec3 { a * x + b * y + c * z };
                let points = samples(self.divisions[id as usize]);
                all.extend(points.map(|w| Receiver {
                    point: at(w),
                    normal,
                    triangle: TriangleId(id),
                }));
            }
        }
        all
    }
}

/// Reads the normals of a primitive's vertices. Returns `None` if the primitive has no normals with three
/// components.
fn normals<'a>(
    file: &'a GltfParts,
    parts: &PrimitiveInstances,
    part: &PrimitiveInstance,
) -> Result<Option<CheckedElements<'a>>, TexelsError> {
    let primitive = primitive_of(file, parts.draws[part.draw].mesh, part.primitive);
    let accessor = primitive
        .and_then(|p| p.get("attributes"))
        .and_then(|a| member(a, "NORMAL"));
    let Some(accessor) = accessor else {
        return Ok(None);
    };
    let elements = CheckedElements::read(file, accessor)?;
    Ok(Some(elements).filter(|e| e.components == 3))
}

/// Computes [`Unknowns::divisions`]. A triangle without area has no receivers. Other triangles have at least
/// 4 receivers, and up to 64 receivers if the area of the triangle is larger than the mean.
fn divisions(scene: &Scene) -> Vec<u8> {
    let areas: Vec<f64> = scene
        .triangles()
        .iter()
        .map(|t| cross(t).length())
        .collect();
    let mean = areas.iter().sum::<f64>() / areas.len().max(1) as f64;
    let degenerate = scene
        .triangles()
        .par_iter()
        .map(sightline_scene::Triangle::is_degenerate);
    let flat: Vec<bool> = degenerate.collect();
    let count_divisions = |(area, flat): (&f64, bool)| {
        if flat || *area == 0.0 {
            0
        } else {
            (4.0 * area / mean).sqrt().ceil().clamp(2.0, 8.0) as u8
        }
    };
    areas.iter().zip(flat).map(count_divisions).collect()
}

/// Returns the centroids of the `k`² equal triangles into which a triangle is divided, as weights of its
/// corners.
pub(crate) fn samples(k: u8) -> impl Iterator<Item = [f64; 3]> {
    let n = f64::from(k);
    (0..k).flat_map(move |i| {
        (0..k - i).flat_map(move |j| {
            // The triangle with the orientation of the whole triangle, and the neighbouring triangle with the
            // reversed orientation, if the neighbour is inside the whole triangle.
            let turned = i + j + 1 < k;
            [(1.0 / 3.0, true), (2.0 / 3.0, turned)]
                .into_iter()
                .filter(|s| s.1)
                .map(move |(shift, _)| {
                    let (second, third) = ((f64::from(i) + shift) / n, (f64::from(j) + shift) / n);
                    [1.0 - second - third, second, third]
                })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::samples;

    #[test]
    fn samples_are_inside_and_have_centroid_of_triangle() {
        for k in 0..9u8 {
            let all: Vec<[f64; 3]> = samples(k).collect();
            assert_eq!(all.len(), usize::from(k).pow(2));
            assert!(all.iter().flatten().all(|w| *w > 0.0));
            for c in 0..3 {
                let mean = all.iter().map(|w| w[c]).sum::<f64>() / all.len().max(1) as f64;
                assert!(k == 0 || (mean - 1.0 / 3.0).abs() < 1e-12);
            }
        }
    }
}
