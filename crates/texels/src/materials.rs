//! Materials with an occlusion texture. Primitives that get none keep the materials that they have.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};

use crate::TexelsError;
use crate::file::{File, member};
use crate::parts::{primitive_of, put_primitive};

/// Materials that an application may choose from (KHR_materials_variants).
const VARIANTS: &str = "KHR_materials_variants";

/// A primitive of a mesh, and the set of texture coordinates for its occlusion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Use {
    /// The mesh.
    pub mesh: usize,
    /// The primitive.
    pub primitive: usize,
    /// The number of the set.
    pub set: usize,
}

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Done {
    /// Materials that were added: for primitives without one, and copies.
    pub added: usize,
    /// Occlusion textures that were replaced.
    pub replaced: usize,
}

/// The variants of a primitive.
fn variants(primitive: &Value) -> impl Iterator<Item = &Value> {
    let mappings = primitive
        .get("extensions")
        .and_then(|e| e.get(VARIANTS))
        .and_then(|v| v.get("mappings"));
    mappings.and_then(Value::as_array).into_iter().flatten()
}

/// The materials of a primitive: its own, and those of its variants.
pub(crate) fn numbers_of(primitive: &Value) -> impl Iterator<Item = usize> {
    member(primitive, "material")
        .into_iter()
        .chain(variants(primitive).filter_map(|v| member(v, "material")))
}

/// Whether a texture of a material, other than its occlusion, has this set of coordinates.
pub(crate) fn uses_set(material: Option<&Value>, set: usize) -> bool {
    let mut open: Vec<&Value> = material.into_iter().collect();
    while let Some(value) = open.pop() {
        match value {
            Value::Object(members) => {
                if member(value, "texCoord") == Some(set) {
                    return true;
                }
                open.extend(
                    members
                        .iter()
                        .filter(|(key, _)| *key != "occlusionTexture")
                        .map(|(_, v)| v),
                );
            }
            Value::Array(items) => open.extend(items),
            _ => {}
        }
    }
    false
}

/// Gives all materials of some primitives a texture as occlusion texture.
pub(crate) fn assign(file: &mut File, uses: &[Use], texture: usize) -> Result<Done, TexelsError> {
    let changed: BTreeSet<(usize, usize)> = uses.iter().map(|u| (u.mesh, u.primitive)).collect();
    // Materials of primitives that stay as they are.
    let mut others = BTreeSet::new();
    for (m, mesh) in file.array("meshes").iter().enumerate() {
        let primitives = mesh.get("primitives").and_then(Value::as_array);
        for (p, primitive) in primitives.into_iter().flatten().enumerate() {
            if !changed.contains(&(m, p)) {
                others.extend(numbers_of(primitive));
            }
        }
    }
    let mut done = Done::default();
    let mut known: BTreeMap<(Option<usize>, usize), usize> = BTreeMap::new();
    // Materials that are changed themselves.
    let mut taken = BTreeSet::new();
    let mut with_texture =
        |file: &mut File, original: Option<usize>, set: usize| -> Result<usize, TexelsError> {
            if let Some(number) = known.get(&(original, set)) {
                return Ok(*number);
            }
            let occlusion = json!({ "index": texture, "texCoord": set, "strength": 1 });
            let number = match original.filter(|m| *m < file.array("materials").len()) {
                Some(m) if !others.contains(&m) && taken.insert(m) => m,
                given => {
                    done.added += 1;
                    let mut copy =
                        given.map_or_else(|| json!({}), |m| file.array("materials")[m].clone());
                    // A copy of one that has been changed already has the texture: it was counted there.
                    if given.is_some_and(|m| taken.contains(&m))
                        && let Some(copy) = copy.as_object_mut()
                    {
                        copy.shift_remove("occlusionTexture");
                    }
                    file.push("materials", copy)?
                }
            };
            if let Some(material) = file
                .array_mut("materials")?
                .get_mut(number)
                .and_then(Value::as_object_mut)
            {
                done.replaced += usize::from(material.contains_key("occlusionTexture"));
                material.insert("occlusionTexture".to_owned(), occlusion);
            }
            known.insert((original, set), number);
            Ok(number)
        };
    for u in uses {
        let mut new = primitive_of(file, u.mesh, u.primitive)
            .cloned()
            .unwrap_or(Value::Null);
        let own = with_texture(file, member(&new, "material"), u.set)?;
        let variant_materials: Vec<Option<usize>> =
            variants(&new).map(|v| member(v, "material")).collect();
        for (i, material) in variant_materials.into_iter().enumerate() {
            if material.is_some() {
                let number = with_texture(file, material, u.set)?;
                new["extensions"][VARIANTS]["mappings"][i]["material"] = json!(number);
            }
        }
        if new.is_object() {
            new["material"] = json!(own);
        }
        put_primitive(file, u.mesh, u.primitive, new)?;
    }
    Ok(done)
}
