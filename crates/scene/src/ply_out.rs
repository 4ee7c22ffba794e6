//! The writer of scenes as binary little-endian PLY, with the triangles in id order.
//!
//! Each triangle has three separate vertices: corner c of triangle id is vertex 3·id + c. Objects are not
//! written, because PLY has no element for them.

use std::io::{self, Write};

use crate::Scene;

/// The approximate number of bytes of one write.
const CHUNK: usize = 1 << 16;

/// Writes `scene` in world space as binary little-endian PLY. Readers get the same vertices bit for bit.
///
/// # Errors
/// The errors of `out`, and [`io::ErrorKind::InvalidInput`] if there are too many vertices for 32-bit
/// indices.
pub fn write_mesh_ply(scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
    let faces = scene.len();
    let Some(vertices) = faces.checked_mul(3) else {
        let what = format!(
            "{faces} triangles have more vertices than the 32-bit indices of PLY can number; split the scene"
        );
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    };
    // More readers support `int` than `uint`, so use `uint` only for indices above the range of `int`.
    let index = if i32::try_from(vertices).is_ok() {
        "int"
    } else {
        "uint"
    };
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment triangle id = face number; vertex 3*id + corner\n\
         element vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {faces}\nproperty list uchar {index} vertex_indices\nend_header\n"
    )?;
    let mut chunk = Vec::with_capacity(CHUNK + 64);
    for t in scene.triangles() {
        for c in t.v.iter().flat_map(|v| v.to_array()) {
            chunk.extend_from_slice(&c.to_le_bytes());
        }
        flush_full(&mut chunk, out)?;
    }
    for id in 0..faces {
        chunk.push(3);
        for corner in 0..3 {
            // 3·id + corner < `vertices`, which fits.
            chunk.extend_from_slice(&(3 * id + corner).to_le_bytes());
        }
        flush_full(&mut chunk, out)?;
    }
    out.write_all(&chunk)
}

/// Writes the chunk if it is full.
fn flush_full(chunk: &mut Vec<u8>, out: &mut dyn Write) -> io::Result<()> {
    if chunk.len() >= CHUNK {
        out.write_all(chunk)?;
        chunk.clear();
    }
    Ok(())
}
