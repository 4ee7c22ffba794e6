//! The glTF extensions that the loader knows, and the check of the extensions that a file declares.
//!
//! `docs/extensions.md` shows the same table; a test compares the two.

use std::collections::BTreeSet;

use super::json;
use super::source::{GltfContext, MESHOPT, QUANTIZATION, VISIBILITY};
use crate::SceneError;
use crate::load::marks::Marks;

/// The treatment of an extension by the loader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Support {
    /// The loader reads the extension's data.
    Read,
    /// The extension does not affect which triangles block or show.
    Irrelevant,
    /// The extension changes triangles, and the loader does not read it. The loader rejects a file that
    /// requires the extension, and warns about a file that only uses the extension.
    Refused,
}

impl Support {
    /// Returns the word for the treatment in `docs/extensions.md`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Irrelevant => "irrelevant to visibility",
            Self::Refused => "refused",
        }
    }
}

/// An extension, or a family of extensions, and its treatment.
#[derive(Clone, Copy, Debug)]
pub struct Extension {
    /// The name of the extension. A name that ends in `*` represents all extensions with this prefix that no
    /// other row names.
    pub name: &'static str,
    /// The treatment of the extension.
    pub support: Support,
    /// The part that the loader reads, or the reason for the treatment.
    pub note: &'static str,
}

const fn row(name: &'static str, support: Support, note: &'static str) -> Extension {
    Extension {
        name,
        support,
        note,
    }
}

/// The extensions that the loader knows: every ratified Khronos extension, common multi-vendor extensions and
/// some vendor extensions.
pub const EXTENSIONS: &[Extension] = {
    use Support::{Irrelevant, Read, Refused};
    const SHADING: &str = "shading";
    const IMAGES: &str =
        "an image format; the mask of `--alpha-textures` needs PNG or JPEG as well";
    const LIGHTS: &str = "lights";
    const METADATA: &str = "metadata";
    &[
        row(
            "KHR_animation_pointer",
            Read,
            "a node that an animation moves, shows or hides is moving",
        ),
        row("KHR_draco_mesh_compression", Read, "compressed primitives"),
        row(
            "KHR_gaussian_splatting",
            Irrelevant,
            "splats are points, not triangles",
        ),
        row(
            "KHR_interactivity",
            Irrelevant,
            "behaviours are not run; name the objects that they move with `--moving`",
        ),
        row("KHR_lights_punctual", Irrelevant, LIGHTS),
        row("KHR_materials_anisotropy", Irrelevant, SHADING),
        row("KHR_materials_clearcoat", Irrelevant, SHADING),
        row(
            "KHR_materials_diffuse_transmission",
            Read,
            "a positive factor makes triangles see-through",
        ),
        row("KHR_materials_dispersion", Irrelevant, SHADING),
        row("KHR_materials_emissive_strength", Irrelevant, SHADING),
        row("KHR_materials_ior", Irrelevant, SHADING),
        row("KHR_materials_iridescence", Irrelevant, SHADING),
        row("KHR_materials_pbrSpecularGlossiness", Irrelevant, SHADING),
        row("KHR_materials_sheen", Irrelevant, SHADING),
        row("KHR_materials_specular", Irrelevant, SHADING),
        row(
            "KHR_materials_transmission",
            Read,
            "a positive factor makes triangles see-through",
        ),
        row("KHR_materials_unlit", Irrelevant, SHADING),
        row(
            "KHR_materials_variants",
            Irrelevant,
            "the material of the primitive itself decides",
        ),
        row("KHR_materials_volume", Irrelevant, SHADING),
        row(QUANTIZATION, Read, "integer positions"),
        row(
            MESHOPT[0],
            Read,
            "compressed buffer views, of version 0 and 1",
        ),
        row("KHR_node_hoverability", Irrelevant, "input of users"),
        row("KHR_node_selectability", Irrelevant, "input of users"),
        row(
            VISIBILITY,
            Read,
            "the triangles of a hidden node neither block nor show",
        ),
        row("KHR_texture_basisu", Irrelevant, IMAGES),
        row(
            "KHR_texture_transform",
            Read,
            "the texels of `--alpha-textures`",
        ),
        row("KHR_xmp_json_ld", Irrelevant, METADATA),
        row(
            "EXT_mesh_gpu_instancing",
            Read,
            "an object for each instance",
        ),
        row(MESHOPT[1], Read, "compressed buffer views"),
        row("EXT_texture_webp", Irrelevant, IMAGES),
        row("EXT_instance_features", Irrelevant, METADATA),
        row("EXT_mesh_features", Irrelevant, METADATA),
        row("EXT_mesh_manifold", Irrelevant, METADATA),
        row(
            "EXT_mesh_primitive_edge_visibility",
            Irrelevant,
            "lines, which are not surfaces",
        ),
        row(
            "EXT_mesh_primitive_restart",
            Refused,
            "indices that begin another strip or fan",
        ),
        row("EXT_structural_metadata", Irrelevant, METADATA),
        row("EXT_texture_astc", Irrelevant, IMAGES),
        row("EXT_texture_avif", Irrelevant, IMAGES),
        row(
            "CESIUM_primitive_outline",
            Irrelevant,
            "lines, which are not surfaces",
        ),
        row("CESIUM_RTC", Refused, "an offset of all positions"),
        row("FB_geometry_metadata", Irrelevant, METADATA),
        row("GODOT_single_root", Irrelevant, METADATA),
        row(
            "KHR_accessor_float64",
            Refused,
            "positions in double precision",
        ),
        row("KHR_audio", Irrelevant, "sound"),
        row("KHR_audio_emitter", Irrelevant, "sound"),
        row(
            "KHR_techniques_webgl",
            Refused,
            "shaders that place vertices",
        ),
        row("KHR_xmp", Irrelevant, METADATA),
        row("MSFT_lod", Refused, "the coarser levels of detail"),
        row("MSFT_texture_dds", Irrelevant, IMAGES),
        row("NV_materials_mdl", Irrelevant, SHADING),
        row(
            "SIGHTLINE_visibility",
            Irrelevant,
            "the sets that `export` writes",
        ),
        row("ADOBE_materials_*", Irrelevant, SHADING),
        row("AGI_*", Irrelevant, METADATA),
        row("EXT_lights_*", Irrelevant, LIGHTS),
        row("EXT_materials_*", Irrelevant, SHADING),
        row("EXT_texture_*", Irrelevant, "textures"),
        row("KHR_lights_*", Irrelevant, LIGHTS),
        row("KHR_materials_*", Irrelevant, SHADING),
        row("KHR_texture_*", Irrelevant, "textures"),
        row("MSFT_packing_*", Irrelevant, "textures"),
        row(
            "VRMC_*",
            Irrelevant,
            "avatars, whose skinned meshes are moving",
        ),
    ]
};

/// Maximum number of extensions that each get a separate warning.
const MOST_NAMED: usize = 16;

/// Returns the row with the extension's name, otherwise the row of its family, or `None` for an unknown
/// extension.
fn find(name: &str) -> Option<&'static Extension> {
    let family = |e: &&Extension| {
        e.name
            .strip_suffix('*')
            .is_some_and(|prefix| name.starts_with(prefix))
    };
    EXTENSIONS
        .iter()
        .find(|e| e.name == name)
        .or_else(|| EXTENSIONS.iter().find(family))
}

/// Rejects a file that requires an extension which the loader does not support, and warns of each unsupported
/// extension that the file uses.
pub(super) fn check(
    source: &GltfContext<'_>,
    root: &json::Root,
    marks: &mut Marks,
) -> Result<(), SceneError> {
    let supported = |name: &str| find(name).is_some_and(|e| e.support != Support::Refused);
    if let Some(name) = root
        .extensions_required
        .iter()
        .find(|name| !supported(name))
    {
        let shown = shown(name);
        return Err(SceneError::bad(
            source.file,
            "extensionsRequired",
            format!("the file requires the extension {shown}, which is not supported"),
            format!("export the scene again without {shown}"),
        ));
    }
    let unread: BTreeSet<&str> = root
        .extensions_used
        .iter()
        .map(String::as_str)
        .filter(|name| !supported(name))
        .collect();
    for name in unread.iter().take(MOST_NAMED) {
        let reason = match find(name) {
            Some(row) => format!("is not read ({})", row.note),
            None => "is unknown to this program".to_owned(),
        };
        marks.warn(format!(
            "the file uses the extension {}, which {reason}; if the extension changes which triangles \
             block or show, export again without it",
            shown(name)
        ));
    }
    if unread.len() > MOST_NAMED {
        marks.warn(format!(
            "the file uses {} more extensions that are not read",
            unread.len() - MOST_NAMED
        ));
    }
    Ok(())
}

/// Returns the first 80 characters of an extension's name, for messages.
fn shown(name: &str) -> String {
    name.chars().take(80).collect()
}
