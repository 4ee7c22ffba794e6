//! `sightline export --format gltf`: writes the scene's glTF file with the extension SIGHTLINE_visibility
//! (`docs/formats/SIGHTLINE_visibility.md`).

use std::path::Path;

use serde_json::{Value, json};
use sightline::Error;
use sightline::NamedResult;
use sightline::output::{Format, Output};
use sightline_formats::gltf_edit::{Added, GltfError, GltfFile};
use sightline_pvs::Pvs;
use sightline_scene::{Scene, TriangleId};

use crate::args::kinds::KindArgs;
use crate::scenes::read::scene_of;

/// The extension's name.
const NAME: &str = "SIGHTLINE_visibility";

/// Minimum ratio of the size of the lists in JSON to their size in buffer views for the use of buffer views.
/// Buffer views must also save at least `SAVED` bytes.
const SMALLER: usize = 2;
const SAVED: usize = 4096;

/// Writes the scene of a result with the extension.
pub fn write(path: &Path, result: &Path, pvs: &Pvs, scene_path: &Path) -> Result<(), Error> {
    let of_scene =
        |e: &dyn std::fmt::Display| Error::input(format!("{}: {e}", scene_path.display()));
    let scene = scene_of(
        scene_path,
        &KindArgs::default(),
        NamedResult::new(pvs, result),
    )?;
    if scene.sources().is_empty() {
        return Err(of_scene(
            &"the scene is not a glTF or GLB file; use --format sidecar, or bake from a glTF file",
        ));
    }
    if pvs.objects().iter().any(|object| object.source.is_none()) {
        return Err(Error::input(format!(
            "{} does not store the glTF nodes and meshes of its objects, because an earlier version baked \
             it; bake the scene again",
            result.display()
        )));
    }
    let bytes = std::fs::read(scene_path).map_err(|e| of_scene(&e))?;
    let file = GltfFile::parse(&bytes).map_err(|e| of_scene(&e))?;
    let format = if file.is_glb() {
        Format::Glb
    } else {
        Format::Gltf
    };
    if !path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case(format.extension()))
    {
        return Err(Error::usage(format!(
            "{} must have the file type of {}; give -o a name that ends in .{}",
            path.display(),
            scene_path.display(),
            format.extension()
        )));
    }
    let output = Output::check(path, format, Some(scene_path))?;
    if let Some(uri) = file.needs().map_err(|e| of_scene(&e))?
        && folder(path) != folder(scene_path)
    {
        return Err(Error::usage(format!(
            "{} refers to the file {uri} in its folder; give -o a file in the same folder, or use a GLB \
             file without external files",
            scene_path.display()
        )));
    }
    let lists = Lists::from_result(pvs, &scene)?;
    let packed = lists.packed();
    let in_json = lists.in_json();
    let (size, of_json) = (packed.size(), in_json.to_string().len());
    let is_packed = size * SMALLER <= of_json
        && size + SAVED <= of_json
        && file.takes_views().map_err(|e| of_scene(&e))?;
    let extension = |view: usize| {
        let [min, max] = pvs.tree().view_box();
        let mut value = json!({
            "version": 1, "method": pvs.method(), "viewBox": {"min": min, "max": max},
            "objects": lists.objects,
        });
        if is_packed {
            value["packedCells"] = json!({
                "count": lists.cells.len(), "boxes": view, "ends": view + 1, "objects": view + 2,
                "componentType": if lists.is_short() { 5123 } else { 5125 },
            });
        } else {
            value["cells"] = in_json;
        }
        value
    };
    let added = if is_packed {
        &packed
    } else {
        &Added::default()
    };
    let whole = file.with(NAME, added, extension).map_err(|e| match e {
        GltfError::TooLarge => of_scene(&format!("{e}; use --format sidecar")),
        e => of_scene(&e),
    })?;
    output.write(|out| {
        out.write_all(&whole)
            .map_err(|e| Error::writing(output.path(), &e))
    })
}

/// Returns the canonical folder of a file.
fn folder(path: &Path) -> Option<std::path::PathBuf> {
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    std::fs::canonicalize(folder).ok()
}

/// The contents of the extension.
struct Lists {
    /// The objects that the sets can contain, by their nodes and meshes in the file.
    objects: Vec<Value>,
    /// The box of each cell with viewpoints, and the cell's objects as indices of `objects`.
    cells: Vec<([[f32; 3]; 2], Vec<u32>)>,
}

impl Lists {
    fn from_result(pvs: &Pvs, scene: &Scene) -> Result<Self, Error> {
        // Moving objects, occluders, points and lines are in no set. This does not mean that they are hidden.
        let shows = |first: u32, count: u32| {
            (first..first + count).any(|t| scene.kinds().kind(TriangleId(t)).shows())
        };
        let mut objects = Vec::new();
        let mut numbers = Vec::with_capacity(pvs.objects().len());
        for object in pvs.objects() {
            let number = objects.len() as u32;
            let source = object.source.filter(|_| shows(object.first, object.count));
            numbers.push(source.map(|_| number));
            if let Some(source) = source {
                let mut value = json!({
                    "node": source.node, "mesh": source.mesh, "primitive": source.primitive,
                });
                if let Some(instance) = source.instance {
                    value["instance"] = instance.into();
                }
                objects.push(value);
            }
        }
        let (mut cells, mut ids) = (Vec::new(), Vec::new());
        for cell in 0..pvs.cells() {
            if pvs.is_reached(cell)? {
                pvs.visible_objects(cell, &mut ids)?;
                let object_numbers = ids
                    .iter()
                    .filter_map(|id| *numbers.get(*id as usize)?)
                    .collect();
                cells.push((pvs.cell_bounds(cell).unwrap_or_default(), object_numbers));
            }
        }
        Ok(Self { objects, cells })
    }

    fn in_json(&self) -> Value {
        let cell = |(bounds, ids): &([[f32; 3]; 2], Vec<u32>)| {
            json!({
                "min": bounds[0], "max": bounds[1], "objects": ids
            })
        };
        self.cells.iter().map(cell).collect()
    }

    /// Returns true if an object's index fits two bytes.
    fn is_short(&self) -> bool {
        self.objects.len() <= 1 << 16
    }

    /// Returns the lists as three buffer views: the boxes, the end of each list, and the concatenated lists.
    fn packed(&self) -> Added {
        let mut added = Added::default();
        added.push(
            self.cells
                .iter()
                .flat_map(|(bounds, _)| bounds.as_flattened())
                .flat_map(|x| x.to_le_bytes()),
        );
        let ends = self.cells.iter().scan(0u32, |end, (_, ids)| {
            *end = end.saturating_add(ids.len() as u32);
            Some(*end)
        });
        added.push(ends.flat_map(u32::to_le_bytes));
        let size = if self.is_short() { 2 } else { 4 };
        let ids = self.cells.iter().flat_map(|(_, ids)| ids);
        added.push(ids.flat_map(|id| id.to_le_bytes().into_iter().take(size)));
        added
    }
}
