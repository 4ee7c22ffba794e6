//! All planes of a scene's blocking triangles, each once.

use dashu_int::IBig;
use rustc_hash::FxHashMap;
use sightline_scene::Scene;
use sightline_scene::sides::Side;

use crate::plane::{Plane, PlaneId};

/// The planes of the triangles that block all lines, from both sides.
pub struct Planes {
    planes: Vec<Plane>,
    /// The first triangle in each plane.
    triangles: Vec<u32>,
    /// The plane of each triangle; `None` for those that do not block or not from both sides.
    of: Vec<Option<PlaneId>>,
}

impl Planes {
    /// The planes of a scene, in the order of their first triangles.
    pub fn new(scene: &Scene) -> Self {
        let mut known: FxHashMap<[IBig; 4], PlaneId> = FxHashMap::default();
        let (mut planes, mut triangles) = (Vec::new(), Vec::new());
        let of = (0..scene.len())
            .map(|id| {
                if !blocks(scene, id) {
                    return None;
                }
                let plane = Plane::through(scene.triangles()[id as usize].v);
                Some(*known.entry(plane.coefficients().clone()).or_insert_with(|| {
                    planes.push(plane);
                    triangles.push(id);
                    PlaneId(planes.len() as u32 - 1)
                }))
            })
            .collect();
        Self { planes, triangles, of }
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

/// Whether a triangle blocks every line that meets it.
pub fn blocks(scene: &Scene, id: u32) -> bool {
    scene.blocks(id) && scene.sides().side(id) == Side::Both
}
