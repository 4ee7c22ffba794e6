//! The locations of a scene's objects in their glTF file, so that an engine can map the objects back.

use crate::SceneError;

/// The location of an object in its glTF file, as indices into the arrays of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GltfLocation {
    /// The index of the node.
    pub node: u32,
    /// The index of the mesh.
    pub mesh: u32,
    /// The index of the primitive in the list of its mesh.
    pub primitive: u32,
    /// The index of the instance, for a node with `EXT_mesh_gpu_instancing`.
    pub instance: Option<u32>,
}

/// The number of bytes of a location in a canonical scene: node, mesh, primitive and instance as u32. The
/// instance is `u32::MAX` if the node has no instances.
const BYTES: usize = 16;

/// Returns the number of bytes of the locations of `objects` objects. The result does not overflow, because a
/// canonical scene has at least eight bytes per object.
pub(crate) fn length(objects: usize) -> usize {
    objects.saturating_mul(BYTES)
}

/// Encodes the locations to their canonical bytes.
pub(crate) fn write(sources: &[GltfLocation]) -> Vec<u8> {
    let entry = |s: &GltfLocation| [s.node, s.mesh, s.primitive, s.instance.unwrap_or(u32::MAX)];
    sources
        .iter()
        .flat_map(entry)
        .flat_map(u32::to_le_bytes)
        .collect()
}

/// Reads one location for each of `objects` objects from `bytes`, the end of a canonical scene.
pub(crate) fn read(bytes: &[u8], objects: usize) -> Result<Vec<GltfLocation>, &'static str> {
    if Some(bytes.len()) != objects.checked_mul(BYTES) {
        return Err("the number of glTF locations differs from the number of objects");
    }
    let word = |b: &[u8], at: usize| u32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
    let source = |b: &[u8]| GltfLocation {
        node: word(b, 0),
        mesh: word(b, 4),
        primitive: word(b, 8),
        instance: Some(word(b, 12)).filter(|i| *i != u32::MAX),
    };
    Ok(bytes.chunks_exact(BYTES).map(source).collect())
}

/// Checks that the number of locations is 0 or the number of objects.
pub(crate) fn check(
    file: &str,
    sources: &[GltfLocation],
    objects: usize,
) -> Result<(), SceneError> {
    if sources.is_empty() || sources.len() == objects {
        return Ok(());
    }
    Err(SceneError::bad(
        file,
        "objects",
        format!(
            "{} of {objects} objects have a location in a glTF file",
            sources.len()
        ),
        "give a location for each object or for none",
    ))
}
