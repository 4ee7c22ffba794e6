//! Writing a `.tets` file.

use std::io::Write;

use crate::cells::Cells;
use crate::surfaces::Surfaces;

use super::error::TetsError;
use super::layout::{Section, header};

/// Writes surfaces and their cells, with the digest of their scene and the bytes of a hierarchy.
///
/// # Errors
/// [`TetsError::Write`].
pub fn write(
    to: &mut impl Write,
    digest: &[u8; 32],
    surfaces: &Surfaces,
    cells: &Cells,
    hierarchy: &[u8],
) -> Result<(), TetsError> {
    // Each section is made twice, for its checksum and for the file: less memory than all at once.
    let part = |section| bytes(section, surfaces, cells, hierarchy);
    let sections = Section::ALL.map(|section| {
        let bytes = part(section);
        (crc32c::crc32c(&bytes), bytes.len() as u64)
    });
    let header = header(digest, &sections);
    to.write_all(&header).map_err(TetsError::Write)?;
    let mut at = header.len();
    for section in Section::ALL {
        let bytes = part(section);
        let gap = at.next_multiple_of(8) - at;
        to.write_all(&[0; 8][..gap]).and_then(|()| to.write_all(&bytes)).map_err(TetsError::Write)?;
        at += gap + bytes.len();
    }
    Ok(())
}

fn bytes(section: Section, surfaces: &Surfaces, cells: &Cells, hierarchy: &[u8]) -> Vec<u8> {
    let words = |words: &[u32]| words.iter().flat_map(|w| w.to_le_bytes()).collect();
    match section {
        Section::Points => cells.points.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect(),
        Section::Triangles => words(surfaces.triangles.as_flattened()),
        Section::Flags => surfaces.flags.clone(),
        Section::Planes => cells.planes.iter().flat_map(|p| p.0).flat_map(u32::to_le_bytes).collect(),
        Section::Meets => words(cells.meets.as_flattened()),
        Section::Rounded => cells.rounded.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect(),
        Section::Faces => {
            let record = |f: &crate::cells::FaceRecord| {
                [f.plane, f.loop_start, f.triangles_start, f.cells[0], f.cells[1]]
            };
            cells.faces.iter().flat_map(record).flat_map(u32::to_le_bytes).collect()
        }
        Section::Loops => words(&cells.loops),
        Section::Covers => words(&cells.triangles),
        Section::Cells => {
            let record = |c: &crate::cells::CellRecord| [c.tetrahedron, c.faces_start];
            cells.cells.iter().flat_map(record).flat_map(u32::to_le_bytes).collect()
        }
        Section::CellFaces => words(&cells.cell_faces),
        Section::Hierarchy => hierarchy.to_vec(),
    }
}
