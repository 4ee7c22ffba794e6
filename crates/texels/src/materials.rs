//! The addition of the occlusion texture to materials. Primitives that do not use the texture keep their
//! materials.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};

use crate::TexelsError;
use crate::file::{GltfParts, member};
use crate::parts::{primitive_of, put_primitive};

/// The extension with alternative materials of a primitive, between which an application can switch.
const VARIANTS: &str = "KHR_materials_variants";

/// A primitive that uses the occlusion texture, and its set of texture coordinates for this texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct OcclusionUse {
    /// The index of the mesh in the file.
    pub mesh: usize,
    /// The index of the primitive in the mesh.
    pub primitive: usize,
    /// The index N of the set `TEXCOORD_N`.
    pub set: usize,
}

/// The counts of added materials and replaced occlusion textures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct MaterialChanges {
    /// The number of added materials: for primitives without a material, and copies.
    pub added: usize,
    /// The number of materials whose occlusion texture was replaced.
    pub replaced: usize,
}

/// Returns the mappings of a primitive from variants to materials.
fn variants(primitive: &Value) -> impl Iterator<Item = &Value> {
    let mappings = primitive
        .get("extensions")
        .and_then(|e| e.get(VARIANTS))
        .and_then(|v| v.get("mappings"));
    mappings.and_then(Value::as_array).into_iter().flatten()
}

/// Returns the indices of a primitive's materials: of `material` and of the materials of its variants.
pub(crate) fn numbers_of(primitive: &Value) -> impl Iterator<Item = usize> {
    member(primitive, "material")
        .into_iter()
        .chain(variants(primitive).filter_map(|v| member(v, "material")))
}

/// Returns true if a texture of a material, other than its occlusion texture, uses the texture coordinates
/// `TEXCOORD_N`, where N is `set`.
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

/// Sets the texture with index `texture` as the occlusion texture of all materials of the primitives in
/// `uses`. A material that other primitives also use is copied first.
pub(crate) fn assign(
    file: &mut GltfParts,
    uses: &[OcclusionUse],
    texture: usize,
) -> Result<MaterialChanges, TexelsError> {
    let changed: BTreeSet<(usize, usize)> = uses.iter().map(|u| (u.mesh, u.primitive)).collect();
    // The materials of primitives that are not in `uses`.
    let mut others = BTreeSet::new();
    for (m, mesh) in file.array("meshes").iter().enumerate() {
        let primitives = mesh.get("primitives").and_then(Value::as_array);
        for (p, primitive) in primitives.into_iter().flatten().enumerate() {
            if !changed.contains(&(m, p)) {
                others.extend(numbers_of(primitive));
            }
        }
    }
    let mut done = MaterialChanges::default();
    let mut known: BTreeMap<(Option<usize>, usize), usize> = BTreeMap::new();
    // The materials that are changed in place.
    let mut taken = BTreeSet::new();
    let mut with_texture =
        |file: &mut GltfParts, original: Option<usize>, set: usize| -> Result<usize, TexelsError> {
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
                    // A material that was changed in place already has the new texture. Its copy does not
                    // count as another replacement.
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
