//! Where the objects of a scene are in the glTF file they come from, so that an engine can map them back.

use crate::SceneError;

/// The place of an object in its glTF file, as indices of the file's arrays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// Of the node.
    pub node: u32,
    /// Of the mesh.
    pub mesh: u32,
    /// Of the primitive in its mesh.
    pub primitive: u32,
    /// Of the instance, for a node with `EXT_mesh_gpu_instancing`.
    pub instance: Option<u32>,
}

/// Bytes of a source in a canonical scene: node, mesh, primitive and instance as u32, the last one
/// `u32::MAX` when there is none.
const BYTES: usize = 16;

/// Bytes of the sources of `objects` objects. A scene of so many objects has at least eight bytes for each,
/// so this does not overflow.
pub(crate) fn length(objects: usize) -> usize {
    objects.saturating_mul(BYTES)
}

/// The canonical bytes of the sources.
pub(crate) fn write(sources: &[Source]) -> Vec<u8> {
    let entry = |s: &Source| [s.node, s.mesh, s.primitive, s.instance.unwrap_or(u32::MAX)];
    sources
        .iter()
        .flat_map(entry)
        .flat_map(u32::to_le_bytes)
        .collect()
}

/// Reads one source for each of `objects` objects from the end of a canonical scene.
pub(crate) fn read(bytes: &[u8], objects: usize) -> Result<Vec<Source>, &'static str> {
    if Some(bytes.len()) != objects.checked_mul(BYTES) {
        return Err("there is not one source for each object");
    }
    let word = |b: &[u8], at: usize| u32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
    let source = |b: &[u8]| Source {
        node: word(b, 0),
        mesh: word(b, 4),
        primitive: word(b, 8),
        instance: Some(word(b, 12)).filter(|i| *i != u32::MAX),
    };
    Ok(bytes.chunks_exact(BYTES).map(source).collect())
}

/// Refuses sources of another number of objects.
pub(crate) fn check(file: &str, sources: &[Source], objects: usize) -> Result<(), SceneError> {
    if sources.is_empty() || sources.len() == objects {
        return Ok(());
    }
    Err(SceneError::bad(
        file,
        "objects",
        format!("{} of {objects} have a source", sources.len()),
        "give a source for each object or for none",
    ))
}
