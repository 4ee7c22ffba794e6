//! Primitives with texture coordinates for the image.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::TexelsError;
use crate::accessor::Elements;
use crate::added;
use crate::atlas::Layout;
use crate::file::{File, member};
use crate::materials::{numbers_of, uses_set};
use crate::parts::{Part, primitive_of, put_primitive};

/// The attributes of a primitive.
fn attributes(primitive: &mut Value) -> Option<&mut Map<String, Value>> {
    primitive
        .get_mut("attributes")
        .and_then(Value::as_object_mut)
}

/// Gives a primitive its texture coordinates, and returns the number of the set.
///
/// That is `TEXCOORD_1`, unless a texture of its material uses what is there: then the next free one. glTF
/// wants sets to be numbered from 0 on, so where there is no `TEXCOORD_0` it becomes the same.
pub(crate) fn with_coordinates(
    file: &mut File,
    mesh: usize,
    part: &Part,
    layout: &Layout,
) -> Result<usize, TexelsError> {
    let primitive = primitive_of(file, mesh, part.primitive);
    let mut primitive = primitive.cloned().unwrap_or(Value::Null);
    let old = primitive
        .get("attributes")
        .and_then(|a| member(a, "TEXCOORD_1"));
    let coordinates = match layout {
        Layout::Kept => return Ok(1),
        Layout::Moved { scale, offset } => {
            let moved: Vec<[f32; 2]> = {
                let elements = Elements::read(file, old.unwrap_or(usize::MAX))?;
                let uv = |v: usize| {
                    Layout::moved(*scale, *offset, [0, 1].map(|c| elements.number(v, c)))
                };
                (0..elements.count).map(uv).collect()
            };
            added::coordinates(file, &moved)?
        }
        Layout::New { vertices, corners } => {
            let source_vertices: Vec<u32> = vertices.iter().map(|v| v.0).collect();
            let uv: Vec<[f32; 2]> = vertices.iter().map(|v| v.1).collect();
            gather(file, &mut primitive, &source_vertices)?;
            primitive["indices"] = json!(added::indices(file, corners, source_vertices.len())?);
            if primitive.get("mode").is_some() {
                primitive["mode"] = json!(4);
            }
            added::coordinates(file, &uv)?
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

/// Copies vertices: all attributes and morph targets of the primitive.
fn gather(file: &mut File, primitive: &mut Value, of: &[u32]) -> Result<(), TexelsError> {
    let mut known: BTreeMap<usize, usize> = BTreeMap::new();
    let mut replace = |value: &mut Value| -> Result<(), TexelsError> {
        if let Some(accessor) = value.as_u64().and_then(|n| usize::try_from(n).ok()) {
            let new = match known.get(&accessor) {
                Some(new) => *new,
                None => added::gathered(file, accessor, of)?,
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

/// Gives a primitive one attribute more.
pub(crate) fn put_attribute(
    file: &mut File,
    (mesh, primitive): (usize, usize),
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
