//! EXT_meshopt_compression: decoding compressed buffer views (appendix A of the extension's specification).
//!
//! The decoders are our own safe Rust, written from the extension's text: the crate `meshopt-rs` takes the
//! size of an element from a Rust type, where a file gives any stride, and `meshopt` binds the C++ library,
//! which needs a C++ compiler. The tests decode data encoded by `meshopt-rs`. Of the filters only EXPONENTIAL
//! is decoded, the only one for positions.

mod attributes;
mod indices;

use attributes::{attributes, exponential};
use indices::{index_sequence, triangles};

use super::json::MeshoptView;

/// The uncompressed bytes of the view: `count * byteStride` bytes.
///
/// # Errors
/// A sentence about the view that says what is wrong.
pub(super) fn decode(view: &MeshoptView, data: &[u8]) -> Result<Vec<u8>, String> {
    let truncated = || "its data are too short for its count".to_owned();
    let (count, stride) = (view.count, view.byte_stride);
    let size = count.checked_mul(stride).ok_or_else(truncated)?;
    // A byte of the densest stream gives at most 64 bytes, since a group of sixteen zeros takes two bits.
    if size / 64 > data.len() as u64 {
        return Err(truncated());
    }
    // The size is at most 64 times the length of a slice, and the count is at most the size.
    let (count, stride, size) = (count as usize, stride as usize, size as usize);
    let filter = view.filter.as_deref().unwrap_or("NONE");
    match view.mode.as_str() {
        "ATTRIBUTES" => {
            if stride == 0 || stride > 256 || stride % 4 != 0 {
                return Err(format!("its stride of {stride} bytes is not a multiple of 4 up to 256"));
            }
            let mut out = vec![0; size];
            attributes(&mut out, stride, data).ok_or("its vertex data are malformed or truncated")?;
            match filter {
                "NONE" => {}
                "EXPONENTIAL" => exponential(&mut out),
                other => {
                    let shown: String = other.chars().take(20).collect();
                    return Err(format!("the filter {shown} is not one for positions"));
                }
            }
            Ok(out)
        }
        "TRIANGLES" | "INDICES" if filter != "NONE" => Err("indices cannot have a filter".to_owned()),
        mode @ ("TRIANGLES" | "INDICES") => {
            if stride != 2 && stride != 4 {
                return Err(format!("its stride is {stride} bytes, and indices take 2 or 4"));
            }
            // Each index of a sequence, and each three indices of a list, take at least one byte.
            if count / 3 > data.len() {
                return Err(truncated());
            }
            let indices =
                if mode == "TRIANGLES" { triangles(count, data) } else { index_sequence(count, data) };
            let indices = indices.ok_or("its index data are malformed or truncated")?;
            let mut out = Vec::with_capacity(size);
            for i in indices {
                if stride == 2 && i > 0xffff {
                    return Err(format!("its index {i} does not fit 16 bits"));
                }
                out.extend_from_slice(&i.to_le_bytes()[..stride]);
            }
            Ok(out)
        }
        other => {
            let shown: String = other.chars().take(20).collect();
            Err(format!("its mode {shown} is unknown"))
        }
    }
}

#[cfg(test)]
mod tests;
