//! The contents of a `.tets` file as borrowed lists, and the checks of the lists.

use bytemuck::{AnyBitPattern, cast_slice};

use super::error::TetsError;
use super::layout::{Layout, Section};
use crate::cells::CellsView;
use crate::check::structure;
use crate::point_query::{Boxes, neighbours};
use crate::surfaces::{BLOCKS, CLOSED, FLAT, SHOWS, SurfacesView};

#[cfg(target_endian = "big")]
compile_error!("a .tets file is used in place, and its numbers are little-endian");

/// The contents of a `.tets` file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contents<'a> {
    /// The digest of the scene.
    pub digest: [u8; 32],
    /// The triangles of the scene, with corners as indices of distinct points.
    pub surfaces: SurfacesView<'a>,
    /// The cells between the surfaces.
    pub cells: CellsView<'a>,
    /// The number of closed solids around each cell (`windings::windings`).
    pub windings: &'a [i32],
    /// The hierarchy of boxes over the triangles.
    pub boxes: Boxes<'a>,
}

impl<'a> Contents<'a> {
    /// Casts the bytes of a file to the lists of the file.
    ///
    /// The bytes must start at a multiple of 8. The function does not check the values in the lists.
    pub(super) fn new(file: &'a [u8], layout: &Layout) -> Self {
        fn part<'a, T: AnyBitPattern>(
            file: &'a [u8],
            layout: &Layout,
            section: Section,
        ) -> &'a [T] {
            // `Layout::parse` checked that sections start at multiples of 8 and end with a whole entry.
            cast_slice(&file[layout.range(section)])
        }
        let points: &[[f32; 3]] = part(file, layout, Section::Points);
        let cells = CellsView {
            points,
            planes: part(file, layout, Section::Planes),
            meets: part(file, layout, Section::Meets),
            rounded: part(file, layout, Section::Rounded),
            faces: part(file, layout, Section::Faces),
            loops: part(file, layout, Section::Loops),
            triangles: part(file, layout, Section::Covers),
            cells: part(file, layout, Section::Cells),
            cell_faces: part(file, layout, Section::CellFaces),
        };
        let surfaces = SurfacesView {
            points: &points[..points.len().saturating_sub(8)],
            triangles: part(file, layout, Section::Triangles),
            flags: part(file, layout, Section::Flags),
        };
        Self {
            digest: layout.digest,
            surfaces,
            cells,
            windings: part(file, layout, Section::Windings),
            boxes: Boxes {
                nodes: part(file, layout, Section::Boxes),
                order: part(file, layout, Section::Order),
                neighbours: part(file, layout, Section::Neighbours),
            },
        }
    }

    /// Checks that all indices are in range, and that boxes contain their triangles.
    ///
    /// Also checks that cells and faces list each other. This function does not check the geometry of the
    /// cells and the numbers of solids around cells; [`crate::check::check`] does.
    ///
    /// # Errors
    /// [`TetsError::Malformed`] if an index is out of range, or if two lists contradict each other.
    pub fn check_numbers(&self) -> Result<(), TetsError> {
        let Self {
            surfaces, cells, ..
        } = *self;
        if cells.points.len() < 8 {
            return Err(
                Section::Points.malformed("the list is too short for the eight corners of the box")
            );
        }
        if !cells.points.as_flattened().iter().all(|x| x.is_finite()) {
            return Err(Section::Points.malformed("a coordinate is not a finite number"));
        }
        let n = surfaces.points.len();
        if surfaces
            .triangles
            .as_flattened()
            .iter()
            .any(|p| *p as usize >= n)
        {
            return Err(Section::Triangles.malformed("a corner is not the index of a point"));
        }
        let known = FLAT | BLOCKS | SHOWS | CLOSED;
        if surfaces.flags.len() != surfaces.triangles.len()
            || surfaces.flags.iter().any(|f| f & !known != 0)
        {
            return Err(Section::Flags
                .malformed("the list does not contain one byte of known flags per triangle"));
        }
        if cells.rounded.len() != cells.meets.len()
            || !cells.rounded.as_flattened().iter().all(|x| x.is_finite())
        {
            return Err(Section::Rounded
                .malformed("the list does not contain one finite position per vertex"));
        }
        structure::check(cells, surfaces)
            .map_err(|fault| Section::Cells.malformed(fault.to_string()))?;
        if self.windings.len() != cells.cell_count() {
            return Err(
                Section::Windings.malformed("the list does not contain one number per cell")
            );
        }
        neighbours::check(self.boxes.neighbours, surfaces)
            .map_err(|reason| Section::Neighbours.malformed(reason))?;
        self.boxes
            .check(surfaces)
            .map_err(|reason| Section::Boxes.malformed(reason))
    }

    /// Checks that the file was built from the scene with this digest.
    ///
    /// # Errors
    /// [`TetsError::OtherScene`] if the digest of the file differs.
    pub fn expect_scene(&self, digest: &[u8; 32]) -> Result<(), TetsError> {
        if self.digest == *digest {
            return Ok(());
        }
        let text = |d: &[u8; 32]| d.iter().map(|b| format!("{b:02x}")).collect();
        Err(TetsError::OtherScene {
            found: text(&self.digest),
            wanted: text(digest),
        })
    }
}
