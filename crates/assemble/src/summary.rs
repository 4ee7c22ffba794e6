//! The facts about a scene that a result contains or needs.

use sightline_scene::{Aabb, GltfLocation, Kinds, Object, Scene};

/// A scene's facts without its triangles.
#[derive(Clone, Debug)]
pub struct SceneSummary {
    /// The number of triangles.
    pub triangles: u32,
    /// The objects.
    pub objects: Vec<Object>,
    /// The bounds in world space.
    pub bounds: Aabb,
    /// The kinds of the triangles.
    pub kinds: Kinds,
    /// The nodes and meshes of the objects in their glTF file; empty for other files.
    pub sources: Vec<GltfLocation>,
    /// True if triangles are seen from their front sides only.
    pub is_culled: bool,
}

impl From<&Scene> for SceneSummary {
    fn from(scene: &Scene) -> Self {
        Self {
            triangles: scene.len(),
            objects: scene.objects().to_vec(),
            bounds: scene.bounds(),
            kinds: scene.kinds().clone(),
            sources: scene.sources().to_vec(),
            is_culled: !scene.sides().are_both(),
        }
    }
}
