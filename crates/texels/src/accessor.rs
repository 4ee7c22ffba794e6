//! The elements of accessors as bytes or numbers, independent of the attribute that they belong to.

use serde_json::Value;

use crate::TexelsError;
use crate::file::{GltfParts, member};

/// The glTF codes of component types (glTF 2.0, section 3.6.2.2).
pub(crate) const UNSIGNED_SHORT: u32 = 5123;
pub(crate) const UNSIGNED_INT: u32 = 5125;
pub(crate) const FLOAT: u32 = 5126;

/// The elements of an accessor whose type and byte range were checked.
pub(crate) struct CheckedElements<'a> {
    /// The bytes from the first element on. `None` means that all elements that `replaced` does not contain
    /// are zero.
    base: Option<&'a [u8]>,
    /// The distance between the starts of two consecutive elements in `base`, in bytes.
    stride: usize,
    /// The number of bytes of an element.
    pub size: usize,
    /// The number of components of an element.
    pub components: usize,
    /// The number of elements of the accessor.
    pub count: usize,
    /// The glTF code of the type of a component, such as [`FLOAT`].
    pub component: u32,
    /// True if unsigned integers represent 0…1, and signed integers -1…1.
    pub normalized: bool,
    /// The elements of the sparse part, as index and bytes, by increasing index. These elements
    /// replace elements of `base`.
    replaced: Vec<(usize, &'a [u8])>,
}

impl<'a> CheckedElements<'a> {
    /// Reads the accessor with index `number` of `file`, and checks its type and byte range.
    pub(crate) fn read(file: &'a GltfParts, number: usize) -> Result<Self, TexelsError> {
        let bad = |why: &str| file.broken(format!("accessor {number}"), why);
        let accessor = file
            .array("accessors")
            .get(number)
            .ok_or_else(|| bad("the file contains no such accessor"))?;
        let component = member(accessor, "componentType")
            .and_then(|c| u32::try_from(c).ok())
            .unwrap_or(0);
        let width = width(component).ok_or_else(|| bad("the componentType is unknown"))?;
        let shape = accessor
            .get("type")
            .and_then(Value::as_str)
            .unwrap_or_default();
        let (components, size) =
            shape_size(shape, width).ok_or_else(|| bad("the type is unknown"))?;
        let count = member(accessor, "count").ok_or_else(|| bad("the accessor has no count"))?;
        let offset = member(accessor, "byteOffset").unwrap_or(0);
        let mut stride = size;
        let base = match member(accessor, "bufferView") {
            None if count > file.size() => {
                return Err(bad(
                    "the count exceeds the number of bytes of the file's buffers",
                ));
            }
            None => None,
            Some(v) => {
                let bytes = file.view(v)?;
                let given = member(&file.array("bufferViews")[v], "byteStride").filter(|s| *s != 0);
                stride = given.unwrap_or(size);
                let end = match count.checked_sub(1) {
                    None => Some(offset),
                    Some(last) => last
                        .checked_mul(stride)
                        .and_then(|l| l.checked_add(size)?.checked_add(offset)),
                };
                if stride < size || end.is_none_or(|e| e > bytes.len()) {
                    return Err(bad("the elements exceed their buffer view"));
                }
                Some(&bytes[offset..])
            }
        };
        let normalized = accessor
            .get("normalized")
            .and_then(Value::as_bool)
            .unwrap_or(false);
        let replaced = match accessor.get("sparse") {
            None => Vec::new(),
            Some(sparse) => replaced(file, sparse, size, count).ok_or_else(|| {
                bad("the indices or values of `sparse` are missing, unordered or out of range")
            })?,
        };
        Ok(Self {
            base,
            stride,
            size,
            components,
            count,
            component,
            normalized,
            replaced,
        })
    }

    /// Returns the bytes of element `i`. The result is empty if no bytes are stored, so all components are 0.
    pub(crate) fn get(&self, i: usize) -> &'a [u8] {
        if let Ok(at) = self.replaced.binary_search_by_key(&i, |r| r.0) {
            return self.replaced[at].1;
        }
        let range = i
            .checked_mul(self.stride)
            .and_then(|at| Some(at..at.checked_add(self.size)?));
        self.base
            .zip(range)
            .and_then(|(base, range)| base.get(range))
            .unwrap_or_default()
    }

    /// Returns component `c` of element `i` as a number. Integers are scaled to 0…1 or -1…1 if the accessor
    /// is normalized.
    pub(crate) fn number(&self, i: usize, c: usize) -> f64 {
        let most = match self.component {
            _ if !self.normalized => return self.raw(i, c),
            5120 => 127.0,
            5121 => 255.0,
            5122 => 32767.0,
            UNSIGNED_SHORT => 65535.0,
            _ => 1.0,
        };
        (self.raw(i, c) / most).max(-1.0)
    }

    /// Returns component `c` of element `i` as the stored number, without scaling of normalized integers.
    pub(crate) fn raw(&self, i: usize, c: usize) -> f64 {
        let bytes = self.get(i);
        let at = c * width(self.component).unwrap_or(1);
        match (self.component, bytes.get(at..).unwrap_or_default()) {
            (5120, &[a, ..]) => f64::from(a as i8),
            (5121, &[a, ..]) => f64::from(a),
            (5122, &[a, b, ..]) => f64::from(i16::from_le_bytes([a, b])),
            (UNSIGNED_SHORT, &[a, b, ..]) => f64::from(u16::from_le_bytes([a, b])),
            (UNSIGNED_INT, &[a, b, c, d, ..]) => f64::from(u32::from_le_bytes([a, b, c, d])),
            (FLOAT, &[a, b, c, d, ..]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            _ => 0.0,
        }
    }

    /// Returns element `i` as an index, or `None` if the components are not unsigned integers.
    pub(crate) fn index(&self, i: usize) -> Option<u32> {
        match (self.component, self.get(i)) {
            (_, []) => Some(0),
            (5121, &[a, ..]) => Some(u32::from(a)),
            (UNSIGNED_SHORT, &[a, b, ..]) => Some(u32::from(u16::from_le_bytes([a, b]))),
            (UNSIGNED_INT, &[a, b, c, d, ..]) => Some(u32::from_le_bytes([a, b, c, d])),
            _ => None,
        }
    }
}

/// Returns the number of bytes of a component, given the glTF code of its type.
fn width(component: u32) -> Option<usize> {
    match component {
        5120 | 5121 => Some(1),
        5122 | UNSIGNED_SHORT => Some(2),
        UNSIGNED_INT | FLOAT => Some(4),
        _ => None,
    }
}

/// Returns the number of components and the number of bytes of an element, given the accessor type `shape`,
/// such as `VEC3`, and the bytes per component. Columns of matrices start at multiples of four bytes.
fn shape_size(shape: &str, width: usize) -> Option<(usize, usize)> {
    let matrix = |n: usize| (n * n, n * (n * width).next_multiple_of(4));
    Some(match shape {
        "SCALAR" => (1, width),
        "VEC2" => (2, 2 * width),
        "VEC3" => (3, 3 * width),
        "VEC4" => (4, 4 * width),
        "MAT2" => matrix(2),
        "MAT3" => matrix(3),
        "MAT4" => matrix(4),
        _ => return None,
    })
}

/// Returns the index and bytes of each element of the sparse part of an accessor. The accessor has `count`
/// elements of `size` bytes. Returns `None` if the part is damaged.
fn replaced<'a>(
    file: &'a GltfParts,
    sparse: &Value,
    size: usize,
    count: usize,
) -> Option<Vec<(usize, &'a [u8])>> {
    let part = |key: &str, size: usize| -> Option<&'a [u8]> {
        let part = sparse.get(key)?;
        let bytes = file.view(member(part, "bufferView")?).ok()?;
        let start = member(part, "byteOffset").unwrap_or(0);
        bytes.get(start..start.checked_add(member(sparse, "count")?.checked_mul(size)?)?)
    };
    let component = u32::try_from(member(sparse.get("indices")?, "componentType")?).ok()?;
    let wide = width(component).filter(|_| component != FLOAT)?;
    let (indices, values) = (part("indices", wide)?, part("values", size)?);
    let mut all: Vec<(usize, &[u8])> = Vec::with_capacity(values.len() / size);
    for (index, value) in indices.chunks_exact(wide).zip(values.chunks_exact(size)) {
        let index = index
            .iter()
            .rev()
            .fold(0usize, |n, b| n << 8 | usize::from(*b));
        if index >= count || all.last().is_some_and(|last| last.0 >= index) {
            return None;
        }
        all.push((index, value));
    }
    Some(all)
}
