//! An opened `.tets` file with point queries for any number of threads.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use super::contents::Contents;
use super::error::TetsError;
use super::layout::Layout;
use crate::point_query::{
    Engine, LookError, Looker, Mode, Scratch, SearchBudget, Target, View, VisibleTriangles,
};

/// An opened `.tets` file. Threads can share the file, each with a separate [`Scratch`].
pub struct Tets {
    bytes: Bytes,
    layout: Layout,
    unit: i32,
}

/// Cost of a search through boxes: of a beam, and of a box that the beam enters, in microseconds.
///
/// The times were measured on one machine (`docs/experiments/look.md`). Only the ratios of these times and of
/// the times in [`OF_CELLS`] affect the choice of an engine.
const OF_BOXES: SearchBudget = SearchBudget {
    beam: 2.0,
    step: 0.5,
    most: f64::INFINITY,
};
/// Cost of a search through cells: of a beam, and of a cell that the beam enters, in microseconds.
const OF_CELLS: SearchBudget = SearchBudget {
    beam: 8.0,
    step: 1.0,
    most: f64::INFINITY,
};

/// Minimum size of a file, in bytes, at which [`Tets::open`] maps the file instead of reading it: 256 MiB.
pub const MAPPED_FROM: u64 = 256 << 20;

enum Bytes {
    Mapped(memmap2::Mmap),
    /// The content in 64-bit words, and the length in bytes.
    ///
    /// The words make the content start at a multiple of 8.
    Owned(Vec<u64>, usize),
}

impl Bytes {
    fn get(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Owned(words, length) => &bytemuck::cast_slice(words)[..*length],
        }
    }

    /// Reads a file that had `length` bytes when the file was opened.
    ///
    /// If another program truncates the file while it is read, the result has fewer bytes. The length in the
    /// header shows this.
    fn read(file: File, length: u64) -> std::io::Result<Self> {
        let no_memory = || std::io::Error::from(std::io::ErrorKind::OutOfMemory);
        let count = usize::try_from(length)
            .map_err(|_| no_memory())?
            .div_ceil(8);
        let mut words: Vec<u64> = Vec::new();
        words.try_reserve_exact(count).map_err(|_| no_memory())?;
        words.resize(count, 0);
        let (bytes, mut file) = (
            bytemuck::cast_slice_mut::<u64, u8>(&mut words),
            file.take(length),
        );
        let mut filled = 0;
        loop {
            match file.read(&mut bytes[filled..]) {
                Ok(0) => return Ok(Self::Owned(words, filled)),
                Ok(more) => filled += more,
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
    }
}

impl std::fmt::Debug for Tets {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tets")
            .field("layout", &self.layout)
            .finish_non_exhaustive()
    }
}

impl Tets {
    /// Opens a `.tets` file and checks all its checksums and indices.
    ///
    /// A file below [`MAPPED_FROM`] bytes is read into memory, and later changes of the file have no effect.
    ///
    /// A file of at least [`MAPPED_FROM`] bytes is mapped: the operating system loads the pages of the file
    /// on first use, and can drop these pages again. A mapped file must not be changed in place while it is
    /// open. If another program truncates the file, the operating system ends this process with SIGBUS. To
    /// replace the file, write another file and rename it, as `sightline tetra` does.
    ///
    /// # Errors
    /// [`TetsError`] if the file cannot be read, was cut short or altered, or contradicts itself.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, TetsError> {
        let path = path.as_ref();
        let failed = |source| TetsError::Open {
            path: path.to_owned(),
            source,
        };
        let file = File::open(path).map_err(failed)?;
        let metadata = file.metadata().map_err(failed)?;
        if metadata.is_dir() {
            return Err(failed(std::io::ErrorKind::IsADirectory.into()));
        }
        if metadata.len() < MAPPED_FROM {
            return Self::checked(Bytes::read(file, metadata.len()).map_err(failed)?);
        }
        #[allow(unsafe_code, reason = "mapping a file is unsafe")]
        // SAFETY: the map is read-only, and any bytes are valid numbers. The documentation of this function
        // forbids that another process changes or truncates the file while it is open.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(failed)?;
        Self::checked(Bytes::Mapped(map))
    }

    /// Checks the bytes of a complete `.tets` file, and copies the bytes.
    ///
    /// # Errors
    /// [`TetsError`] if the bytes were cut short or altered, or contradict themselves.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TetsError> {
        let mut words = vec![0u64; bytes.len().div_ceil(8)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        Self::checked(Bytes::Owned(words, bytes.len()))
    }

    fn checked(bytes: Bytes) -> Result<Self, TetsError> {
        let layout = Layout::parse(bytes.get())?;
        let contents = Contents::new(bytes.get(), &layout);
        contents.check_numbers()?;
        let unit = Looker::unit(contents.cells.points);
        Ok(Self {
            bytes,
            layout,
            unit,
        })
    }

    /// Returns the contents of the file as lists.
    pub fn contents(&self) -> Contents<'_> {
        Contents::new(self.bytes.get(), &self.layout)
    }

    fn looker(&self) -> Looker<'_> {
        let Contents {
            surfaces,
            cells,
            boxes,
            ..
        } = self.contents();
        Looker::with_unit(surfaces, boxes, cells, self.unit)
    }

    /// Finds a cell that contains the point `x`, in world coordinates, and returns the number of the cell. A
    /// cell contains its border.
    ///
    /// Returns `None` if the point is outside of the cells' box. The search walks from the cell `hint`, which
    /// should be near the point. Without a hint, the search starts at the nearest of several cells that are
    /// spread over the scene.
    ///
    /// # Errors
    /// [`LookError::Coordinate`] if a coordinate is not finite or exceeds 3.4e38.
    pub fn locate(&self, x: [f64; 3], hint: Option<u32>) -> Result<Option<u32>, LookError> {
        self.looker().locate(x, hint)
    }

    /// Returns true if the point `x` is strictly inside the union of all closed solids. The result is exact.
    ///
    /// Closed solids are closed surfaces of triangles that block and whose normals point out.
    ///
    /// # Errors
    /// [`LookError::Coordinate`] if a coordinate is not finite or exceeds 3.4e38.
    pub fn inside(&self, x: [f64; 3], scratch: &mut Scratch) -> Result<bool, LookError> {
        let windings = self.contents().windings;
        let cells = self.looker().cells_at(x, scratch)?;
        Ok(!cells.is_empty() && cells.iter().all(|cell| windings[cell.first as usize] > 0))
    }

    /// Computes the triangles that are visible from the point `x` ([`Looker::look`]).
    ///
    /// # Errors
    /// [`LookError`] if a coordinate, angle or distance is out of range.
    pub fn look<'s>(
        &self,
        x: [f64; 3],
        view: &View,
        mode: Mode,
        scratch: &'s mut Scratch,
    ) -> Result<&'s VisibleTriangles, LookError> {
        self.looker().look(x, view, mode, scratch)
    }

    /// Computes the exact visible fraction, from 0 to 1, of the solid angle of a box as seen from the point
    /// `x` ([`Looker::sees`]).
    ///
    /// # Errors
    /// [`LookError`] if a coordinate, angle or distance is out of range.
    pub fn sees(
        &self,
        x: [f64; 3],
        target: &Target,
        scratch: &mut Scratch,
    ) -> Result<f64, LookError> {
        self.sees_in(x, target, &View::default(), Mode::Exact, scratch)
    }

    /// Computes the visible fraction of the solid angle of a box, from 0 to 1, with a view and a mode
    /// ([`Looker::sees`]).
    ///
    /// # Errors
    /// [`LookError`] if a coordinate, angle or distance is out of range.
    pub fn sees_in(
        &self,
        x: [f64; 3],
        target: &Target,
        view: &View,
        mode: Mode,
        scratch: &mut Scratch,
    ) -> Result<f64, LookError> {
        self.looker().sees(x, target, view, mode, scratch)
    }

    /// Returns the engine that is expected to answer queries near the point `x` faster.
    ///
    /// The function runs the query with both engines, and compares the numbers of beams and of boxes or cells
    /// that each engine visits. So the same arguments return the same engine on every machine. In the
    /// conservative mode the result is always [`Engine::Cells`]: this engine visits cells in front-to-back
    /// order, so its sets contain fewer hidden triangles. `scratch.seen` does not contain a valid answer
    /// afterwards.
    ///
    /// # Errors
    /// [`LookError`] if a coordinate, angle or distance is out of range.
    pub fn faster(
        &self,
        x: [f64; 3],
        view: &View,
        mode: Mode,
        scratch: &mut Scratch,
    ) -> Result<Engine, LookError> {
        if matches!(mode, Mode::Conservative(_)) {
            return Ok(Engine::Cells);
        }
        let looker = self.looker();
        let is_enough = |engine, budget: &SearchBudget, scratch: &mut Scratch| {
            let view = View {
                engine,
                witnesses: false,
                ..view.clone()
            };
            looker.look_for(x, &view, mode, budget, scratch)
        };
        is_enough(Engine::Boxes, &OF_BOXES, scratch)?;
        // The search through cells stops as soon as it costs more than the search through boxes.
        let cells = SearchBudget {
            most: OF_BOXES.cost(&scratch.seen),
            ..OF_CELLS
        };
        Ok(if is_enough(Engine::Cells, &cells, scratch)? {
            Engine::Cells
        } else {
            Engine::Boxes
        })
    }
}
