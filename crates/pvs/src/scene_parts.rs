//! The parts of a result that depend only on its scene and its viewpoints, as coded sections.

/// The items, the region and the portals of a result.
#[derive(Clone, Debug)]
pub struct SceneParts {
    /// The number of triangles of the scene.
    pub(crate) triangles: u32,
    /// The number of objects of the scene.
    pub(crate) objects: usize,
    /// The coded section of items; empty if the sets name triangles.
    pub(crate) items: Vec<u8>,
    /// The number of items.
    pub(crate) item_count: u32,
    /// The coded region of the viewpoints; empty if viewpoints are not restricted to a region.
    pub(crate) region: Vec<u8>,
    /// The coded section of portals; empty without portals.
    pub(crate) portals: Vec<u8>,
}
