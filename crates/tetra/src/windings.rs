//! Winding numbers: the number of closed solids around each cell.
//!
//! The border of a solid consists of triangles, and triangles are unions of faces. No solid reaches beyond
//! the box. So the number of solids around a cell follows exactly from the number around a neighbouring cell:
//! crossing a triangle of a solid's surface against the triangle's normal adds 1, and crossing the triangle
//! along its normal subtracts 1.

use std::cmp::Ordering;

use crate::cells::{CellsView, NONE};
use crate::surfaces::{CLOSED, SurfacesView};

/// Computes the number of closed solids around each cell.
pub fn windings(surfaces: SurfacesView<'_>, cells: CellsView<'_>) -> Vec<i32> {
    let mut all = vec![0i32; cells.cell_count()];
    let mut known = vec![false; all.len()];
    let mut open: Vec<u32> = Vec::new();
    for face in &cells.faces[..cells.face_count()] {
        // Triangles do not touch the border of the box, so no solid contains a cell at the border.
        if let [NONE, cell] | [cell, NONE] = face.cells
            && let Some(known) = known.get_mut(cell as usize)
            && !std::mem::replace(known, true)
        {
            open.push(cell);
        }
    }
    while let Some(cell) = open.pop() {
        for listed in cells.faces_of(cell as usize) {
            let face = (listed >> 1) as usize;
            let other = cells.faces[face].cells[1 - (listed & 1) as usize];
            if other == NONE || std::mem::replace(&mut known[other as usize], true) {
                continue;
            }
            let step = behind_less_front(surfaces, cells, face);
            let is_behind = listed & 1 == 1;
            all[other as usize] = all[cell as usize] + if is_behind { -step } else { step };
            open.push(other);
        }
    }
    all
}

/// Returns the number of solids around the cell behind a face minus the number in front.
fn behind_less_front(surfaces: SurfacesView<'_>, cells: CellsView<'_>, face: usize) -> i32 {
    let plane = cells.planes[cells.faces[face].plane as usize];
    let closed = |t: &&u32| surfaces.flags[**t as usize] & CLOSED != 0;
    let way = |t: &u32| {
        let [a, b, c] = surfaces.triangles[*t as usize];
        let own = crate::cells::Plane([a, b, c]);
        // A normal has a nonzero coordinate, and normals of one plane are multiples of each other.
        let signs = (0..3).map(|axis| {
            (
                own.normal_sign(cells.points, axis),
                plane.normal_sign(cells.points, axis),
            )
        });
        let agrees = signs
            .filter(|(own, _)| *own != Ordering::Equal)
            .map(|(own, plane)| own == plane)
            .next();
        if agrees == Some(true) { 1 } else { -1 }
    };
    cells
        .face_triangles(face)
        .iter()
        .filter(closed)
        .map(way)
        .sum()
}
