//! Sparse accessors, in which a few elements replace elements of a buffer view (glTF 2.0, section 3.6.2.3).

use super::buffers::Buffers;
use super::component::Component;
use super::json;
use super::source::GltfContext;
use crate::SceneError;

/// The elements of a sparse accessor that replace other elements. Lookups use binary search.
pub(super) struct Overlay<'a> {
    indices: &'a [u8],
    component: Component,
    values: &'a [u8],
    count: usize,
    /// The size of a value, in bytes.
    size: usize,
}

impl<'a> Overlay<'a> {
    /// Checks `sparse`, which replaces elements of `size` bytes in an accessor of `count` elements.
    pub(super) fn new(
        source: &GltfContext<'_>,
        root: &json::Root,
        buffers: &'a Buffers<'_>,
        label: &str,
        sparse: &json::Sparse,
        count: u64,
        size: u64,
    ) -> Result<Self, SceneError> {
        let bad = |why: String| source.bad(format!("{label}, sparse"), why);
        let component = match Component::from_number(sparse.indices.component_type) {
            Some(c @ (Component::U8 | Component::U16 | Component::U32)) => c,
            _ => {
                return Err(bad(
                    "the sparse indices must be unsigned integers".to_owned()
                ));
            }
        };
        let part =
            |v: usize, offset: u64, width: u64, what: &str| -> Result<&'a [u8], SceneError> {
                let bytes = buffers.view(source, root, v)?;
                let end = sparse
                    .count
                    .checked_mul(width)
                    .and_then(|l| l.checked_add(offset));
                match end.filter(|e| *e <= bytes.len() as u64) {
                    // Both numbers are at most the length of a slice.
                    Some(end) => Ok(&bytes[offset as usize..end as usize]),
                    None => Err(bad(format!(
                        "the {} {what} from byte {offset} reach beyond buffer view {v} of {} bytes",
                        sparse.count,
                        bytes.len()
                    ))),
                }
            };
        let indices = part(
            sparse.indices.buffer_view,
            sparse.indices.byte_offset,
            component.size(),
            "indices",
        )?;
        let values = part(
            sparse.values.buffer_view,
            sparse.values.byte_offset,
            size,
            "values",
        )?;
        // Indices and values are slices of memory, so the count and the size of an element fit `usize`.
        let this = Self {
            indices,
            component,
            values,
            count: sparse.count as usize,
            size: size as usize,
        };
        for i in 0..this.count {
            let index = this.index(i);
            if index >= count || (i > 0 && index <= this.index(i - 1)) {
                let reason = format!(
                    "sparse index {i} is {index}, but indices must increase and be below {count}"
                );
                return Err(bad(reason));
            }
        }
        Ok(this)
    }

    fn index(&self, i: usize) -> u64 {
        let at = i * self.component.size() as usize;
        self.component.unsigned(&self.indices[at..])
    }

    /// Returns the bytes that replace element `i`, or `None` if the element is not replaced.
    pub(super) fn get(&self, i: u64) -> Option<&'a [u8]> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            let at = self.index(middle);
            if at == i {
                return self
                    .values
                    .get(middle * self.size..(middle + 1) * self.size);
            }
            if at < i {
                low = middle + 1
            } else {
                high = middle
            }
        }
        None
    }
}
