//! What hides in a scene: its blocking triangles, joined to convex polygons where neighbours lie in one
//! plane, and a hierarchy of boxes over them.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use sightline_exact::{OccluderId, Occluders};
use sightline_geometry::Bvh;
use sightline_geometry::predicates::collinear;
use sightline_numbers::Aabb;
use sightline_scene::{Scene, SceneError};

use crate::masked;

/// A convex polygon of the scene.
struct Polygon {
    first: u32,
    count: u32,
    /// A triangle of it, the first.
    triangle: u32,
    /// The surface it belongs to.
    surface: u32,
}

/// Surfaces of masked triangles have numbers from here on: each is one by itself.
const MASKED: u32 = 1 << 31;

/// The polygons of a scene that hide, in a fixed order.
pub struct Blockers {
    corners: Vec<DVec3>,
    polygons: Vec<Polygon>,
    /// The surface of each triangle that hides: the coplanar neighbours that are joined to it.
    of: Vec<Option<u32>>,
    bvh: Bvh,
}

impl Blockers {
    /// The polygons of a scene: coplanar neighbours joined while they are convex; or its triangles by
    /// themselves, with the surfaces of those that were joined.
    ///
    /// # Errors
    /// When the scene has more corners than can be numbered, or alpha textures have too many texels on it.
    pub fn new(scene: &Scene, joined: Option<&Self>) -> Result<Self, SceneError> {
        let (mut corners, mut polygons) = (Vec::new(), Vec::new());
        let mut surfaces = vec![None; scene.triangles().len()];
        let mut add = |outline: &[Vec3], triangle: u32, surface: u32| {
            let first = corners.len() as u32;
            let n = outline.len();
            // Corners on the line through their neighbours bound nothing.
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
            surfaces.clone_from(&joined.of);
            for t in (0..scene.len()).filter(|t| scene.blocks(*t)) {
                add(
                    &scene.triangles()[t as usize].v,
                    t,
                    surfaces[t as usize].unwrap_or(MASKED | t),
                );
            }
        } else {
            let occluders = Occluders::from_both_sides(scene)?;
            for id in 0..occluders.count() as u32 {
                let occluder = occluders.occluder(OccluderId(id));
                add(&occluder.outline(), occluder.triangles[0].triangle, id);
            }
            for (t, surface) in surfaces.iter_mut().enumerate() {
                *surface = occluders.of(t as u32).map(|id| id.0);
            }
        }
        let mut texels = 0.0;
        for t in 0..scene.len() {
            let Some((mask, of_corners)) = scene.masks().of(t) else {
                continue;
            };
            let v = scene.triangles()[t as usize].v.map(Vec3::as_dvec3);
            let Some(found) = masked::polygons(v, mask, of_corners, &mut texels) else {
                return Err(SceneError::bad(
                    "scene",
                    format!("triangle {t}"),
                    "with it, masked triangles have more than 268 million texels of alpha textures on them",
                    "leave --alpha-textures out, or use smaller textures",
                ));
            };
            surfaces[t as usize] = Some(MASKED | t);
            for polygon in found {
                let first = corners.len() as u32;
                corners.extend(&polygon);
                polygons.push(Polygon {
                    first,
                    count: polygon.len() as u32,
                    triangle: t,
                    surface: MASKED | t,
                });
            }
        }
        let boxes: Vec<Aabb> = polygons
            .par_iter()
            .map(|p: &Polygon| {
                let corners = &corners[p.first as usize..(p.first + p.count) as usize];
                // Corners of texels are no numbers of single precision; the box holds them.
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
            of: surfaces,
        })
    }

    /// The corners of a polygon in order.
    pub fn corners(&self, polygon: u32) -> &[DVec3] {
        let p = &self.polygons[polygon as usize];
        &self.corners[p.first as usize..(p.first + p.count) as usize]
    }

    /// A triangle of a polygon.
    pub fn triangle(&self, polygon: u32) -> u32 {
        self.polygons[polygon as usize].triangle
    }

    /// The surface that a triangle is part of, if it hides.
    pub fn of(&self, triangle: u32) -> Option<u32> {
        self.of.get(triangle as usize).copied().flatten()
    }

    /// The surface that a polygon is part of.
    pub fn surface(&self, polygon: u32) -> u32 {
        self.polygons[polygon as usize].surface
    }

    /// The hierarchy over the polygons.
    pub fn bvh(&self) -> &Bvh {
        &self.bvh
    }
}

/// The largest number of single precision that is not above another.
fn below(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) > x {
        near.next_down()
    } else {
        near
    }
}

/// The eight corners of a box.
pub fn corners_of(b: Aabb) -> [DVec3; 8] {
    let ends = [b.min.as_dvec3(), b.max.as_dvec3()];
    std::array::from_fn(|i| DVec3::new(ends[i & 1].x, ends[i >> 1 & 1].y, ends[i >> 2].z))
}
