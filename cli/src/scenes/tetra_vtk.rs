//! `sightline tetra --export`: writes cells as tetrahedra in VTK's XML format for unstructured grids.
//!
//! The arrays are in base64 after their length in bytes as a u64, all little-endian ("VTK XML Formats", VTK's
//! documentation).

use std::io::Write;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use sightline::Error;
use sightline::output::Output;
use sightline_tetra::division::{Divided, divide};
use sightline_tetra::file::Contents;

/// The number of the cell type triangle in VTK.
const TRIANGLE: u8 = 5;
/// The number of the cell type tetrahedron in VTK.
const TETRAHEDRON: u8 = 10;

/// Writes the tetrahedra of all cells, and the triangles of the scene. Returns the number of tetrahedra.
///
/// # Errors
/// [`Error`] if the file cannot be written.
pub fn export(contents: &Contents<'_>, output: &Output) -> Result<u64, Error> {
    let divided = divide(contents);
    output.write(|out| {
        write(contents, &divided, out).map_err(|e| Error::writing(output.path(), &e))
    })?;
    Ok(divided.tetrahedra.len() as u64)
}

fn write(contents: &Contents<'_>, divided: &Divided, out: &mut dyn Write) -> std::io::Result<()> {
    let Divided {
        places,
        tetrahedra,
        cells,
        faces,
        triangles,
    } = divided;
    let (solid, flat) = (tetrahedra.len(), faces.len());
    writeln!(
        out,
        r#"<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">"#
    )?;
    writeln!(out, "<UnstructuredGrid>")?;
    writeln!(
        out,
        r#"<Piece NumberOfPoints="{}" NumberOfCells="{}">"#,
        places.len(),
        solid + flat
    )?;
    writeln!(out, "<Points>")?;
    let coordinates = places.as_flattened().iter().flat_map(|x| x.to_le_bytes());
    array(
        out,
        r#"type="Float64" Name="Points" NumberOfComponents="3""#,
        coordinates,
    )?;
    writeln!(out, "</Points>\n<Cells>")?;
    let corners = tetrahedra.as_flattened().iter().chain(faces.as_flattened());
    array(
        out,
        r#"type="Int64" Name="connectivity""#,
        corners.flat_map(|v| i64::from(*v).to_le_bytes()),
    )?;
    let ends = (1..=solid)
        .map(|k| 4 * k)
        .chain((1..=flat).map(|k| 4 * solid + 3 * k));
    array(
        out,
        r#"type="Int64" Name="offsets""#,
        ends.flat_map(|end| (end as i64).to_le_bytes()),
    )?;
    let kinds = std::iter::repeat_n(TETRAHEDRON, solid).chain(std::iter::repeat_n(TRIANGLE, flat));
    array(out, r#"type="UInt8" Name="types""#, kinds)?;
    writeln!(out, "</Cells>\n<CellData>")?;
    let none = |count: usize| std::iter::repeat_n(-1i64, count);
    let cell_numbers = cells.iter().map(|c| i64::from(*c)).chain(none(flat));
    array(
        out,
        r#"type="Int64" Name="cell""#,
        cell_numbers.flat_map(i64::to_le_bytes),
    )?;
    let solids = cells
        .iter()
        .map(|c| i64::from(contents.windings[*c as usize]))
        .chain(none(flat));
    array(
        out,
        r#"type="Int64" Name="solids""#,
        solids.flat_map(i64::to_le_bytes),
    )?;
    let triangle_numbers = none(solid).chain(triangles.iter().map(|t| i64::from(*t)));
    array(
        out,
        r#"type="Int64" Name="triangle""#,
        triangle_numbers.flat_map(i64::to_le_bytes),
    )?;
    writeln!(
        out,
        "</CellData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>"
    )
}

/// Writes one array: its length in bytes and its bytes as one text in base64.
fn array(
    out: &mut dyn Write,
    attributes: &str,
    bytes: impl Iterator<Item = u8> + Clone,
) -> std::io::Result<()> {
    writeln!(out, r#"<DataArray {attributes} format="binary">"#)?;
    let length = bytes.clone().count() as u64;
    let mut all = length.to_le_bytes().into_iter().chain(bytes);
    // A multiple of 3 bytes at a time needs no padding in the middle.
    let mut part = Vec::with_capacity(3 << 14);
    loop {
        part.clear();
        part.extend(all.by_ref().take(3 << 14));
        if part.is_empty() {
            return writeln!(out, "\n</DataArray>");
        }
        out.write_all(STANDARD.encode(&part).as_bytes())?;
    }
}
