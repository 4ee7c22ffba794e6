//! An opened `.tets` file: questions about points, for any number of threads.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use super::contents::Contents;
use super::error::TetsError;
use super::layout::Layout;
use crate::look::{Budget, Engine, LookError, Looker, Mode, Scratch, Seen, Target, View};

/// An opened file. Threads can share it, each with a [`Scratch`] of its own.
pub struct Tets {
    bytes: Bytes,
    layout: Layout,
    unit: i32,
}

/// Microseconds that a beam takes, and a box or a cell that it enters, on one machine
/// (`docs/experiments/look.md`). Only their relations count.
const OF_BOXES: Budget = Budget {
    beam: 2.0,
    step: 0.5,
    most: f64::INFINITY,
};
const OF_CELLS: Budget = Budget {
    beam: 8.0,
    step: 1.0,
    most: f64::INFINITY,
};

/// Size in bytes from which [`Tets::open`] maps a file instead of reading it: 256 MiB.
pub const MAPPED_FROM: u64 = 256 << 20;

enum Bytes {
    Mapped(memmap2::Mmap),
    /// In words, so that they start at a multiple of 8, and their number of bytes.
    Owned(Vec<u64>, usize),
}

impl Bytes {
    fn get(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Owned(words, length) => &bytemuck::cast_slice(words)[..*length],
        }
    }

    /// Reads a file that had `length` bytes when it was opened. A file that is cut while it is read gives
    /// fewer bytes, which the header's length shows.
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
    /// Opens a file and checks its checksums and all its numbers. Below [`MAPPED_FROM`] bytes the file is
    /// read into memory, and later changes of the file do not matter.
    ///
    /// A larger file is mapped: the operating system loads its pages as they are used, and can drop them. A
    /// mapped file must not be changed in place while it is open. If another program cuts it, the operating
    /// system ends this process with SIGBUS. Replace it by writing another file and renaming it, as
    /// `sightline tetra` does.
    ///
    /// # Errors
    /// [`TetsError`] for a file that cannot be read, was cut short or altered, or contradicts itself.
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
        // SAFETY: the map is read-only, and any bytes are valid numbers. Another process must not change or
        // truncate the file while it is open, which the documentation above forbids.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(failed)?;
        Self::checked(Bytes::Mapped(map))
    }

    /// Checks a whole file that is in memory, and copies it.
    ///
    /// # Errors
    /// [`TetsError`] for bytes that were cut short or altered, or contradict themselves.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TetsError> {
        let mut words = vec![0u64; bytes.len().div_ceil(8)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        Self::checked(Bytes::Owned(words, bytes.len()))
    }

    fn checked(bytes: Bytes) -> Result<Self, TetsError> {
        let layout = Layout::parse(bytes.get())?;
        let contents = Contents::of(bytes.get(), &layout);
        contents.check_numbers()?;
        let unit = Looker::unit(contents.cells.points);
        Ok(Self {
            bytes,
            layout,
            unit,
        })
    }

    /// What is in the file.
    pub fn contents(&self) -> Contents<'_> {
        Contents::of(self.bytes.get(), &self.layout)
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

    /// A cell that holds a point in world coordinates, its border included; nothing outside of the cells'
    /// box. The search walks from the cell `hint`, best that of a point nearby; without one it starts at the
    /// nearest of some cells that are spread over the scene.
    ///
    /// # Errors
    /// [`LookError::Coordinate`] for numbers that are out of range.
    pub fn locate(&self, x: [f64; 3], hint: Option<u32>) -> Result<Option<u32>, LookError> {
        self.looker().locate(x, hint)
    }

    /// Whether a point is inside of the union of all closed solids, which block and whose normals point out;
    /// not on its border. Exact.
    ///
    /// # Errors
    /// [`LookError::Coordinate`] for numbers that are out of range.
    pub fn inside(&self, x: [f64; 3], scratch: &mut Scratch) -> Result<bool, LookError> {
        let windings = self.contents().windings;
        let cells = self.looker().cells_at(x, scratch)?;
        Ok(!cells.is_empty() && cells.iter().all(|cell| windings[cell.first as usize] > 0))
    }

    /// What is visible from a point ([`Looker::look`]).
    ///
    /// # Errors
    /// [`LookError`] for numbers that are out of range.
    pub fn look<'s>(
        &self,
        x: [f64; 3],
        view: &View,
        mode: Mode,
        scratch: &'s mut Scratch,
    ) -> Result<&'s Seen, LookError> {
        self.looker().look(x, view, mode, scratch)
    }

    /// What share of a box's picture is visible from a point, exactly ([`Looker::sees`]).
    ///
    /// # Errors
    /// [`LookError`] for numbers that are out of range.
    pub fn sees(
        &self,
        x: [f64; 3],
        target: &Target,
        scratch: &mut Scratch,
    ) -> Result<f64, LookError> {
        self.sees_in(x, target, &View::default(), Mode::Exact, scratch)
    }

    /// The same within a view, and with an angle.
    ///
    /// # Errors
    /// [`LookError`] for numbers that are out of range.
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

    /// The engine that takes less time for points like this one, by how much each goes through for it: the
    /// same question gives the same engine on every machine. In the conservative mode it is always the cells,
    /// which come in order, so that less of what is behind is listed. `scratch.seen` holds no answer
    /// afterwards.
    ///
    /// # Errors
    /// [`LookError`] for numbers that are out of range.
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
        let is_enough = |engine, budget: &Budget, scratch: &mut Scratch| {
            let view = View {
                engine,
                witnesses: false,
                ..view.clone()
            };
            looker.look_for(x, (&view, mode), budget, scratch)
        };
        is_enough(Engine::Boxes, &OF_BOXES, scratch)?;
        // Cells are followed only for as long as they may be the faster ones.
        let cells = Budget {
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
