//! Checks that all indices are in range, and that faces and cells list each other.

use super::fault::Fault;
use crate::cells::{CellsView, NONE, Plane};
use crate::surfaces::SurfacesView;

/// Checks all indices in the lists of the cells, and that faces and cells list each other.
pub(crate) fn check(cells: CellsView<'_>, surfaces: SurfacesView<'_>) -> Result<(), Fault> {
    let n = surfaces.points.len();
    if cells.points.len() != n + 8 || cells.points[..n] != surfaces.points[..] || !is_box(cells, n)
    {
        return Err(Fault::Points);
    }
    let points = cells.points.len();
    let all = |list: &'static str, length: usize, is_good: &dyn Fn(usize) -> bool| {
        (0..length)
            .find(|i| !is_good(*i))
            .map_or(Ok(()), |index| Err(Fault::Number { list, index }))
    };
    all("planes", cells.planes.len(), &|i| {
        let Plane([a, b, c]) = cells.planes[i];
        let is_there = |p: u32| (p as usize) < points;
        is_there(a) && is_there(b) && (is_there(c) || (Plane::AXIS..Plane::AXIS + 3).contains(&c))
    })?;
    all("vertices", cells.meets.len(), &|i| {
        let meet = cells.meets[i];
        meet.is_sorted() && meet.iter().all(|p| (*p as usize) < cells.planes.len())
    })?;
    let faces = cells.faces.len().checked_sub(1).ok_or(Fault::Number {
        list: "faces",
        index: 0,
    })?;
    let count = cells.cells.len().checked_sub(1).ok_or(Fault::Number {
        list: "cells",
        index: 0,
    })?;
    let is_cell = |c: u32| c == NONE || (c as usize) < count;
    all("faces", faces, &|i| {
        let (face, next) = (cells.faces[i], cells.faces[i + 1]);
        (face.plane as usize) < cells.planes.len()
            && face
                .loop_start
                .checked_add(3)
                .is_some_and(|least| least <= next.loop_start)
            && face.triangles_start <= next.triangles_start
            && face.cells.into_iter().all(is_cell)
            && face.cells[0] != face.cells[1]
    })?;
    let (start, end) = (cells.faces[0], cells.faces[faces]);
    if (start.loop_start, start.triangles_start) != (0, 0)
        || end.loop_start as usize != cells.loops.len()
        || end.triangles_start as usize != cells.triangles.len()
    {
        return Err(Fault::Number {
            list: "faces",
            index: faces,
        });
    }
    all("vertices of faces", cells.loops.len(), &|i| {
        (cells.loops[i] as usize) < points + cells.meets.len()
    })?;
    all("triangles of faces", cells.triangles.len(), &|i| {
        (cells.triangles[i] as usize) < surfaces.triangles.len()
    })?;
    all("faces", faces, &|i| {
        cells.face_triangles(i).is_sorted_by(|a, b| a < b)
    })?;
    all("cells", count, &|i| {
        let least = cells.cells[i].faces_start.checked_add(4);
        least.is_some_and(|least| least <= cells.cells[i + 1].faces_start)
    })?;
    // The cells of one tetrahedron are consecutive, in the order of the tetrahedra.
    all("tetrahedra of cells", count + 1, &|i| {
        let own = cells.cells[i].tetrahedron;
        match i
            .checked_sub(1)
            .map(|before| cells.cells[before].tetrahedron)
        {
            _ if i == count => own == NONE,
            None => own == 0,
            Some(before) => own == before || Some(own) == before.checked_add(1),
        }
    })?;
    let ends = (
        cells.cells[0].faces_start,
        cells.cells[count].faces_start as usize,
    );
    if ends != (0, cells.cell_faces.len()) {
        return Err(Fault::Number {
            list: "cells",
            index: count,
        });
    }
    all("faces of cells", cells.cell_faces.len(), &|i| {
        (cells.cell_faces[i] as usize) < faces * 2
    })?;
    sides(cells, faces, count)
}

/// Checks that each cell of a face lists the face once, on the same side on which the face lists the cell.
fn sides(cells: CellsView<'_>, faces: usize, count: usize) -> Result<(), Fault> {
    let mut listed = vec![0u8; faces];
    for cell in 0..count {
        for f in cells.faces_of(cell) {
            let (face, side) = ((f / 2) as usize, (f & 1) as usize);
            if cells.faces[face].cells[side] as usize != cell || listed[face] >> side & 1 == 1 {
                return Err(Fault::Sides(f / 2));
            }
            listed[face] |= 1 << side;
        }
    }
    for (i, listed) in listed.into_iter().enumerate() {
        let named = (0..2)
            .filter(|side| cells.faces[i].cells[*side] != NONE)
            .fold(0, |bits, s| bits | 1 << s);
        if listed != named {
            return Err(Fault::Sides(i as u32));
        }
    }
    Ok(())
}

/// Returns the numbers of the points at the corners of the box with the smallest and the largest coordinates.
pub(super) fn bounds(cells: CellsView<'_>) -> [u32; 2] {
    let n = cells.points.len() - 8;
    // The corner with the smallest, or the largest, value in every coordinate.
    let corner = |is_ordered: fn(&f32, &f32) -> bool| {
        let is_extreme = |i: &usize| {
            let own = &cells.points[*i];
            cells.points[n..]
                .iter()
                .all(|p| own.iter().zip(p).all(|(a, b)| is_ordered(a, b)))
        };
        (n..n + 8).find(is_extreme).unwrap_or(n) as u32
    };
    [corner(|a, b| a <= b), corner(|a, b| a >= b)]
}

/// Returns true if the last eight points are the corners of a box that contains all other points.
///
/// The box must have a volume.
fn is_box(cells: CellsView<'_>, n: usize) -> bool {
    let corners = &cells.points[n..];
    let fold = |i: usize, pick: fn(f32, f32) -> f32, start: f32| {
        corners.iter().map(|p| p[i]).fold(start, pick)
    };
    let min: [f32; 3] = std::array::from_fn(|i| fold(i, f32::min, f32::INFINITY));
    let max: [f32; 3] = std::array::from_fn(|i| fold(i, f32::max, f32::NEG_INFINITY));
    let mut seen = 0u8;
    for corner in corners {
        let mut at = 0;
        for i in 0..3 {
            if corner[i] != min[i] && corner[i] != max[i] {
                return false;
            }
            at |= usize::from(corner[i] == max[i]) << i;
        }
        seen |= 1 << at;
    }
    let holds = |p: &[f32; 3]| (0..3).all(|i| (min[i]..=max[i]).contains(&p[i]));
    seen == u8::MAX
        && (0..3).all(|i| min[i] < max[i] && max[i].is_finite() && min[i].is_finite())
        && cells.points[..n].iter().all(holds)
}
