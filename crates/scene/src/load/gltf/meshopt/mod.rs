//! KHR_meshopt_compression and EXT_meshopt_compression: the decoding of compressed buffer views (appendix A
//! of the specifications). The KHR extension adds version 1 of vertex data and the filter COLOR. The loader
//! reads both versions under either name.
//!
//! The decoders in this module are safe Rust, written from the text of the extensions. The crate `meshopt-rs`
//! supports only version 0, and needs the type of an element at compile time, although a file can have any
//! stride. The crate `meshopt` binds the C++ library, which needs a C++ compiler. The tests decode data
//! encoded by `meshopt-rs`, and data of version 1 encoded by the C++ library. The filter OCTAHEDRAL is for
//! normals, which are not read.

mod attributes;
mod filters;
mod indices;

use attributes::{DENSEST, attributes};
use filters::Filter;
use indices::{index_sequence, triangles};

use super::json::MeshoptView;

/// Decodes a view to its uncompressed bytes: `count * byteStride` bytes.
///
/// # Errors
/// A sentence that describes the fault of the view.
pub(super) fn decode(view: &MeshoptView, data: &[u8]) -> Result<Vec<u8>, String> {
    let truncated = || "the compressed data are too short for the count".to_owned();
    let (count, stride) = (view.count, view.byte_stride);
    let size = count.checked_mul(stride).ok_or_else(truncated)?;
    if size / DENSEST > data.len() as u64 {
        return Err(truncated());
    }
    // The size is at most 1024 times the length of `data`, and the count is at most the size.
    let fits = |n: u64| usize::try_from(n).map_err(|_| truncated());
    let (count, stride, size) = (fits(count)?, fits(stride)?, fits(size)?);
    match view.mode.as_str() {
        "ATTRIBUTES" => {
            if stride == 0 || stride > 256 || stride % 4 != 0 {
                return Err(format!(
                    "the stride of {stride} bytes is not a multiple of 4 up to 256"
                ));
            }
            let filter = Filter::parse(view.filter.as_deref(), stride)?;
            let mut out = bytemuck::allocation::try_zeroed_vec(size)
                .map_err(|()| format!("the {size} decoded bytes do not fit in memory"))?;
            attributes(&mut out, stride, data)
                .ok_or("the vertex data are malformed or truncated")?;
            filter.apply(&mut out, stride);
            Ok(out)
        }
        "TRIANGLES" | "INDICES" if view.filter.as_deref().is_some_and(|f| f != "NONE") => {
            Err("indices cannot have a filter".to_owned())
        }
        mode @ ("TRIANGLES" | "INDICES") => {
            if stride != 2 && stride != 4 {
                return Err(format!(
                    "the stride is {stride} bytes, but indices have 2 or 4 bytes"
                ));
            }
            // Each index of a sequence, and each three indices of a list, need at least one byte.
            if count / 3 > data.len() {
                return Err(truncated());
            }
            let indices = if mode == "TRIANGLES" {
                triangles(count, data)
            } else {
                index_sequence(count, data)
            };
            let indices = indices.ok_or("the index data are malformed or truncated")?;
            let mut out = Vec::with_capacity(size);
            for i in indices {
                if stride == 2 && i > 0xffff {
                    return Err(format!("the index {i} does not fit in 16 bits"));
                }
                out.extend_from_slice(&i.to_le_bytes()[..stride]);
            }
            Ok(out)
        }
        other => {
            let shown: String = other.chars().take(20).collect();
            Err(format!("the mode {shown} is unknown"))
        }
    }
}

#[cfg(test)]
mod tests;
