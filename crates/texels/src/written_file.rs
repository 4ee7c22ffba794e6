//! The addition of an image or of vertex values to a file.

use std::collections::BTreeMap;

use serde_json::json;

use crate::TexelsError;
use crate::added_accessors;
use crate::atlas::Atlas;
use crate::copies::separate;
use crate::file::GltfParts;
use crate::materials::{MaterialChanges, OcclusionUse, assign};
use crate::parts::{PrimitiveInstances, primitive_of};
use crate::primitives::{put_attribute, with_coordinates};
use crate::settings::BitDepth;
use crate::vertices::{NONE, Unknowns};

/// The glTF constants for filters and wrapping (glTF 2.0, section 5.26).
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;

/// Adds an image, given as PNG bytes, as the occlusion texture of all materials of the primitives in `parts`.
pub(crate) fn with_texture(
    file: &mut GltfParts,
    parts: &PrimitiveInstances,
    atlas: &Atlas,
    png: &[u8],
) -> Result<MaterialChanges, TexelsError> {
    let meshes = separate(file, parts)?;
    let view = file.add_view(png, None)?;
    let image = json!({ "name": "occlusion", "bufferView": view, "mimeType": "image/png" });
    let image = file.push("images", image)?;
    let sampler = json!({
        "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR,
        "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE,
    });
    let sampler = file.push("samplers", sampler)?;
    let texture = file.push("textures", json!({ "sampler": sampler, "source": image }))?;
    let mut uses = Vec::with_capacity(parts.all.len());
    for (part, layout) in parts.all.iter().zip(&atlas.layouts) {
        let mesh = meshes[part.draw];
        let set = with_coordinates(file, mesh, part, layout)?;
        uses.push(OcclusionUse {
            mesh,
            primitive: part.primitive,
            set,
        });
    }
    assign(file, &uses, texture)
}

/// The counts of vertices that got a value and of primitives that keep their `COLOR_0`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct VertexChanges {
    /// The number of vertices with a value.
    pub vertices: usize,
    /// The number of primitives with an existing `COLOR_0`, which stays unchanged.
    pub colors_kept: usize,
}

/// Adds `_OCCLUSION` to all primitives in `parts`, and `COLOR_0` to primitives without `COLOR_0`. `values`
/// contains the value of each unknown.
pub(crate) fn with_vertices(
    file: &mut GltfParts,
    parts: &PrimitiveInstances,
    unknowns: &Unknowns,
    values: &[f64],
    bits: BitDepth,
) -> Result<VertexChanges, TexelsError> {
    let meshes = separate(file, parts)?;
    // For each vertex set, the accessor of its values, and the accessor of its colours if a primitive needs
    // colours.
    let mut accessors: BTreeMap<usize, usize> = BTreeMap::new();
    let mut colors: BTreeMap<usize, usize> = BTreeMap::new();
    let mut done = VertexChanges::default();
    for (part, set) in parts.all.iter().zip(&unknowns.set_of) {
        let at = (meshes[part.draw], part.primitive);
        // A vertex without a triangle has no receivers and gets the value 1, which is bright.
        let value_of = |u: &u32| {
            if *u == NONE {
                1.0
            } else {
                values[*u as usize] as f32
            }
        };
        let own = || -> Vec<f32> { unknowns.sets[*set].unknowns.iter().map(value_of).collect() };
        let accessor = match accessors.get(set) {
            Some(known) => *known,
            None => {
                done.vertices += unknowns.sets[*set].unknowns.len();
                added_accessors::numbers(file, &own())?
            }
        };
        accessors.insert(*set, accessor);
        let colored = primitive_of(file, at.0, at.1)
            .is_some_and(|p| p["attributes"].get("COLOR_0").is_some());
        put_attribute(file, at.0, at.1, "_OCCLUSION", accessor)?;
        if colored {
            done.colors_kept += 1;
            continue;
        }
        let color = match colors.get(set) {
            Some(known) => *known,
            None => added_accessors::greys(file, &own(), bits.largest())?,
        };
        colors.insert(*set, color);
        put_attribute(file, at.0, at.1, "COLOR_0", color)?;
    }
    Ok(done)
}
