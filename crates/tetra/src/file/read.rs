//! Reading a `.tets` file: nothing is used before its checksum, and no number before it names something.

use std::fs::File;
use std::path::Path;

use crate::cells::{CellRecord, Cells, FaceRecord, Plane};
use crate::check::structure;
use crate::surfaces::{BLOCKS, FLAT, SHOWS, Surfaces};

use super::error::TetsError;
use super::layout::{Layout, Section, u32_at, u64_at};

/// What is in a `.tets` file.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// The digest of the scene.
    pub digest: [u8; 32],
    /// The surfaces.
    pub surfaces: Surfaces,
    /// The cells. All their numbers name something; `check` says whether they are right.
    pub cells: Cells,
    /// The bytes of the hierarchy; empty when the file has none.
    pub hierarchy: Vec<u8>,
}

impl Contents {
    /// Reads a file.
    ///
    /// # Errors
    /// [`TetsError`] for a file that cannot be read, was cut short or altered, or contradicts itself.
    pub fn open(path: &Path) -> Result<Self, TetsError> {
        let failed = |source| TetsError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        if file.metadata().map_err(failed)?.len() == 0 {
            // Nothing cannot be mapped everywhere.
            return Err(TetsError::NotTets);
        }
        // SAFETY: the map is read-only and used within this function alone. Where another process changes the
        // file meanwhile, what is read is checked after it was copied, and a file that is cut short then ends
        // the process, as every mapped file does.
        #[allow(unsafe_code, reason = "mapping a file is unsafe")]
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(failed)?;
        Self::read(&map)
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// [`TetsError`] for bytes that were cut short or altered, or contradict themselves.
    pub fn read(file: &[u8]) -> Result<Self, TetsError> {
        let layout = Layout::parse(file)?;
        let part = |section| &file[layout.range(section)];
        let mut points = triples(part(Section::Points), f32::from_bits);
        let cells = Cells {
            points: points.clone(),
            planes: triples(part(Section::Planes), |w| w).into_iter().map(Plane).collect(),
            meets: triples(part(Section::Meets), |w| w),
            rounded: part(Section::Rounded)
                .chunks_exact(24)
                .map(|c| std::array::from_fn(|i| f64::from_bits(u64_at(c, i * 8))))
                .collect(),
            faces: part(Section::Faces)
                .chunks_exact(20)
                .map(|c| FaceRecord {
                    plane: u32_at(c, 0),
                    loop_start: u32_at(c, 4),
                    triangles_start: u32_at(c, 8),
                    cells: [u32_at(c, 12), u32_at(c, 16)],
                })
                .collect(),
            loops: words(part(Section::Loops)),
            triangles: words(part(Section::Covers)),
            cells: part(Section::Cells)
                .chunks_exact(8)
                .map(|c| CellRecord { tetrahedron: u32_at(c, 0), faces_start: u32_at(c, 4) })
                .collect(),
            cell_faces: words(part(Section::CellFaces)),
        };
        let own = points.len().checked_sub(8);
        points
            .truncate(own.ok_or_else(|| Section::Points.malformed("the corners of the box are not there"))?);
        let triangles = triples(part(Section::Triangles), |w| w);
        let surfaces = Surfaces { points, triangles, flags: part(Section::Flags).to_vec() };
        check_surfaces(&surfaces)?;
        if !cells.points.as_flattened().iter().all(|x| x.is_finite()) {
            return Err(Section::Points.malformed("a coordinate is not a finite number"));
        }
        if cells.rounded.len() != cells.meets.len()
            || !cells.rounded.as_flattened().iter().all(|x| x.is_finite())
        {
            return Err(Section::Rounded.malformed("it is not a finite place for each vertex"));
        }
        structure::check(&cells, &surfaces).map_err(|fault| Section::Cells.malformed(fault.to_string()))?;
        let hierarchy = part(Section::Hierarchy).to_vec();
        Ok(Self { digest: layout.digest, surfaces, cells, hierarchy })
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
        Err(TetsError::OtherScene { found: text(&self.digest), wanted: text(digest) })
    }
}

fn check_surfaces(surfaces: &Surfaces) -> Result<(), TetsError> {
    let n = surfaces.points.len();
    if surfaces.triangles.as_flattened().iter().any(|p| *p as usize >= n) {
        return Err(Section::Triangles.malformed("a corner is no point"));
    }
    let known = FLAT | BLOCKS | SHOWS;
    if surfaces.flags.len() != surfaces.triangles.len() || surfaces.flags.iter().any(|f| f & !known != 0) {
        return Err(Section::Flags.malformed("it is not one known byte for each triangle"));
    }
    Ok(())
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|c| u32_at(c, 0)).collect()
}

fn triples<T>(bytes: &[u8], of: impl Fn(u32) -> T) -> Vec<[T; 3]> {
    bytes.chunks_exact(12).map(|c| std::array::from_fn(|i| of(u32_at(c, i * 4)))).collect()
}
