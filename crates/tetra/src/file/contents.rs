//! What is in a `.tets` file, as lists that are used where they are, and whether their numbers name
//! something.

use bytemuck::{AnyBitPattern, cast_slice};

use super::error::TetsError;
use super::layout::{Layout, Section};
use crate::cells::CellsView;
use crate::check::structure;
use crate::look::{Boxes, neighbours};
use crate::surfaces::{BLOCKS, CLOSED, FLAT, SHOWS, SurfacesView};

#[cfg(target_endian = "big")]
compile_error!("a .tets file is used in place, and its numbers are little-endian");

/// What is in a `.tets` file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contents<'a> {
    /// The digest of the scene.
    pub digest: [u8; 32],
    /// The surfaces.
    pub surfaces: SurfacesView<'a>,
    /// The cells between them.
    pub cells: CellsView<'a>,
    /// How many closed solids hold each cell (`windings::windings`).
    pub windings: &'a [i32],
    /// The boxes over the triangles.
    pub boxes: Boxes<'a>,
}

impl<'a> Contents<'a> {
    /// The lists in the bytes of a file, which must start at a multiple of 8. What is in the lists is not
    /// looked at.
    pub(super) fn of(file: &'a [u8], layout: &Layout) -> Self {
        fn part<'a, T: AnyBitPattern>(
            file: &'a [u8],
            layout: &Layout,
            section: Section,
        ) -> &'a [T] {
            // Sections start at multiples of 8 and end with a whole entry: `Layout::parse` has seen to it.
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

    /// That all numbers name something, that cells and faces list each other, and that boxes hold what is in
    /// them. Whether the cells are right, and the solids around them, is for `check` to say.
    ///
    /// # Errors
    /// [`TetsError::Malformed`].
    pub fn check_numbers(&self) -> Result<(), TetsError> {
        let Self {
            surfaces, cells, ..
        } = *self;
        if cells.points.len() < 8 {
            return Err(Section::Points.malformed("the corners of the box are not there"));
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
            return Err(Section::Triangles.malformed("a corner is no point"));
        }
        let known = FLAT | BLOCKS | SHOWS | CLOSED;
        if surfaces.flags.len() != surfaces.triangles.len()
            || surfaces.flags.iter().any(|f| f & !known != 0)
        {
            return Err(Section::Flags.malformed("it is not one known byte for each triangle"));
        }
        if cells.rounded.len() != cells.meets.len()
            || !cells.rounded.as_flattened().iter().all(|x| x.is_finite())
        {
            return Err(Section::Rounded.malformed("it is not a finite place for each vertex"));
        }
        structure::check(cells, surfaces)
            .map_err(|fault| Section::Cells.malformed(fault.to_string()))?;
        if self.windings.len() != cells.cell_count() {
            return Err(Section::Windings.malformed("it is not one number for each cell"));
        }
        neighbours::check(self.boxes.neighbours, surfaces)
            .map_err(|reason| Section::Neighbours.malformed(reason))?;
        self.boxes
            .check(surfaces)
            .map_err(|reason| Section::Boxes.malformed(reason))
    }

    /// That the file is of the scene with a digest.
    ///
    /// # Errors
    /// [`TetsError::OtherScene`].
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
