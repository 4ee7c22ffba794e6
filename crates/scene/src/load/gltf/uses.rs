//! The accessors that the drawn geometry needs, and the modes of primitives.

use super::json;
use super::kinds::{self, Material};
use super::nodes::PlacedMesh;
use super::source::GltfContext;
use crate::SceneError;

/// The uses of an accessor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AccessorRole {
    Positions = 0,
    Indices = 1,
    /// The translations and scales of instances.
    Offsets = 2,
    /// The rotations of instances.
    Rotations = 3,
    /// The texture coordinates of masked primitives.
    Coordinates = 4,
    /// The vertex colours with alpha of masked primitives.
    Colors = 5,
}

impl AccessorRole {
    /// The number of roles.
    pub(super) const COUNT: usize = 6;

    /// Returns the type of an accessor in this role, and the number of its components.
    pub(super) fn shape(self) -> (&'static str, u64) {
        match self {
            Self::Positions | Self::Offsets => ("VEC3", 3),
            Self::Indices => ("SCALAR", 1),
            Self::Coordinates => ("VEC2", 2),
            Self::Rotations | Self::Colors => ("VEC4", 4),
        }
    }
}

/// The modes of a primitive (glTF 2.0, section 3.7.2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PrimitiveMode {
    /// Points, lines, line strips and line loops, which have no surface.
    NoSurface,
    Triangles,
    Strip,
    Fan,
}

/// An accessor that the drawn geometry needs, and its first user.
#[derive(Clone, Copy, Debug)]
pub(super) struct AccessorUse {
    pub(super) accessor: usize,
    pub(super) role: AccessorRole,
    pub(super) by: AccessorUser,
}

/// The element that needs an accessor.
#[derive(Clone, Copy, Debug)]
pub(super) enum AccessorUser {
    Primitive { mesh: usize, primitive: usize },
    Instances { node: usize },
}

impl AccessorUser {
    /// Returns the mesh if the user is a primitive.
    pub(super) fn mesh(self) -> Option<usize> {
        match self {
            Self::Primitive { mesh, .. } => Some(mesh),
            Self::Instances { .. } => None,
        }
    }
}

impl std::fmt::Display for AccessorUser {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Primitive { mesh, primitive } => write!(f, "mesh {mesh}, primitive {primitive}"),
            Self::Instances { node } => write!(f, "node {node}, EXT_mesh_gpu_instancing"),
        }
    }
}

/// Lists every accessor that the placed meshes `draws` need, once for each role, in the order of meshes.
pub(super) fn uses(
    source: &GltfContext<'_>,
    root: &json::Root,
    draws: &[PlacedMesh],
    materials: &[Material],
) -> Result<Vec<AccessorUse>, SceneError> {
    let mut drawn = vec![false; root.meshes.len()];
    for d in draws {
        drawn[d.mesh] = true;
    }
    let mut met: [Vec<bool>; AccessorRole::COUNT] =
        std::array::from_fn(|_| vec![false; root.accessors.len()]);
    let mut uses = Vec::new();
    let mut add = |accessor: usize, role: AccessorRole, by: AccessorUser| match met[role as usize]
        .get_mut(accessor)
    {
        Some(met) => {
            if !std::mem::replace(met, true) {
                uses.push(AccessorUse { accessor, role, by });
            }
            Ok(())
        }
        None => {
            let reason = format!(
                "accessor {accessor} does not exist, because the file has {} accessors",
                root.accessors.len()
            );
            Err(source.bad(by.to_string(), reason))
        }
    };
    for (mesh, m) in root.meshes.iter().enumerate().filter(|(m, _)| drawn[*m]) {
        for (primitive, p) in m.primitives.iter().enumerate() {
            let by = AccessorUser::Primitive { mesh, primitive };
            let Some(position) = surface(p).map_err(|why| source.bad(by.to_string(), why))? else {
                continue;
            };
            add(position, AccessorRole::Positions, by)?;
            if let Some(indices) = p.indices {
                add(indices, AccessorRole::Indices, by)?;
            }
            let Some(alpha) = kinds::alpha_of(p, materials) else {
                continue;
            };
            if let Some(coordinates) = alpha
                .texture
                .and_then(|_| p.attributes.coordinates(alpha.set))
            {
                add(coordinates, AccessorRole::Coordinates, by)?;
            }
            let with_alpha = |c: &usize| root.accessors.get(*c).is_none_or(|a| a.shape == "VEC4");
            if let Some(colors) = p.attributes.color_0.filter(with_alpha) {
                add(colors, AccessorRole::Colors, by)?;
            }
        }
    }
    for draw in draws {
        let Some(attributes) = root.nodes[draw.node].instances() else {
            continue;
        };
        let by = AccessorUser::Instances { node: draw.node };
        for offsets in [attributes.translation, attributes.scale]
            .into_iter()
            .flatten()
        {
            add(offsets, AccessorRole::Offsets, by)?;
        }
        if let Some(rotation) = attributes.rotation {
            add(rotation, AccessorRole::Rotations, by)?;
        }
    }
    Ok(uses)
}

pub(super) fn mode(p: &json::Primitive) -> Result<PrimitiveMode, String> {
    Ok(match p.mode.unwrap_or(4) {
        0..=3 => PrimitiveMode::NoSurface,
        4 => PrimitiveMode::Triangles,
        5 => PrimitiveMode::Strip,
        6 => PrimitiveMode::Fan,
        other => return Err(format!("the mode is {other}, but modes are 0 to 6")),
    })
}

/// Returns the index of the accessor of the positions, or `None` if the primitive has no surface or no
/// positions.
pub(super) fn surface(p: &json::Primitive) -> Result<Option<usize>, String> {
    Ok(if mode(p)? == PrimitiveMode::NoSurface {
        None
    } else {
        p.attributes.position
    })
}
