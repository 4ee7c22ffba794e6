//! The accessors that drawn geometry needs, and the modes of primitives.

use super::json;
use super::kinds::{self, Material};
use super::nodes::Draw;
use super::source::GltfContext;
use crate::SceneError;

/// The uses of an accessor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Positions = 0,
    Indices = 1,
    /// Translations and scales of instances.
    Offsets = 2,
    /// Rotations of instances.
    Rotations = 3,
    /// Texture coordinates of masked primitives.
    Coordinates = 4,
    /// Vertex colours with alpha of masked primitives.
    Colors = 5,
}

impl Role {
    /// The number of roles.
    pub(super) const COUNT: usize = 6;

    /// The type of an accessor in this role, and the number of its components.
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
pub(super) enum Mode {
    /// Points and lines of any kind: no surface.
    NoSurface,
    Triangles,
    Strip,
    Fan,
}

/// An accessor that drawn geometry needs, and where it is first needed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Use {
    pub(super) accessor: usize,
    pub(super) role: Role,
    pub(super) by: User,
}

/// The element that needs an accessor.
#[derive(Clone, Copy, Debug)]
pub(super) enum User {
    Primitive { mesh: usize, primitive: usize },
    Instances { node: usize },
}

impl User {
    /// The mesh of a primitive.
    pub(super) fn mesh(self) -> Option<usize> {
        match self {
            Self::Primitive { mesh, .. } => Some(mesh),
            Self::Instances { .. } => None,
        }
    }
}

impl std::fmt::Display for User {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Primitive { mesh, primitive } => write!(f, "mesh {mesh}, primitive {primitive}"),
            Self::Instances { node } => write!(f, "node {node}, EXT_mesh_gpu_instancing"),
        }
    }
}

/// Every accessor that `draws` need, once for each role, in the order of meshes.
pub(super) fn uses(
    source: &GltfContext<'_>,
    root: &json::Root,
    draws: &[Draw],
    materials: &[Material],
) -> Result<Vec<Use>, SceneError> {
    let mut drawn = vec![false; root.meshes.len()];
    for d in draws {
        drawn[d.mesh] = true;
    }
    let mut met: [Vec<bool>; Role::COUNT] =
        std::array::from_fn(|_| vec![false; root.accessors.len()]);
    let mut uses = Vec::new();
    let mut add = |accessor: usize, role: Role, by: User| match met[role as usize].get_mut(accessor)
    {
        Some(met) => {
            if !std::mem::replace(met, true) {
                uses.push(Use { accessor, role, by });
            }
            Ok(())
        }
        None => {
            let reason = format!("it names accessor {accessor} of {}", root.accessors.len());
            Err(source.bad(by.to_string(), reason))
        }
    };
    for (mesh, m) in root.meshes.iter().enumerate().filter(|(m, _)| drawn[*m]) {
        for (primitive, p) in m.primitives.iter().enumerate() {
            let by = User::Primitive { mesh, primitive };
            let Some(position) = surface(p).map_err(|why| source.bad(by.to_string(), why))? else {
                continue;
            };
            add(position, Role::Positions, by)?;
            if let Some(indices) = p.indices {
                add(indices, Role::Indices, by)?;
            }
            let Some(alpha) = kinds::alpha_of(p, materials) else {
                continue;
            };
            if let Some(coordinates) = alpha
                .texture
                .and_then(|_| p.attributes.coordinates(alpha.set))
            {
                add(coordinates, Role::Coordinates, by)?;
            }
            let with_alpha = |c: &usize| root.accessors.get(*c).is_none_or(|a| a.shape == "VEC4");
            if let Some(colors) = p.attributes.color_0.filter(with_alpha) {
                add(colors, Role::Colors, by)?;
            }
        }
    }
    for draw in draws {
        let Some(attributes) = root.nodes[draw.node].instances() else {
            continue;
        };
        let by = User::Instances { node: draw.node };
        for offsets in [attributes.translation, attributes.scale]
            .into_iter()
            .flatten()
        {
            add(offsets, Role::Offsets, by)?;
        }
        if let Some(rotation) = attributes.rotation {
            add(rotation, Role::Rotations, by)?;
        }
    }
    Ok(uses)
}

pub(super) fn mode(p: &json::Primitive) -> Result<Mode, String> {
    Ok(match p.mode.unwrap_or(4) {
        0..=3 => Mode::NoSurface,
        4 => Mode::Triangles,
        5 => Mode::Strip,
        6 => Mode::Fan,
        other => return Err(format!("its mode is {other}, and modes are 0 to 6")),
    })
}

/// The accessor of the positions, when the primitive has a surface at all.
pub(super) fn surface(p: &json::Primitive) -> Result<Option<usize>, String> {
    Ok(if mode(p)? == Mode::NoSurface {
        None
    } else {
        p.attributes.position
    })
}
