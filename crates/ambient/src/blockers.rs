//! The occluders of a scene: its blocking triangles, joined to convex polygons where neighbours are coplanar,
//! and a hierarchy of boxes over them.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use sightline_exact::{OccluderId, Occluders};
use sightline_geometry::Bvh;
use sightline_geometry::predicates::collinear;
use sightline_numbers::Aabb;
use sightline_scene::{Scene, SceneError, TriangleId};

use crate::masked;

/// A convex polygon of the scene.
struct Polygon {
    /// The index of the first corner in `Blockers::corners`.
    first: u32,
    /// The number of corners.
    count: u32,
    /// The id of the polygon's first triangle.
    triangle: TriangleId,
    /// The number of the surface that contains the polygon.
    surface: u32,
}

/// The lowest number of the surfaces of masked triangles. Each masked triangle is a separate surface.
const MASKED: u32 = 1 << 31;

/// The occluding polygons of a scene, in a fixed order.
pub struct Blockers {
    corners: Vec<DVec3>,
    polygons: Vec<Polygon>,
    /// For each triangle of the scene, the number of its surface: the triangle and the coplanar neighbours
    /// joined to the triangle. `None` for triangles that do not block.
    by_triangle: Vec<Option<u32>>,
    bvh: Bvh,
}

impl Blockers {
    /// Creates the polygons of a scene.
    ///
    /// Without `joined`, coplanar neighbours are joined while the result is convex. With `joined`, each
    /// triangle is a separate polygon, with the surface that the triangle has in `joined`.
    ///
    /// # Errors
    /// [`SceneError`] if the scene has more corners than 32-bit numbers can count, or if the masked triangles
    /// cover too many texels.
    pub fn new(scene: &Scene, joined: Option<&Self>) -> Result<Self, SceneError> {
        let (mut corners, mut polygons) = (Vec::new(), Vec::new());
        let mut surfaces = vec![None; scene.triangles().len()];
        let mut add = |outline: &[Vec3], triangle: TriangleId, surface: u32| {
            let first = corners.len() as u32;
            let n = outline.len();
            // A corner on the line through its neighbours does not bound the polygon.
            let bent = (0..n).filter(|i| {
                !collinear(outline[(i + n - 1) % n], outline[*i], outline[(i + 1) % n])
            });
            corners.extend(bent.map(|i| outline[i].as_dvec3()));
            polygons.push(Polygon {
                first,
                count: corners.len() as u32 - first,
                triangle,
                surface,
            });
        };
        if let Some(joined) = joined {
            surfaces.clone_from(&joined.by_triangle);
            for t in (0..scene.len()).filter(|t| scene.blocks(TriangleId(*t))) {
                add(
                    &scene.triangles()[t as usize].v,
                    TriangleId(t),
                    surfaces[t as usize].unwrap_or(MASKED | t),
                );
            }
        } else {
            let occluders = Occluders::from_both_sides(scene)?;
            for id in 0..occluders.count() as u32 {
                let occluder = occluders.occluder(OccluderId(id));
                add(
                    &occluder.outline(),
                    TriangleId(occluder.triangles[0].triangle),
                    id,
                );
            }
            for (t, surface) in surfaces.iter_mut().enumerate() {
                *surface = occluders.occluder_id(TriangleId(t as u32)).map(|id| id.0);
            }
        }
        let mut texels = 0.0;
        for t in 0..scene.len() {
            let Some((mask, of_corners)) = scene.masks().find_mask(TriangleId(t)) else {
                continue;
            };
            let v = scene.triangles()[t as usize].v.map(Vec3::as_dvec3);
            let Some(found) = masked::polygons(v, mask, of_corners, &mut texels) else {
                return Err(SceneError::bad(
                    "scene",
                    format!("triangle {t}"),
                    "the masked triangles up to this one cover more than 16777216 texels of alpha textures",
                    "omit --alpha-textures, or use smaller textures",
                ));
            };
            surfaces[t as usize] = Some(MASKED | t);
            for polygon in found {
                let first = corners.len() as u32;
                corners.extend(&polygon);
                polygons.push(Polygon {
                    first,
                    count: polygon.len() as u32,
                    triangle: TriangleId(t),
                    surface: MASKED | t,
                });
            }
        }
        let boxes: Vec<Aabb> = polygons
            .par_iter()
            .map(|p: &Polygon| {
                let corners = &corners[p.first as usize..(p.first + p.count) as usize];
                // Single precision cannot represent the corners of texels, so the box is rounded outwards.
                let low = corners.iter().map(|c| Vec3::from(c.to_array().map(below)));
                let high = corners
                    .iter()
                    .map(|c| -Vec3::from((-*c).to_array().map(below)));
                Aabb::around(low.chain(high))
            })
            .collect();
        let order = (0..polygons.len() as u32).collect();
        Ok(Self {
            bvh: Bvh::new(boxes, order),
            corners,
            polygons,
            by_triangle: surfaces,
        })
    }

    /// Returns the corners of a polygon in order.
    pub fn corners(&self, polygon: u32) -> &[DVec3] {
        let p = &self.polygons[polygon as usize];
        &self.corners[p.first as usize..(p.first + p.count) as usize]
    }

    /// Returns the first triangle of a polygon.
    pub fn triangle(&self, polygon: u32) -> TriangleId {
        self.polygons[polygon as usize].triangle
    }

    /// Returns the number of the surface that contains a triangle, if the triangle is an occluder.
    pub fn triangle_surface(&self, triangle: TriangleId) -> Option<u32> {
        self.by_triangle.get(triangle.at()).copied().flatten()
    }

    /// Returns the number of the surface that contains a polygon.
    pub fn surface(&self, polygon: u32) -> u32 {
        self.polygons[polygon as usize].surface
    }

    /// Returns the hierarchy over the polygons.
    pub fn bvh(&self) -> &Bvh {
        &self.bvh
    }
}

/// Rounds to the largest single-precision number that is not above `x`.
fn below(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) > x {
        near.next_down()
    } else {
        near
    }
}

/// Returns the eight corners of a box.
pub fn corners_of(b: Aabb) -> [DVec3; 8] {
    let ends = [b.min.as_dvec3(), b.max.as_dvec3()];
    std::array::from_fn(|i| DVec3::new(ends[i & 1].x, ends[i >> 1 & 1].y, ends[i >> 2].z))
}
