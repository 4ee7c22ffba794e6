//! All planes of a scene's blocking triangles and of its doors, each once.

use dashu_int::IBig;
use rustc_hash::FxHashMap;
use sightline_scene::Scene;
use sightline_scene::kinds::Kind;
use sightline_scene::sides::Side;

use crate::plane::{Plane, PlaneId};

/// The planes of the triangles that divide space.
pub struct Planes {
    planes: Vec<Plane>,
    /// The first triangle in each plane.
    triangles: Vec<u32>,
    /// The plane of each triangle that divides space.
    of: Vec<Option<PlaneId>>,
}

impl Planes {
    /// The planes of a scene, in the order of their first triangles in [`by_place`].
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
            of: plane_ids,
        }
    }

    /// A plane.
    pub fn plane(&self, id: PlaneId) -> &Plane {
        &self.planes[id.0 as usize]
    }

    /// The first triangle in a plane.
    pub fn triangle(&self, id: PlaneId) -> u32 {
        self.triangles[id.0 as usize]
    }

    /// The plane of a triangle that blocks.
    pub fn of(&self, triangle: u32) -> Option<PlaneId> {
        self.of[triangle as usize]
    }

    /// Number of planes.
    pub fn len(&self) -> usize {
        self.planes.len()
    }

    /// Whether no triangle blocks.
    pub fn is_empty(&self) -> bool {
        self.planes.is_empty()
    }
}

/// Whether the plane of a triangle can divide space: it blocks every line that meets it, or is a door's.
pub fn divides(scene: &Scene, id: u32) -> bool {
    blocks(scene, id) || is_door(scene, id)
}

/// Whether a triangle with area is a door's.
pub fn is_door(scene: &Scene, id: u32) -> bool {
    scene.kinds().kind(id) == Kind::Door && !scene.triangles()[id as usize].is_degenerate()
}

/// All triangles in the order of their corners' places, so that their order in the scene decides nothing.
pub fn by_place(scene: &Scene) -> Vec<u32> {
    // −0 and 0 are one coordinate; the bits of the others, turned so, are in their order.
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

/// Whether a triangle blocks every line that meets it.
pub fn blocks(scene: &Scene, id: u32) -> bool {
    scene.blocks(id) && scene.sides().side(id) == Side::Both
}
