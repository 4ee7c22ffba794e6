//! All planes of a scene's blocking triangles and doors, each plane once.

use dashu_int::IBig;
use rustc_hash::FxHashMap;
use sightline_scene::kinds::SurfaceKind;
use sightline_scene::sides::Side;
use sightline_scene::{Scene, TriangleId};

use crate::plane::{Plane, PlaneId};

/// The planes of the triangles that divide space.
pub struct Planes {
    planes: Vec<Plane>,
    /// For each plane, the id of its first triangle in the order of [`by_place`].
    triangles: Vec<u32>,
    /// For each triangle, its plane, or `None` if the triangle does not divide space.
    by_triangle: Vec<Option<PlaneId>>,
}

impl Planes {
    /// Collects the planes of a scene, in the order of their first triangles in [`by_place`].
    pub fn new(scene: &Scene) -> Self {
        let mut known: FxHashMap<[IBig; 4], PlaneId> = FxHashMap::default();
        let (mut planes, mut triangles) = (Vec::new(), Vec::new());
        let mut plane_ids = vec![None; scene.len() as usize];
        for id in by_place(scene).into_iter().filter(|id| divides(scene, *id)) {
            let plane = Plane::through(scene.triangles()[id as usize].v);
            let number = *known
                .entry(plane.coefficients().clone())
                .or_insert_with(|| {
                    planes.push(plane);
                    triangles.push(id);
                    PlaneId(planes.len() as u32 - 1)
                });
            plane_ids[id as usize] = Some(number);
        }
        Self {
            planes,
            triangles,
            by_triangle: plane_ids,
        }
    }

    /// Returns a plane.
    pub fn plane(&self, id: PlaneId) -> &Plane {
        &self.planes[id.0 as usize]
    }

    /// Returns the first triangle in a plane.
    pub fn triangle(&self, id: PlaneId) -> TriangleId {
        TriangleId(self.triangles[id.0 as usize])
    }

    /// Returns the plane of a triangle, or `None` if the triangle does not divide space.
    pub fn find_plane(&self, triangle: TriangleId) -> Option<PlaneId> {
        self.by_triangle[triangle.at()]
    }

    /// Returns the number of planes.
    pub fn len(&self) -> usize {
        self.planes.len()
    }

    /// Returns true if no triangle divides space.
    pub fn is_empty(&self) -> bool {
        self.planes.is_empty()
    }
}

/// Returns true if the plane of a triangle can divide space.
///
/// The triangle must block every line that meets it, or belong to a door.
pub fn divides(scene: &Scene, id: u32) -> bool {
    blocks(scene, id) || is_door(scene, id)
}

/// Returns true if a triangle has area and belongs to a door.
pub fn is_door(scene: &Scene, id: u32) -> bool {
    scene.kinds().kind(TriangleId(id)) == SurfaceKind::Door
        && !scene.triangles()[id as usize].is_degenerate()
}

/// Returns the ids of all triangles, sorted by the coordinates of their corners.
///
/// The sort makes results independent of the order of the triangles in the scene.
pub fn by_place(scene: &Scene) -> Vec<u32> {
    // −0 and 0 are one coordinate. With this conversion, the bits of other coordinates are in their order.
    let key = |x: f32| {
        let bits = (x + 0.0).to_bits();
        if bits >> 31 == 1 {
            !bits
        } else {
            bits | 1 << 31
        }
    };
    let place = |id: &u32| {
        scene.triangles()[*id as usize]
            .v
            .map(|v| v.to_array().map(key))
    };
    let mut all: Vec<u32> = (0..scene.len()).collect();
    all.sort_by_cached_key(place);
    all
}

/// Returns true if a triangle blocks every line that meets it.
pub fn blocks(scene: &Scene, id: u32) -> bool {
    scene.blocks(TriangleId(id)) && scene.sides().side(TriangleId(id)) == Side::Both
}
