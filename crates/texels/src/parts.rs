//! The parts of a file that have a surface: pairs of a node's mesh and a primitive, with their triangles.

use serde_json::Value;
use sightline_scene::{Scene, Source};

use crate::TexelsError;
use crate::accessor::Elements;
use crate::file::{File, member};
use crate::instances::{instance_mirrors, mirrors};

/// The extension of compressed primitives.
const DRACO: &str = "KHR_draco_mesh_compression";

/// A primitive as a node has it.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// Which of the draws it belongs to.
    pub draw: usize,
    /// The number of the primitive in its mesh.
    pub primitive: usize,
    /// Its first triangle in the scene.
    pub first: u32,
    /// The vertices of its triangles, as numbers of its accessors' elements.
    pub corners: Vec<[u32; 3]>,
    /// The accessor of its positions.
    pub positions: usize,
    /// Elements of that accessor.
    pub vertices: u32,
    /// 1, or -1 if the transform mirrors: then triangles are wound clockwise as seen from their front.
    pub front: f64,
}

/// A mesh as a node has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Draw {
    /// The node.
    pub node: usize,
    /// The instance, of a node with instances.
    pub instance: Option<u32>,
    /// The mesh.
    pub mesh: usize,
}

/// All parts that have triangles, in their order in the scene, and the draws they belong to.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parts {
    /// The parts.
    pub all: Vec<Part>,
    /// The meshes that nodes have, also those without triangles.
    pub draws: Vec<Draw>,
}

impl Parts {
    /// The parts of `file`, whose scene is `scene` and whose objects are at `sources`.
    pub(crate) fn of(file: &File, scene: &Scene, sources: &[Source]) -> Result<Self, TexelsError> {
        let signs = mirrors(file);
        let mut parts = Self::default();
        let mut front = 1.0;
        for (object, source) in scene.objects().iter().zip(sources) {
            let [node, mesh, primitive] =
                [source.node, source.mesh, source.primitive].map(|i| i as usize);
            let draw = Draw {
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
            let given = primitive_of(file, mesh, primitive)
                .ok_or_else(|| file.broken(element.as_str(), "there is no such primitive"))?;
            let mut part = corners(file, given, &element)?;
            if part.corners.len() != object.count as usize {
                return Err(TexelsError::OtherScene {
                    file: file.name.clone(),
                    element,
                    reason: format!(
                        "it has {} triangles, the scene {}",
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

/// A primitive of a mesh.
pub(crate) fn primitive_of(file: &File, mesh: usize, primitive: usize) -> Option<&Value> {
    file.array("meshes")
        .get(mesh)?
        .get("primitives")?
        .get(primitive)
}

/// Replaces a primitive.
pub(crate) fn put_primitive(
    file: &mut File,
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

/// A primitive's triangles.
fn corners(file: &File, primitive: &Value, element: &str) -> Result<Part, TexelsError> {
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
    let positions = positions.ok_or_else(|| file.broken(element, "it has no positions"))?;
    let vertices = Elements::read(file, positions)?.count;
    let vertices =
        u32::try_from(vertices).map_err(|_| file.broken(element, "it has too many vertices"))?;
    let list: Vec<u32> = match member(primitive, "indices") {
        None => (0..vertices).collect(),
        Some(indices) => {
            let elements = Elements::read(file, indices)?;
            let indices: Option<Vec<u32>> = (0..elements.count)
                .map(|i| elements.index(i).filter(|v| *v < vertices))
                .collect();
            indices.ok_or_else(|| file.broken(element, "an index names no vertex"))?
        }
    };
    let corners = match primitive.get("mode").and_then(Value::as_u64).unwrap_or(4) {
        4 => list.as_chunks::<3>().0.to_vec(),
        // Every second triangle of a strip is turned, so that all wind the same way.
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
    Ok(Part {
        draw: 0,
        primitive: 0,
        first: 0,
        corners,
        positions,
        vertices,
        front: 1.0,
    })
}
