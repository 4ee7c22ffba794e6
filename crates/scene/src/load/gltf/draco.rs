//! Primitives compressed with KHR_draco_mesh_compression: their indices and attributes, decoded once.
//!
//! The accessors of such a primitive give type and number of the elements, and the decoded data replaces
//! their buffer views, if they have any. An attribute that the extension does not list is read from its
//! accessor as ever. The decoder is the crate `draco-core`; what it may produce is limited by the numbers of
//! the accessors, because a few bytes can stand for millions of vertices.

use std::collections::{BTreeMap, BTreeSet};

use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointIndex};

use super::buffers::Buffers;
use super::component::Component;
use super::json;
use super::source::GltfContext;
use super::uses::{Role, Use, User};
use crate::SceneError;

/// Most bytes of a vertex with all its attributes: 64 numbers of 8 bytes.
const MOST_VERTEX_BYTES: u64 = 512;
/// Decoded bytes for each triangle that a scene may have, all primitives together: three vertices with
/// positions, texture coordinates and colours, and their indices.
const MOST_TRIANGLE_BYTES: u64 = 3 * (12 + 8 + 16 + 4);

/// The decoded elements of an accessor, without gaps.
pub(super) struct Elements {
    pub(super) bytes: Vec<u8>,
    pub(super) component: Component,
    pub(super) count: u64,
    /// The buffer view and the attribute they were decoded from; no attribute for indices.
    from: (usize, Option<u32>),
}

/// The elements of all accessors that compressed primitives need, by role and number.
pub(super) struct Decoded {
    elements: BTreeMap<(usize, usize), Elements>,
    /// Bytes that may still be decoded.
    left: u64,
}

impl Decoded {
    /// Decodes the compressed primitives among the users in `uses`.
    pub(super) fn read(
        source: &GltfContext<'_>,
        root: &json::Root,
        buffers: &Buffers<'_>,
        uses: &[Use],
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
                let Some(of) = p.draco() else { continue };
                let by = User::Primitive { mesh, primitive };
                let element = format!("{by}, KHR_draco_mesh_compression");
                this.add(
                    root,
                    (p, of),
                    buffers.view(source, root, of.buffer_view)?,
                    &roles,
                    source,
                )
                .map_err(|why| source.bad(element, why))?;
            }
        }
        Ok(this)
    }

    /// The decoded elements of an accessor; `None` when it is not compressed.
    pub(super) fn get(&self, role: Role, accessor: usize) -> Option<&Elements> {
        self.elements.get(&(role as usize, accessor))
    }

    fn add(
        &mut self,
        root: &json::Root,
        (p, of): (&json::Primitive, &json::Draco),
        bytes: &[u8],
        roles: &BTreeSet<(usize, usize)>,
        source: &GltfContext<'_>,
    ) -> Result<(), String> {
        if p.mode.unwrap_or(4) != 4 {
            return Err(
                "its mode must be 4 (triangles), which is what compression makes".to_owned(),
            );
        }
        let indices = p.indices.ok_or("the primitive has no indices")?;
        let position = p
            .attributes
            .position
            .ok_or("the primitive has no POSITION")?;
        let wanted = || {
            let read = of
                .attributes
                .iter()
                .filter_map(|(name, id)| Some((named(&p.attributes, name)?, *id)));
            read.filter(|((role, a), _)| roles.contains(&(*role as usize, *a)))
        };
        // Primitives may share all of it.
        let has = |role, accessor, from| {
            self.get(role, accessor)
                .is_some_and(|e: &Elements| e.from == from)
        };
        if has(Role::Indices, indices, (of.buffer_view, None))
            && wanted().all(|((role, a), id)| has(role, a, (of.buffer_view, Some(id))))
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
            .map_err(|e| format!("it cannot be decoded: {e}"))?;
        let corners = mesh.faces().iter().flatten();
        let elements = Elements {
            bytes: corners.flat_map(|point| point.0.to_le_bytes()).collect(),
            component: Component::U32,
            count: mesh.num_faces() as u64 * 3,
            from: (of.buffer_view, None),
        };
        self.insert(
            (Role::Indices, indices),
            elements,
            root.accessors.get(indices),
        )?;
        for ((role, accessor), id) in wanted() {
            let elements = attribute(&mesh, id, root, (role, accessor), of.buffer_view)
                .map_err(|why| format!("attribute {id}: {why}"))?;
            self.insert((role, accessor), elements, root.accessors.get(accessor))?;
        }
        Ok(())
    }

    fn insert(
        &mut self,
        (role, accessor): (Role, usize),
        elements: Elements,
        given: Option<&json::Accessor>,
    ) -> Result<(), String> {
        let (count, sparse) = given.map_or((0, false), |a| (a.count, a.sparse.is_some()));
        if elements.count != count {
            return Err(format!(
                "accessor {accessor} has {count} elements, and {} were decoded",
                elements.count
            ));
        }
        if sparse {
            return Err(format!(
                "accessor {accessor} is sparse, which a compressed one cannot be"
            ));
        }
        let bytes = elements.bytes.len() as u64;
        self.left = self
            .left
            .checked_sub(bytes)
            .ok_or("the compressed primitives are too large together")?;
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

/// The role and the accessor of an attribute by its name; `None` for one that is not read.
fn named(attributes: &json::Attributes, name: &str) -> Option<(Role, usize)> {
    match name {
        "POSITION" => Some((Role::Positions, attributes.position?)),
        "COLOR_0" => Some((Role::Colors, attributes.color_0?)),
        _ => {
            let set = name.strip_prefix("TEXCOORD_")?.parse().ok()?;
            Some((Role::Coordinates, attributes.coordinates(set)?))
        }
    }
}

/// An attribute of a decoded mesh, one element for each point.
fn attribute(
    mesh: &Mesh,
    id: u32,
    root: &json::Root,
    (role, accessor): (Role, usize),
    view: usize,
) -> Result<Elements, String> {
    let found = mesh
        .attribute_by_unique_id(id)
        .ok_or_else(|| format!("there is no attribute {id}"))?;
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
    let stride = usize::try_from(found.byte_stride()).map_err(|_| "its stride is negative")?;
    let mut bytes = Vec::with_capacity(mesh.num_points().saturating_mul(size));
    for point in 0..mesh.num_points() as u32 {
        let value = found.mapped_index(PointIndex(point)).0 as usize;
        let at = value
            .checked_mul(stride)
            .and_then(|at| data.get(at..)?.get(..size));
        bytes.extend_from_slice(at.ok_or_else(|| format!("it has no value for vertex {point}"))?);
    }
    Ok(Elements {
        bytes,
        component,
        count: mesh.num_points() as u64,
        from: (view, Some(id)),
    })
}
