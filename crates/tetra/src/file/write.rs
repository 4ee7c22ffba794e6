//! The writer of `.tets` files.

use std::io::Write;

use bytemuck::cast_slice;

use super::contents::Contents;
use super::error::TetsError;
use super::layout::{Section, header};

/// Writes `contents` as a `.tets` file to `to`.
///
/// # Errors
/// [`TetsError::Write`] if the writer fails.
pub fn write(to: &mut dyn Write, contents: &Contents<'_>) -> Result<(), TetsError> {
    let sections = Section::ALL.map(|section| {
        let bytes = bytes(section, contents);
        (crc32c::crc32c(bytes), bytes.len() as u64)
    });
    let header = header(&contents.digest, &sections);
    to.write_all(&header).map_err(TetsError::Write)?;
    let mut at = header.len();
    for section in Section::ALL {
        let bytes = bytes(section, contents);
        let gap = at.next_multiple_of(8) - at;
        to.write_all(&[0; 8][..gap])
            .and_then(|()| to.write_all(bytes))
            .map_err(TetsError::Write)?;
        at += gap + bytes.len();
    }
    Ok(())
}

fn bytes<'a>(section: Section, contents: &Contents<'a>) -> &'a [u8] {
    let Contents {
        surfaces,
        cells,
        windings,
        boxes,
        ..
    } = *contents;
    match section {
        Section::Points => cast_slice(cells.points),
        Section::Triangles => cast_slice(surfaces.triangles),
        Section::Flags => surfaces.flags,
        Section::Planes => cast_slice(cells.planes),
        Section::Meets => cast_slice(cells.meets),
        Section::Rounded => cast_slice(cells.rounded),
        Section::Faces => cast_slice(cells.faces),
        Section::Loops => cast_slice(cells.loops),
        Section::Covers => cast_slice(cells.triangles),
        Section::Cells => cast_slice(cells.cells),
        Section::CellFaces => cast_slice(cells.cell_faces),
        Section::Windings => cast_slice(windings),
        Section::Boxes => cast_slice(boxes.nodes),
        Section::Order => cast_slice(boxes.order),
        Section::Neighbours => cast_slice(boxes.neighbours),
    }
}
