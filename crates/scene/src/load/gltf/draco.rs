//! Primitives compressed with KHR_draco_mesh_compression: their indices and attributes, decoded once.
//!
//! The accessors of such a primitive specify the type and number of the elements, and the decoded data
//! replace their buffer views, if any. An attribute that the extension does not list is read from its
//! accessor as usual. The decoder is the crate `draco-core`. The numbers of elements of the accessors limit
//! the size of the decoded data, because a few bytes can represent millions of vertices.

use std::collections::{BTreeMap, BTreeSet};

use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointIndex};

use super::buffers::Buffers;
use super::component::Component;
use super::json;
use super::source::GltfContext;
use super::uses::{AccessorRole, AccessorUse, AccessorUser};
use crate::SceneError;

/// Maximum number of bytes of a vertex with all its attributes: 64 numbers of 8 bytes.
const MOST_VERTEX_BYTES: u64 = 512;
/// The maximum number of decoded bytes per triangle of the triangle limit, for all primitives together: three
/// vertices with positions, texture coordinates and colours, and their indices.
const MOST_TRIANGLE_BYTES: u64 = 3 * (12 + 8 + 16 + 4);

/// The decoded elements of an accessor, without gaps.
pub(super) struct DecodedElements {
    pub(super) bytes: Vec<u8>,
    pub(super) component: Component,
    pub(super) count: u64,
    /// The buffer view and the attribute that the elements were decoded from. Indices have no attribute.
    from: (usize, Option<u32>),
}

/// The elements of all accessors that compressed primitives need, by role and index.
pub(super) struct DecodedAccessors {
    elements: BTreeMap<(usize, usize), DecodedElements>,
    /// The number of bytes that may still be decoded.
    left: u64,
}

impl DecodedAccessors {
    /// Decodes the compressed primitives of the meshes in `uses`.
    pub(super) fn read(
        source: &GltfContext<'_>,
        root: &json::Root,
        buffers: &Buffers<'_>,
        uses: &[AccessorUse],
    ) -> Result<Self, SceneError> {
        let left = u64::from(source.limits.triangles) * MOST_TRIANGLE_BYTES;
        let mut this = Self {
            elements: BTreeMap::new(),
            left,
        };
        let drawn: BTreeSet<usize> = uses.iter().filter_map(|u| u.by.mesh()).collect();
        let roles: BTreeSet<(usize, usize)> =
            uses.iter().map(|u| (u.role as usize, u.accessor)).collect();
        for mesh in drawn {
            for (primitive, p) in root.meshes[mesh].primitives.iter().enumerate() {
                let Some(draco) = p.draco() else { continue };
                let by = AccessorUser::Primitive { mesh, primitive };
                let element = format!("{by}, KHR_draco_mesh_compression");
                this.add(
                    root,
                    p,
                    draco,
                    buffers.view(source, root, draco.buffer_view)?,
                    &roles,
                    source,
                )
                .map_err(|why| source.bad(element, why))?;
            }
        }
        Ok(this)
    }

    /// Returns the decoded elements of an accessor, or `None` if the accessor is not compressed.
    pub(super) fn get(&self, role: AccessorRole, accessor: usize) -> Option<&DecodedElements> {
        self.elements.get(&(role as usize, accessor))
    }

    /// Decodes primitive `p` from `bytes`, and adds the elements of its accessors.
    fn add(
        &mut self,
        root: &json::Root,
        p: &json::Primitive,
        draco: &json::Draco,
        bytes: &[u8],
        roles: &BTreeSet<(usize, usize)>,
        source: &GltfContext<'_>,
    ) -> Result<(), String> {
        if p.mode.unwrap_or(4) != 4 {
            return Err(
                "the mode of the primitive must be 4 (triangles), the only supported mode"
                    .to_owned(),
            );
        }
        let indices = p.indices.ok_or("the primitive has no indices")?;
        let position = p
            .attributes
            .position
            .ok_or("the primitive has no POSITION")?;
        let wanted = || {
            let read = draco
                .attributes
                .iter()
                .filter_map(|(name, id)| Some((named(&p.attributes, name)?, *id)));
            read.filter(|((role, a), _)| roles.contains(&(*role as usize, *a)))
        };
        // Several primitives may share all of their data.
        let has = |role, accessor, from| {
            self.get(role, accessor)
                .is_some_and(|e: &DecodedElements| e.from == from)
        };
        if has(AccessorRole::Indices, indices, (draco.buffer_view, None))
            && wanted().all(|((role, a), id)| has(role, a, (draco.buffer_view, Some(id))))
        {
            return Ok(());
        }
        let count = |a: usize| root.accessors.get(a).map_or(0, |a| a.count);
        let limits = DecodeLimits::default()
            .with_max_faces((count(indices) / 3).min(u64::from(source.limits.triangles)))
            .with_max_points(count(position).min(3 * u64::from(source.limits.triangles)))
            .with_max_decoded_bytes(
                count(position)
                    .saturating_mul(MOST_VERTEX_BYTES)
                    .min(self.left),
            );
        let mut mesh = Mesh::new();
        MeshDecoder::new()
            .decode(
                &mut DecoderBuffer::new(bytes).with_limits(limits),
                &mut mesh,
            )
            .map_err(|e| format!("the compressed data cannot be decoded: {e}"))?;
        let corners = mesh.faces().iter().flatten();
        let elements = DecodedElements {
            bytes: corners.flat_map(|point| point.0.to_le_bytes()).collect(),
            component: Component::U32,
            count: mesh.num_faces() as u64 * 3,
            from: (draco.buffer_view, None),
        };
        self.insert(
            AccessorRole::Indices,
            indices,
            elements,
            root.accessors.get(indices),
        )?;
        for ((role, accessor), id) in wanted() {
            let elements = attribute(&mesh, id, root, role, accessor, draco.buffer_view)
                .map_err(|why| format!("attribute {id}: {why}"))?;
            self.insert(role, accessor, elements, root.accessors.get(accessor))?;
        }
        Ok(())
    }

    fn insert(
        &mut self,
        role: AccessorRole,
        accessor: usize,
        elements: DecodedElements,
        given: Option<&json::Accessor>,
    ) -> Result<(), String> {
        let (count, sparse) = given.map_or((0, false), |a| (a.count, a.sparse.is_some()));
        if elements.count != count {
            return Err(format!(
                "accessor {accessor} has {count} elements, but {} were decoded",
                elements.count
            ));
        }
        if sparse {
            return Err(format!(
                "accessor {accessor} is sparse, but its primitive is compressed"
            ));
        }
        let bytes = elements.bytes.len() as u64;
        self.left = self
            .left
            .checked_sub(bytes)
            .ok_or("together, the compressed primitives are too large")?;
        let before = self
            .elements
            .get(&(role as usize, accessor))
            .map(|e| e.from);
        if before.is_some_and(|from| from != elements.from) {
            return Err(format!(
                "accessor {accessor} belongs to another compressed primitive as well"
            ));
        }
        self.elements.insert((role as usize, accessor), elements);
        Ok(())
    }
}

/// Returns the role and the accessor index of the attribute `name`, or `None` if the loader does not read
/// this attribute.
fn named(attributes: &json::Attributes, name: &str) -> Option<(AccessorRole, usize)> {
    match name {
        "POSITION" => Some((AccessorRole::Positions, attributes.position?)),
        "COLOR_0" => Some((AccessorRole::Colors, attributes.color_0?)),
        _ => {
            let set = name.strip_prefix("TEXCOORD_")?.parse().ok()?;
            Some((AccessorRole::Coordinates, attributes.coordinates(set)?))
        }
    }
}

/// Returns the attribute `id` of a decoded mesh, one element for each point.
fn attribute(
    mesh: &Mesh,
    id: u32,
    root: &json::Root,
    role: AccessorRole,
    accessor: usize,
    view: usize,
) -> Result<DecodedElements, String> {
    let found = mesh
        .attribute_by_unique_id(id)
        .ok_or_else(|| format!("the compressed data have no attribute {id}"))?;
    let component = match found.data_type() {
        DataType::Int8 => Component::I8,
        DataType::Uint8 => Component::U8,
        DataType::Int16 => Component::I16,
        DataType::Uint16 => Component::U16,
        DataType::Uint32 => Component::U32,
        DataType::Float32 => Component::F32,
        other => return Err(format!("glTF has no components of type {other:?}")),
    };
    let (_, components) = role.shape();
    let given = root
        .accessors
        .get(accessor)
        .and_then(|a| Component::from_number(a.component_type));
    if given != Some(component) || u64::from(found.num_components()) != components {
        let n = found.num_components();
        return Err(format!(
            "{n} components of type {component:?} do not fit accessor {accessor}"
        ));
    }
    let size = (component.size() * components) as usize;
    let data = found.buffer().data();
    let stride = usize::try_from(found.byte_stride()).map_err(|_| "the stride is negative")?;
    let mut bytes = Vec::with_capacity(mesh.num_points().saturating_mul(size));
    for point in 0..mesh.num_points() as u32 {
        let value = found.mapped_index(PointIndex(point)).0 as usize;
        let at = value
            .checked_mul(stride)
            .and_then(|at| data.get(at..)?.get(..size));
        bytes.extend_from_slice(
            at.ok_or_else(|| format!("the attribute has no value for vertex {point}"))?,
        );
    }
    Ok(DecodedElements {
        bytes,
        component,
        count: mesh.num_points() as u64,
        from: (view, Some(id)),
    })
}
