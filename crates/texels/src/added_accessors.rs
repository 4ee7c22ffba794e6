//! Accessors that this crate adds to a file. Each function returns the index of the new accessor.

use serde_json::{Value, json};

use crate::TexelsError;
use crate::accessor::{FLOAT, UNSIGNED_INT, UNSIGNED_SHORT};
use crate::file::GltfParts;

/// The glTF codes for the targets of buffer views: vertex attributes, and indices.
pub(crate) const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Adds `accessor`, with `bytes` as a separate buffer view, and returns the index of the accessor.
fn add(
    file: &mut GltfParts,
    bytes: &[u8],
    target: u32,
    accessor: Value,
) -> Result<usize, TexelsError> {
    let view = file.add_view(bytes, Some(target))?;
    let mut accessor = accessor;
    accessor["bufferView"] = json!(view);
    file.push("accessors", accessor)
}

/// Adds an accessor of texture coordinates, and returns the index of the accessor.
pub(crate) fn coordinates(file: &mut GltfParts, all: &[[f32; 2]]) -> Result<usize, TexelsError> {
    let bytes: Vec<u8> = all.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    let accessor = json!({ "componentType": FLOAT, "count": all.len(), "type": "VEC2" });
    add(file, &bytes, ARRAY_BUFFER, accessor)
}

/// Adds an accessor with one float for each vertex, and returns the index of the accessor.
pub(crate) fn numbers(file: &mut GltfParts, all: &[f32]) -> Result<usize, TexelsError> {
    let bytes: Vec<u8> = all.iter().flat_map(|c| c.to_le_bytes()).collect();
    let accessor = json!({ "componentType": FLOAT, "count": all.len(), "type": "SCALAR" });
    add(file, &bytes, ARRAY_BUFFER, accessor)
}

/// Adds an accessor with an opaque grey colour for each vertex, and returns the index of the accessor. `all`
/// contains greys from 0 to 1, and `largest` is the stored integer for 1: 255 or 65535.
pub(crate) fn greys(file: &mut GltfParts, all: &[f32], largest: f64) -> Result<usize, TexelsError> {
    let number = |v: &f32| (f64::from(*v) * largest).round() as u16;
    let (component, bytes): (u32, Vec<u8>) = if largest > 255.0 {
        let grey = |v: &f32| [number(v), number(v), number(v), u16::MAX];
        (
            UNSIGNED_SHORT,
            all.iter()
                .flat_map(grey)
                .flat_map(u16::to_le_bytes)
                .collect(),
        )
    } else {
        let grey = |v: &f32| [number(v) as u8, number(v) as u8, number(v) as u8, u8::MAX];
        (5121, all.iter().flat_map(grey).collect())
    };
    let accessor = json!({
        "componentType": component, "normalized": true, "count": all.len(), "type": "VEC4"
    });
    add(file, &bytes, ARRAY_BUFFER, accessor)
}

/// Adds an accessor with the corners of triangles as indices of `vertices` vertices, and returns the index of
/// the accessor.
pub(crate) fn indices(
    file: &mut GltfParts,
    corners: &[[u32; 3]],
    vertices: usize,
) -> Result<usize, TexelsError> {
    let all = corners.iter().flatten();
    // The largest integer of a type, such as 65535, would trigger primitive restart.
    let (component, bytes): (u32, Vec<u8>) = if vertices <= usize::from(u16::MAX) {
        (
            UNSIGNED_SHORT,
            all.flat_map(|i| (*i as u16).to_le_bytes()).collect(),
        )
    } else {
        (UNSIGNED_INT, all.flat_map(|i| i.to_le_bytes()).collect())
    };
    let accessor =
        json!({ "componentType": component, "count": corners.len() * 3, "type": "SCALAR" });
    add(file, &bytes, ELEMENT_ARRAY_BUFFER, accessor)
}

/// Adds an accessor with copies of elements of another accessor: for each index in `picked`, the element with
/// this index. Returns the index of the new accessor.
pub(crate) fn gathered(
    file: &mut GltfParts,
    accessor: usize,
    picked: &[u32],
) -> Result<usize, TexelsError> {
    let elements = crate::accessor::CheckedElements::read(file, accessor)?;
    if picked.iter().any(|i| *i as usize >= elements.count) {
        return Err(file.broken(
            format!("accessor {accessor}"),
            "the accessor has fewer elements than the primitive has vertices",
        ));
    }
    // Vertex attributes start at multiples of four bytes.
    let stride = elements.size.next_multiple_of(4);
    let mut bytes = Vec::with_capacity(picked.len() * stride);
    for i in picked {
        let start = bytes.len();
        bytes.extend_from_slice(elements.get(*i as usize));
        bytes.resize(start + stride, 0);
    }
    let mut new = file.array("accessors")[accessor].clone();
    let bounds = |pick: fn(f64, f64) -> f64| -> Vec<Value> {
        (0..elements.components)
            .map(|c| {
                let all = picked.iter().map(|i| elements.raw(*i as usize, c));
                let bound = all.reduce(pick).unwrap_or(0.0);
                if elements.component == FLOAT {
                    json!(bound)
                } else {
                    json!(bound as i64)
                }
            })
            .collect()
    };
    let (least, most) = (bounds(f64::min), bounds(f64::max));
    let stride_needed = stride != elements.size;
    if let Some(new) = new.as_object_mut() {
        for key in ["byteOffset", "sparse", "bufferView"] {
            new.shift_remove(key);
        }
        new.insert("count".to_owned(), json!(picked.len()));
        for (key, bound) in [("min", least), ("max", most)] {
            if new.contains_key(key) {
                new.insert(key.to_owned(), json!(bound));
            }
        }
    }
    let number = add(file, &bytes, ARRAY_BUFFER, new)?;
    if stride_needed && let Some(view) = file.array_mut("bufferViews")?.last_mut() {
        view["byteStride"] = json!(stride);
    }
    Ok(number)
}
