//! The kinds and sides of a glTF file's triangles: from materials, animations, skins and extras.
//!
//! - A material with `alphaMode` MASK or BLEND, or with transmission, is see-through. A material with MASK is
//!   masked instead if alpha textures are read.
//! - A skinned mesh is moving. The mesh of a node is moving if an animation moves, shows or hides the node or
//!   one of its ancestors.
//! - `extras.sightline` with the fields `blocks` and `shows` has precedence over materials, skins and
//!   animations. For each field, the extras nearest to the triangles apply: the extras of the material, then
//!   of the mesh, the node, and the node's ancestors.
//! - The mesh of a hidden node is hidden, regardless of other properties in the file.

use serde_json::Value;

use super::alpha::{Alpha, MASK};
use super::json;
use super::source::{GltfContext, VISIBILITY};
use crate::kinds::SurfaceKind;
use crate::load::marks::{Mark, Marks};

/// The fields of `extras.sightline`. A missing field is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Extras {
    blocks: Option<bool>,
    shows: Option<bool>,
}

impl Extras {
    /// Returns these fields, and the fields of `outer` in place of missing fields.
    pub(super) fn or(self, outer: Self) -> Self {
        Self {
            blocks: self.blocks.or(outer.blocks),
            shows: self.shows.or(outer.shows),
        }
    }

    /// Reads the fields of an element's extras. `element` returns the element's name in warnings.
    pub(super) fn read(
        extras: Option<&Value>,
        element: impl Fn() -> String,
        marks: &mut Marks,
    ) -> Self {
        let mut out = Self::default();
        let Some(own) = extras.and_then(|e| e.get("sightline")) else {
            return out;
        };
        let Some(fields) = own.as_object() else {
            marks.warn(format!(
                "{}: extras.sightline is not an object; give {{\"blocks\": …, \"shows\": …}}",
                element()
            ));
            return out;
        };
        for (key, value) in fields {
            let field = match key.as_str() {
                "blocks" => &mut out.blocks,
                "shows" => &mut out.shows,
                _ => {
                    let shown: String = key.chars().take(40).collect();
                    marks.warn(format!(
                        "{}: extras.sightline has the unknown field {shown:?}; valid fields are blocks \
                         and shows",
                        element()
                    ));
                    continue;
                }
            };
            *field = value.as_bool();
            if field.is_none() {
                marks.warn(format!(
                    "{}: extras.sightline.{key} is neither true nor false, and is ignored",
                    element()
                ));
            }
        }
        out
    }
}

/// The properties of a material that determine the kind and the sides of its triangles.
pub(super) struct Material {
    pub(super) name: String,
    /// The material's index and name, for errors.
    pub(super) label: String,
    pub(super) double_sided: bool,
    see_through: Option<&'static str>,
    /// The alpha properties of a material with `alphaMode` MASK, or a description of their fault. `None` for
    /// other materials, and if textures are not read.
    pub(super) alpha: Option<Result<Alpha, String>>,
    extras: Extras,
}

/// Reads the materials of a file.
pub(super) fn materials(
    source: &GltfContext<'_>,
    root: &json::Root,
    marks: &mut Marks,
) -> Vec<Material> {
    let materials = root.materials.iter().enumerate();
    materials
        .map(|(number, m)| {
            let factor = |extension: &str, factor: &str| -> bool {
                let given = m
                    .get("extensions")
                    .and_then(|e| e.get(extension))
                    .and_then(|e| e.get(factor));
                given.and_then(Value::as_f64).is_some_and(|f| f > 0.0)
            };
            let see_through = match m.get("alphaMode").and_then(Value::as_str) {
                Some("MASK") => Some(MASK),
                Some("BLEND") => Some("alphaMode BLEND"),
                _ if factor("KHR_materials_transmission", "transmissionFactor") => {
                    Some("KHR_materials_transmission")
                }
                _ if factor(
                    "KHR_materials_diffuse_transmission",
                    "diffuseTransmissionFactor",
                ) =>
                {
                    Some("KHR_materials_diffuse_transmission")
                }
                _ => None,
            };
            let name = m
                .get("name")
                .and_then(Value::as_str)
                .unwrap_or_default()
                .to_owned();
            let extras = Extras::read(m.get("extras"), || format!("material {number}"), marks);
            let masked = source.alpha_textures && see_through == Some(MASK);
            let label = match name.as_str() {
                "" => format!("material {number}"),
                name => format!(
                    "material {number} ({})",
                    name.chars().take(80).collect::<String>()
                ),
            };
            let double_sided = m.get("doubleSided").and_then(Value::as_bool) == Some(true);
            let alpha = masked.then(|| Alpha::read(m));
            Material {
                name,
                label,
                double_sided,
                see_through,
                alpha,
                extras,
            }
        })
        .collect()
}

/// The properties of a node that animations change.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Animations {
    /// True if an animation changes the transform of the node or another property besides its visibility.
    moves: bool,
    /// True if an animation shows or hides the node.
    pub(super) visibility: bool,
}

impl Animations {
    /// Returns true if an animation changes the node.
    pub(super) fn any(self) -> bool {
        self.moves || self.visibility
    }
}

/// Returns the properties that animations change, for each node. The result does not include changes that
/// descendants inherit from a node.
pub(super) fn animations(root: &json::Root) -> Vec<Animations> {
    let mut all = vec![Animations::default(); root.nodes.len()];
    let channels = root
        .animations
        .iter()
        .filter_map(|a| a.get("channels")?.as_array())
        .flatten();
    for target in channels.filter_map(|c| c.get("target")) {
        let pointer = || {
            let pointer = target
                .get("extensions")?
                .get("KHR_animation_pointer")?
                .get("pointer")?
                .as_str()?;
            let path = pointer.strip_prefix("/nodes/")?;
            let (node, property) = path.split_once('/').unwrap_or((path, ""));
            let visibility = property
                .strip_prefix("extensions/")
                .and_then(|p| p.strip_prefix(VISIBILITY));
            Some((node.parse::<u64>().ok()?, visibility.is_some()))
        };
        let target = target
            .get("node")
            .and_then(Value::as_u64)
            .map(|node| (node, false))
            .or_else(pointer);
        let Some((node, visibility)) = target else {
            continue;
        };
        if let Some(of) = usize::try_from(node).ok().and_then(|n| all.get_mut(n)) {
            of.moves |= !visibility;
            of.visibility |= visibility;
        }
    }
    all
}

/// Returns the material of a primitive, or `None` if the primitive refers to no existing material.
pub(super) fn material_of<'a>(
    primitive: &json::Primitive,
    materials: &'a [Material],
    label: impl Fn() -> String,
    marks: &mut Marks,
) -> Option<&'a Material> {
    let given = primitive.material.as_ref()?;
    let found = given
        .as_u64()
        .and_then(|m| materials.get(usize::try_from(m).ok()?));
    if found.is_none() {
        marks.warn(format!(
            "{}: the primitive refers to material {given}, but the file has {} materials",
            label(),
            materials.len()
        ));
    }
    found
}

/// Returns the alpha properties of a primitive's material, if textures are read and the material has a mask.
pub(super) fn alpha_of<'a>(
    primitive: &json::Primitive,
    materials: &'a [Material],
) -> Option<&'a Alpha> {
    let number = primitive.material.as_ref()?.as_u64()?;
    materials
        .get(usize::try_from(number).ok()?)?
        .alpha
        .as_ref()?
        .as_ref()
        .ok()
}

/// Returns the mark of a primitive's triangles, which has [`SurfaceKind::Masked`] if their mask must be read.
///
/// `node` contains the extras of the node and its ancestors.
pub(super) fn mark(
    skinned: bool,
    animated: bool,
    node: Extras,
    mesh: Extras,
    material: Option<&Material>,
) -> Mark {
    let file = if skinned {
        Mark::new(SurfaceKind::Moving, "skinned mesh")
    } else if animated {
        Mark::new(SurfaceKind::Moving, "animated node")
    } else if let Some((m, reason)) = material.and_then(|m| Some((m, m.see_through?))) {
        Mark::new(
            if m.alpha.is_some() {
                SurfaceKind::Masked
            } else {
                SurfaceKind::SeeThrough
            },
            reason,
        )
    } else {
        Mark::DEFAULT
    };
    let extras = material
        .map(|m| m.extras)
        .unwrap_or_default()
        .or(mesh)
        .or(node);
    // Extras that do not set `blocks`, and do not set `shows` to false, are compatible with a mask.
    let masked =
        file.kind == SurfaceKind::Masked && extras.blocks.is_none() && extras.shows != Some(false);
    if extras == Extras::default() || masked {
        return file;
    }
    let (blocks, shows) = (
        extras.blocks.unwrap_or(file.kind.blocks()),
        extras.shows.unwrap_or(file.kind.shows()),
    );
    Mark::new(SurfaceKind::new(blocks, shows), "extras.sightline")
}
