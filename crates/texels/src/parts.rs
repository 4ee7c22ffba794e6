//! The primitive instances of a file: for each node with a mesh, the primitives of the mesh with triangles.

use serde_json::Value;
use sightline_scene::{GltfLocation, Scene};

use crate::TexelsError;
use crate::accessor::CheckedElements;
use crate::file::{GltfParts, member};
use crate::instances::{instance_mirrors, mirrors};

/// The extension of compressed primitives.
const DRACO: &str = "KHR_draco_mesh_compression";

/// A primitive of a mesh instance, with its triangles.
#[derive(Clone, Debug)]
pub(crate) struct PrimitiveInstance {
    /// The index of the mesh instance in [`PrimitiveInstances::draws`].
    pub draw: usize,
    /// The index of the primitive in its mesh.
    pub primitive: usize,
    /// The id of the primitive's first triangle in the scene.
    pub first: u32,
    /// The corners of the primitive's triangles, as indices of vertices.
    pub corners: Vec<[u32; 3]>,
    /// The index of the accessor of the positions.
    pub positions: usize,
    /// The number of elements of the accessor of the positions.
    pub vertices: u32,
    /// The winding of the triangles' fronts: 1, or -1 if the transform to world space mirrors. With -1,
    /// triangles are wound clockwise as seen from their front.
    pub front: f64,
}

/// The mesh of a node, or of one of the node's instances (EXT_mesh_gpu_instancing).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MeshInstance {
    /// The index of the node in the file.
    pub node: usize,
    /// The index of the instance, if the node has instances.
    pub instance: Option<u32>,
    /// The index of the mesh in the file.
    pub mesh: usize,
}

/// All primitive instances with triangles, and the mesh instances that contain them.
#[derive(Clone, Debug, Default)]
pub(crate) struct PrimitiveInstances {
    /// The primitive instances with triangles, in the order of their triangles in the scene.
    pub all: Vec<PrimitiveInstance>,
    /// The mesh instances of the scene, including instances of meshes without triangles.
    pub draws: Vec<MeshInstance>,
}

impl PrimitiveInstances {
    /// Lists the primitive instances of `file`. `scene` is the scene that was loaded from the file, and
    /// `sources` contains the location of each of its objects in the file.
    pub(crate) fn new(
        file: &GltfParts,
        scene: &Scene,
        sources: &[GltfLocation],
    ) -> Result<Self, TexelsError> {
        let signs = mirrors(file);
        let mut parts = Self::default();
        let mut front = 1.0;
        for (object, source) in scene.objects().iter().zip(sources) {
            let [node, mesh, primitive] =
                [source.node, source.mesh, source.primitive].map(|i| i as usize);
            let draw = MeshInstance {
                node,
                instance: source.instance,
                mesh,
            };
            if parts.draws.last() != Some(&draw) {
                parts.draws.push(draw);
                front = signs.get(node).copied().unwrap_or(1.0);
                if let Some(i) = source.instance {
                    front *= instance_mirrors(file, node, i)?;
                }
            }
            if object.count == 0 {
                continue;
            }
            let element = format!("mesh {mesh}, primitive {primitive}");
            let given = primitive_of(file, mesh, primitive).ok_or_else(|| {
                file.broken(element.as_str(), "the file contains no such primitive")
            })?;
            let mut part = corners(file, given, &element)?;
            if part.corners.len() != object.count as usize {
                return Err(TexelsError::OtherScene {
                    file: file.name.clone(),
                    element,
                    reason: format!(
                        "the primitive has {} triangles in the file and {} in the scene",
                        part.corners.len(),
                        object.count
                    ),
                });
            }
            (part.draw, part.primitive) = (parts.draws.len() - 1, primitive);
            (part.first, part.front) = (object.first, front);
            parts.all.push(part);
        }
        Ok(parts)
    }
}

/// Returns primitive `primitive` of mesh `mesh`, or `None` if the file does not contain it.
pub(crate) fn primitive_of(file: &GltfParts, mesh: usize, primitive: usize) -> Option<&Value> {
    file.array("meshes")
        .get(mesh)?
        .get("primitives")?
        .get(primitive)
}

/// Replaces primitive `primitive` of mesh `mesh` by `new`.
pub(crate) fn put_primitive(
    file: &mut GltfParts,
    mesh: usize,
    primitive: usize,
    new: Value,
) -> Result<(), TexelsError> {
    let mesh = file.array_mut("meshes")?.get_mut(mesh);
    if let Some(slot) = mesh
        .and_then(|m| m.get_mut("primitives"))
        .and_then(|p| p.get_mut(primitive))
    {
        *slot = new;
    }
    Ok(())
}

/// Reads a primitive's triangles. The caller sets `draw`, `primitive`, `first` and `front` of the result.
fn corners(
    file: &GltfParts,
    primitive: &Value,
    element: &str,
) -> Result<PrimitiveInstance, TexelsError> {
    if primitive
        .get("extensions")
        .is_some_and(|e| e.get(DRACO).is_some())
    {
        let (file, element) = (file.name.clone(), element.to_owned());
        return Err(TexelsError::Compressed {
            file,
            element,
            extension: DRACO,
        });
    }
    let positions = primitive
        .get("attributes")
        .and_then(|a| member(a, "POSITION"));
    let positions =
        positions.ok_or_else(|| file.broken(element, "the primitive has no POSITION"))?;
    let vertices = CheckedElements::read(file, positions)?.count;
    let vertices = u32::try_from(vertices)
        .map_err(|_| file.broken(element, "the primitive has more than 4294967295 vertices"))?;
    let list: Vec<u32> = match member(primitive, "indices") {
        None => (0..vertices).collect(),
        Some(indices) => {
            let elements = CheckedElements::read(file, indices)?;
            let indices: Option<Vec<u32>> = (0..elements.count)
                .map(|i| elements.index(i).filter(|v| *v < vertices))
                .collect();
            indices.ok_or_else(|| {
                file.broken(
                    element,
                    "an index is not an unsigned integer below the number of vertices",
                )
            })?
        }
    };
    let corners = match primitive.get("mode").and_then(Value::as_u64).unwrap_or(4) {
        4 => list.as_chunks::<3>().0.to_vec(),
        // Every second triangle of a strip is reversed, so that all have the same winding.
        5 => list
            .windows(3)
            .enumerate()
            .map(|(i, w)| {
                if i % 2 == 0 {
                    [w[0], w[1], w[2]]
                } else {
                    [w[0], w[2], w[1]]
                }
            })
            .collect(),
        6 => list
            .windows(2)
            .skip(1)
            .map(|w| [w[0], w[1], list[0]])
            .collect(),
        _ => Vec::new(),
    };
    Ok(PrimitiveInstance {
        draw: 0,
        primitive: 0,
        first: 0,
        corners,
        positions,
        vertices,
        front: 1.0,
    })
}
