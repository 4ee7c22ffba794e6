//! glTF 2.0, as JSON or in its binary container: the triangles of the default scene with node transforms
//! applied.
//!
//! Each pair of a node and a primitive is an object, in depth-first order of the nodes. If a node has
//! instances (EXT_mesh_gpu_instancing), each pair of an instance and a primitive is an object. Primitives
//! that are points or lines, or have no POSITION, are objects without triangles, so that object indices
//! follow the file. Skins and morph targets are not applied: the scene has the stored mesh with the transform
//! of its node. Vertices keep their order if a transform mirrors; the side of a triangle specifies its front
//! ([`mod@crate::sides`]).
//!
//! Only the few JSON fields that are needed are read (`json`). The crate `gltf` models and validates the
//! whole document, so a fault in a material would make a scene unreadable. In addition, this loader would
//! have to check all ranges and counts again to name the mesh, primitive and accessor in errors.

mod accessor;
mod alpha;
mod buffers;
mod component;
mod draco;
mod extensions;
mod images;
mod instances;
mod json;
mod kinds;
mod meshopt;
mod nodes;
mod primitive;
mod source;
mod sparse;
mod texels;
mod textures;
mod transform;
mod uses;

use std::path::Path;

use rayon::prelude::*;

use self::accessor::Accessors;
use self::buffers::Buffers;
pub use self::buffers::uri_bytes;
use self::draco::DecodedAccessors;
pub use self::extensions::{EXTENSIONS, Extension, Support};
use self::images::Document;
use self::source::GltfContext;
use self::textures::{AlphaEffect, Textures};
use super::limits::{EXPORT_AGAIN, LoadLimits, too_many_objects, too_many_triangles};
use super::marks::{Mark, Marks};
use super::names::UniqueNames;
use crate::kinds::SurfaceKind;
use crate::masks::{MaskRun, Masks};
use crate::{Object, Scene, SceneError, Side, Triangle};
use sightline_formats::glb;

/// Returns true if bytes begin like a JSON object.
pub(super) fn is_json(bytes: &[u8]) -> bool {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    text.trim_ascii_start().starts_with(b"{")
}

/// Returns true if bytes begin like a GLB file.
pub(super) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(b"glTF")
}

/// Reads a `.gltf` file.
pub(super) fn parse_json(
    file: &str,
    bytes: &[u8],
    base_dir: Option<&Path>,
    limits: &LoadLimits,
    marks: &mut Marks,
) -> Result<Scene, SceneError> {
    let alpha_textures = marks.reads_alpha();
    build(
        &GltfContext {
            file,
            base_dir,
            limits,
            alpha_textures,
        },
        bytes,
        None,
        marks,
    )
}

/// Reads a `.glb` file: a header, a chunk of JSON and at most one chunk of binary data, which is buffer 0.
/// Bytes beyond the length in the header are ignored, as the format specifies.
pub(super) fn parse_glb(
    file: &str,
    bytes: &[u8],
    base_dir: Option<&Path>,
    limits: &LoadLimits,
    marks: &mut Marks,
) -> Result<Scene, SceneError> {
    // The format requires that readers skip unknown chunks.
    let (json, binary) = glb::document(bytes)
        .map_err(|fault| SceneError::bad(file, fault.element(), fault.to_string(), EXPORT_AGAIN))?;
    let alpha_textures = marks.reads_alpha();
    build(
        &GltfContext {
            file,
            base_dir,
            limits,
            alpha_textures,
        },
        json,
        binary,
        marks,
    )
}

fn build(
    source: &GltfContext<'_>,
    json: &[u8],
    binary: Option<&[u8]>,
    marks: &mut Marks,
) -> Result<Scene, SceneError> {
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    let root: json::Root =
        serde_json::from_slice(json).map_err(|e| source.bad("glTF JSON", e.to_string()))?;
    check_version(source, &root)?;
    extensions::check(source, &root, marks)?;

    let materials = kinds::materials(source, &root, marks);
    let document = if source.alpha_textures {
        Document::read(source, json)?
    } else {
        Document::default()
    };
    let images = document.views(
        materials
            .iter()
            .filter_map(|m| m.alpha.as_ref()?.as_ref().ok()?.texture),
    );
    let draws = nodes::walk(source, &root, marks)?;
    let buffers = Buffers::read(source, &root, json, binary, &draws, &materials, &images)?;
    let used = uses::uses(source, &root, &draws, &materials)?;
    let decoded = DecodedAccessors::read(source, &root, &buffers, &used)?;
    let accessors = Accessors::resolve(source, &root, &buffers, &decoded, &used)?;
    let draws = instances::expand(source, &root, &accessors, draws)?;

    // Count first, so that the triangles are allocated once and never exceed the limit.
    let mut total = 0u64;
    let (mut objects, mut sources) = (Vec::new(), Vec::new());
    let mut names = UniqueNames::default();
    let mut textures = Textures::new(source, &root, &buffers, &document);
    let mut masked = Vec::new();
    for draw in &draws {
        let mesh = &root.meshes[draw.mesh];
        let extras = kinds::Extras::read(
            mesh.extras.as_deref(),
            || format!("mesh {}", draw.mesh),
            marks,
        );
        for (p, part) in mesh.primitives.iter().enumerate() {
            if objects.len() >= source.limits.objects as usize {
                return Err(too_many_objects(
                    source.file,
                    primitive::label(draw, p),
                    source.limits,
                ));
            }
            let count = primitive::count(source, &root, &accessors, draw, p)?;
            let first = total;
            total = total.saturating_add(count);
            if total > u64::from(source.limits.triangles) {
                return Err(too_many_triangles(
                    source.file,
                    primitive::label(draw, p),
                    source.limits,
                ));
            }
            let name = names.unique(object_name(&root, draw, p));
            let material =
                kinds::material_of(part, &materials, || primitive::label(draw, p), marks);
            let mark = match draw.hidden {
                true => Mark::HIDDEN,
                false => kinds::mark(draw.skinned, draw.animated, draw.extras, extras, material),
            };
            let own = |name: &'_ Option<String>| name.clone().unwrap_or_default();
            let (node, material_name) = (
                own(&root.nodes[draw.node].name),
                material.map_or("", |m| m.name.as_str()),
            );
            let alpha = material.and_then(|m| Some((m, m.alpha.as_ref()?)));
            let double_sided = material.is_some_and(|m| m.double_sided);
            marks.push_side(count as u32, Side::new(double_sided, draw.mirrors()));
            // Both numbers are at most `limits.triangles`, a u32.
            let (first, count) = (first as u32, count as u32);
            let mesh_name = own(&mesh.name);
            let names = [
                name.as_str(),
                node.as_str(),
                mesh_name.as_str(),
                material_name,
            ];
            let mut mark = marks.decide(&names, mark);
            if let (SurfaceKind::Masked, true, Some((material, given))) =
                (mark.kind, count > 0, alpha)
            {
                match textures.resolve(&accessors, draw, p, &material.label, given, marks)? {
                    AlphaEffect::Whole(whole) => mark = whole,
                    AlphaEffect::Mask(mask) => {
                        masked.push((draw, p, given, MaskRun { first, count, mask }));
                    }
                }
            }
            marks.add(count, &mark);
            objects.push(Object { name, first, count });
            // All indices are below the numbers of objects and bytes of a file, which the limits bound.
            let index = |i: usize| u32::try_from(i).unwrap_or(u32::MAX);
            sources.push(crate::GltfLocation {
                node: index(draw.node),
                mesh: index(draw.mesh),
                primitive: index(p),
                instance: draw.instance.map(|i| u32::try_from(i).unwrap_or(u32::MAX)),
            });
        }
    }
    // The system zeroes each page of this memory when a thread first writes to the page.
    let mut triangles: Vec<Triangle> = bytemuck::allocation::try_zeroed_vec(total as usize)
        .map_err(|()| {
            SceneError::bad(
                source.file,
                "scene",
                format!("{total} triangles do not fit in memory"),
                "split the scene",
            )
        })?;
    // Use the order in which the primitives were counted.
    let parts = draws
        .iter()
        .flat_map(|d| (0..root.meshes[d.mesh].primitives.len()).map(move |p| (d, p)));
    let mut rest = triangles.as_mut_slice();
    let mut work = Vec::with_capacity(objects.len());
    for ((draw, p), object) in parts.zip(&objects) {
        let (own, others) = rest.split_at_mut(object.count as usize);
        work.push((draw, p, own));
        rest = others;
    }
    // If there are several faults, the first fault in the file is reported.
    let wrong = work.into_par_iter().find_map_first(|(draw, p, own)| {
        primitive::read(source, &root, &accessors, draw, p, own).err()
    });
    if let Some(wrong) = wrong {
        return Err(wrong);
    }
    let mut coordinates = Vec::new();
    for (draw, p, alpha, part) in &masked {
        // A fault in the material was already reported when its texture was read.
        let Ok(alpha) = alpha else { continue };
        primitive::coordinates(
            source,
            &root,
            &accessors,
            draw,
            *p,
            part.count,
            alpha,
            &mut coordinates,
        )?;
    }
    marks.set_masks(Masks::new(
        textures.into_masks(),
        masked.iter().map(|m| m.3).collect(),
        coordinates,
    ));
    Scene::new(source.file, triangles, objects)?.with_sources(source.file, sources)
}

fn check_version(source: &GltfContext<'_>, root: &json::Root) -> Result<(), SceneError> {
    let asset = &root.asset;
    // `minVersion` is the version that a reader must support. If it is missing, the major number of `version`
    // decides.
    let supported = match &asset.min_version {
        Some(min) => min == "2.0",
        None => asset.version.split('.').next() == Some("2"),
    };
    if supported {
        return Ok(());
    }
    let asked = asset.min_version.as_ref().unwrap_or(&asset.version);
    let shown: String = asked.chars().take(20).collect();
    let reason = format!("the file requires glTF {shown}, but only 2.0 is supported");
    Err(SceneError::bad(
        source.file,
        "asset",
        reason,
        "export the scene again as glTF 2.0",
    ))
}

/// Returns the name of an object, `node/mesh#primitive`. An index such as `node3` replaces a missing name. If
/// the node has instances, the name starts with `node[instance]`.
fn object_name(root: &json::Root, draw: &nodes::PlacedMesh, p: usize) -> String {
    let or_number = |name: &Option<String>, what: &str, number: usize| match name {
        Some(n) if !n.is_empty() => n.clone(),
        _ => format!("{what}{number}"),
    };
    let mut node = or_number(&root.nodes[draw.node].name, "node", draw.node);
    if let Some(instance) = draw.instance {
        node = format!("{node}[{instance}]");
    }
    let mesh = or_number(&root.meshes[draw.mesh].name, "mesh", draw.mesh);
    format!("{node}/{mesh}#{p}")
}
