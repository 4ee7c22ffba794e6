//! A file with an image or with values at its vertices.

use std::collections::BTreeMap;

use serde_json::json;

use crate::TexelsError;
use crate::added;
use crate::atlas::Atlas;
use crate::copies::separate;
use crate::file::File;
use crate::materials::{Done, Use, assign};
use crate::parts::{Parts, primitive_of};
use crate::primitives::{put_attribute, with_coordinates};
use crate::settings::Bits;
use crate::vertices::{NONE, Unknowns};

/// Numbers of the format for filters and wrapping (glTF 2.0, section 5.26).
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;

/// Adds the image as occlusion texture of all materials of the parts.
pub(crate) fn with_texture(
    file: &mut File,
    parts: &Parts,
    atlas: &Atlas,
    png: &[u8],
) -> Result<Done, TexelsError> {
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
        uses.push(Use {
            mesh,
            primitive: part.primitive,
            set,
        });
    }
    assign(file, &uses, texture)
}

/// What was done to vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Vertices {
    /// Vertices with a value.
    pub vertices: usize,
    /// Primitives that had a `COLOR_0`, which stayed.
    pub colors_kept: usize,
}

/// Adds `_OCCLUSION` to all parts, and `COLOR_0` to those that have none.
pub(crate) fn with_vertices(
    file: &mut File,
    parts: &Parts,
    unknowns: &Unknowns,
    values: &[f64],
    bits: Bits,
) -> Result<Vertices, TexelsError> {
    let meshes = separate(file, parts)?;
    // Values of each set, and accessors of its colours where a part wants them.
    let mut accessors: BTreeMap<usize, usize> = BTreeMap::new();
    let mut colors: BTreeMap<usize, usize> = BTreeMap::new();
    let mut done = Vertices::default();
    for (part, set) in parts.all.iter().zip(&unknowns.set_of) {
        let at = (meshes[part.draw], part.primitive);
        // Vertices of no triangle are in the open.
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
                added::numbers(file, &own())?
            }
        };
        accessors.insert(*set, accessor);
        let colored = primitive_of(file, at.0, at.1)
            .is_some_and(|p| p["attributes"].get("COLOR_0").is_some());
        put_attribute(file, at, "_OCCLUSION", accessor)?;
        if colored {
            done.colors_kept += 1;
            continue;
        }
        let color = match colors.get(set) {
            Some(known) => *known,
            None => added::greys(file, &own(), bits.largest())?,
        };
        colors.insert(*set, color);
        put_attribute(file, at, "COLOR_0", color)?;
    }
    Ok(done)
}
