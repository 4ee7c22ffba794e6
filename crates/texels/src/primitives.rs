//! Changes of primitives: texture coordinates for the image, and added attributes.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::TexelsError;
use crate::accessor::CheckedElements;
use crate::added_accessors;
use crate::atlas::AtlasLayout;
use crate::file::{GltfParts, member};
use crate::materials::{numbers_of, uses_set};
use crate::parts::{PrimitiveInstance, primitive_of, put_primitive};

/// Returns the attributes of a primitive.
fn attributes(primitive: &mut Value) -> Option<&mut Map<String, Value>> {
    primitive
        .get_mut("attributes")
        .and_then(Value::as_object_mut)
}

/// Sets the texture coordinates of a primitive for the image, and returns the index N of their set
/// `TEXCOORD_N`.
///
/// The set is `TEXCOORD_1`, or the next free set if a texture of the primitive's material uses the existing
/// `TEXCOORD_1`. glTF requires that sets are numbered from 0. So if the set is `TEXCOORD_1` and `TEXCOORD_0`
/// does not exist, `TEXCOORD_0` gets the same coordinates.
pub(crate) fn with_coordinates(
    file: &mut GltfParts,
    mesh: usize,
    part: &PrimitiveInstance,
    layout: &AtlasLayout,
) -> Result<usize, TexelsError> {
    let primitive = primitive_of(file, mesh, part.primitive);
    let mut primitive = primitive.cloned().unwrap_or(Value::Null);
    let old = primitive
        .get("attributes")
        .and_then(|a| member(a, "TEXCOORD_1"));
    let coordinates = match layout {
        AtlasLayout::Kept => return Ok(1),
        AtlasLayout::Moved { scale, offset } => {
            let moved: Vec<[f32; 2]> = {
                let elements = CheckedElements::read(file, old.unwrap_or(usize::MAX))?;
                let uv = |v: usize| {
                    AtlasLayout::moved(*scale, *offset, [0, 1].map(|c| elements.number(v, c)))
                };
                (0..elements.count).map(uv).collect()
            };
            added_accessors::coordinates(file, &moved)?
        }
        AtlasLayout::New { vertices, corners } => {
            let source_vertices: Vec<u32> = vertices.iter().map(|v| v.0).collect();
            let uv: Vec<[f32; 2]> = vertices.iter().map(|v| v.1).collect();
            gather(file, &mut primitive, &source_vertices)?;
            primitive["indices"] = json!(added_accessors::indices(
                file,
                corners,
                source_vertices.len()
            )?);
            if primitive.get("mode").is_some() {
                primitive["mode"] = json!(4);
            }
            added_accessors::coordinates(file, &uv)?
        }
    };
    let used = old.is_some()
        && numbers_of(&primitive).any(|m| uses_set(file.array("materials").get(m), 1));
    let mut set = 1;
    if let Some(attributes) = attributes(&mut primitive) {
        while used && (set == 1 || attributes.contains_key(&format!("TEXCOORD_{set}"))) {
            set += 1;
        }
        if set == 1 && !attributes.contains_key("TEXCOORD_0") {
            attributes.insert("TEXCOORD_0".to_owned(), json!(coordinates));
        }
        attributes.insert(format!("TEXCOORD_{set}"), json!(coordinates));
    }
    put_primitive(file, mesh, part.primitive, primitive)?;
    Ok(set)
}

/// Replaces the accessors of a primitive's attributes and morph targets by accessors with copies of the
/// vertices whose indices `elements` lists.
fn gather(
    file: &mut GltfParts,
    primitive: &mut Value,
    elements: &[u32],
) -> Result<(), TexelsError> {
    let mut known: BTreeMap<usize, usize> = BTreeMap::new();
    let mut replace = |value: &mut Value| -> Result<(), TexelsError> {
        if let Some(accessor) = value.as_u64().and_then(|n| usize::try_from(n).ok()) {
            let new = match known.get(&accessor) {
                Some(new) => *new,
                None => added_accessors::gathered(file, accessor, elements)?,
            };
            known.insert(accessor, new);
            *value = json!(new);
        }
        Ok(())
    };
    let (mut all, mut targets) = (Vec::new(), Vec::new());
    if let Some(members) = primitive.as_object_mut() {
        for (key, value) in members.iter_mut() {
            match (key.as_str(), value) {
                ("attributes", Value::Object(of)) => all.extend(of.values_mut()),
                ("targets", Value::Array(of)) => {
                    targets.extend(of.iter_mut().filter_map(Value::as_object_mut))
                }
                _ => {}
            }
        }
    }
    all.extend(targets.into_iter().flat_map(Map::values_mut));
    all.into_iter().try_for_each(&mut replace)
}

/// Sets attribute `name` of a primitive to the accessor with index `accessor`.
pub(crate) fn put_attribute(
    file: &mut GltfParts,
    mesh: usize,
    primitive: usize,
    name: &str,
    accessor: usize,
) -> Result<(), TexelsError> {
    let mut new = primitive_of(file, mesh, primitive)
        .cloned()
        .unwrap_or(Value::Null);
    if let Some(attributes) = attributes(&mut new) {
        attributes.insert(name.to_owned(), json!(accessor));
    }
    put_primitive(file, mesh, primitive, new)
}
