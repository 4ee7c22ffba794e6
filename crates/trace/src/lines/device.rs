//! Devices that cast whole rounds of a block by themselves: the interface between the rounds of
//! lines and the backends that have such a device.
//!
//! The device keeps the block's table. It makes the lines of a phase, traces them, credits the cells and
//! counts; only new words of the table and a few numbers per cell come back. Decisions stay with
//! the rounds of the sampler: which cells are open, how many lines each gets, when it is done. The random
//! numbers are the device's own, so a profile with such a device has its own results.

use glam::Vec3;
use sightline_scene::Scene;

pub use super::FLOOD_STEPS;
use super::bits::SeenBits;
use super::grid::{CellGrid, Slot};
pub use super::tally::{DECADES, Tally};
use crate::error::BackendError;
use crate::surface::Surface;

/// A view cell, as a device needs it.
#[derive(Clone, Copy, Debug)]
pub struct DeviceCell {
    /// Least corner, scene units.
    pub low: Vec3,
    /// Size, scene units.
    pub size: Vec3,
    /// Coordinates in the grid.
    pub at: [u32; 3],
    /// The place of its bit.
    pub slot: Slot,
    /// Which of its parts hold viewpoints; all bits when all do.
    pub parts: u64,
    /// Names its random numbers: no other cell of the job has the same.
    pub key: u64,
}

/// A block with nothing seen.
pub struct DeviceBlock<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Facts about its triangles.
    pub surface: &'a Surface,
    /// Row of each triangle in the table; empty when it is the triangle's id.
    pub rows: &'a [u32],
    /// Rows of the table.
    pub row_count: usize,
    /// The cells' grid.
    pub grid: &'a CellGrid,
    /// The cells, in the order of [`CellGrid::each`].
    pub cells: &'a [DeviceCell],
    /// The words of a row without the cells that have no viewpoint; empty when all have one.
    pub reached: &'a [u64],
    /// Least distance between the origin of a line and the start of its other half, scene units.
    pub step: f32,
    /// Where lines end, scene units; infinite when they do not.
    pub far: f32,
    /// Whether some triangles have one side.
    pub one_way: bool,
    /// Names the seeds' random numbers.
    pub key: u64,
    /// The division over which pairs of cells are looked for, if the job asks.
    pub pairs: Option<DevicePairs<'a>>,
}

/// The division over which pairs of cells are looked for.
pub struct DevicePairs<'a> {
    /// Its grid.
    pub grid: &'a CellGrid,
    /// Its cells, in the order of [`CellGrid::each`].
    pub cells: &'a [DeviceCell],
    /// The words of a row without the cells that have no viewpoint; empty when all have one.
    pub reached: &'a [u64],
    /// For each cell of the block its slot in this grid.
    pub slots: &'a [u32],
    /// One line in so many joins the cells that it crosses: of uniform lines, of others.
    pub joins: [u32; 2],
}

/// Segments between random points of two cells of the division.
#[derive(Clone, Copy, Debug)]
pub struct SegmentWork<'a> {
    /// Cells that cast, by their places in [`DevicePairs::cells`].
    pub cells: &'a [u32],
    /// Number of the round.
    pub round: u32,
    /// Whether at any later cells, or at open pairs alone.
    pub at_any: bool,
    /// Most segments from a cell.
    pub most: u32,
}

/// Uniform lines from a cell.
#[derive(Clone, Copy, Debug)]
pub struct UniformWork {
    /// Its place in [`DeviceBlock::cells`].
    pub cell: usize,
    /// Tiles of 4×4 lines along a side of a cube's face.
    pub tiles: u32,
    /// Tiles that it has cast in earlier rounds.
    pub base: u64,
}

/// Lines at the candidates of a cell.
#[derive(Clone, Copy, Debug)]
pub struct AimWork {
    /// Its place in [`DeviceBlock::cells`].
    pub cell: usize,
    /// Least part of the sphere that a candidate covers.
    pub least: f64,
    /// Uniform rays that it has cast.
    pub rays: u64,
}

/// How often a candidate is tried, by decade of its part of the sphere.
#[derive(Clone, Copy, Debug)]
pub struct AimPlan {
    /// Number of the phase among those of the block that aim.
    pub phase: u32,
    /// Tries in this round; a fraction is the probability of one more.
    pub times: [f32; DECADES],
    /// Tries in all rounds before.
    pub so_far: [f32; DECADES],
    /// Steps of the flood from what they find.
    pub flood_steps: u32,
}

/// What a device found in a phase.
#[derive(Default)]
pub struct Found {
    /// Four counts for each item; their meaning depends on the kind of lines.
    pub counts: Vec<[u32; 4]>,
    /// Rays that belong to no cell of the block.
    pub rays: u64,
    /// The yields of candidates.
    pub tally: Tally,
    /// New bits: place of the word in the table, bits. In any order.
    pub words: Vec<(u32, u64)>,
    /// The same of the table of pairs.
    pub pair_words: Vec<(u32, u64)>,
}

/// What went between host and device since the block was made, and the rays that were cast.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traffic {
    /// Rays.
    pub rays: u64,
    /// Bytes to the device.
    pub up: u64,
    /// Bytes from the device.
    pub down: u64,
    /// Waits for the device.
    pub waits: u64,
    /// Seconds of all these waits.
    pub seconds: f64,
}

/// The time that a kernel took since the block was made.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelTime {
    /// Its entry point.
    pub name: &'static str,
    /// Seconds of all its runs.
    pub seconds: f64,
    /// Its runs.
    pub runs: u64,
}

/// Is told the rays of the last part of a phase, about, and says whether the work goes on.
pub type GoesOn<'a> = &'a (dyn Fn(u64) -> bool + Sync);

/// A block on a device. What a phase finds is in the device's table when the phase ends, as if published.
pub trait Rounds: Send + Sync {
    /// Makes the device's tables those of the last barrier. `pairs` is a copy of the table of pairs.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    fn restart(&self, bits: &SeenBits, pairs: Option<&[u64]>) -> Result<(), BackendError>;

    /// A round of uniform lines, and the flood from what they find. Counts of an item: rays that met a
    /// triangle which its cell had not seen, finds, rays of the flood, finds of the flood. A phase that is
    /// broken off need not have counts.
    ///
    /// # Errors
    /// As [`Rounds::restart`].
    fn uniform(&self, work: &[UniformWork], goes_on: GoesOn<'_>) -> Result<Found, BackendError>;

    /// Lines at candidates, and the flood from what they find. Counts of an item: rays, finds, rays of the
    /// flood, finds of the flood.
    ///
    /// # Errors
    /// As [`Rounds::restart`].
    fn aim(
        &self,
        work: &[AimWork],
        plan: &AimPlan,
        goes_on: GoesOn<'_>,
    ) -> Result<Found, BackendError>;

    /// The seeds of the whole scene.
    ///
    /// # Errors
    /// As [`Rounds::restart`].
    fn seeds(&self, goes_on: GoesOn<'_>) -> Result<Found, BackendError>;

    /// Held-out lines: for each item a cell and a number of lines, for test number `look`. Counts of an item:
    /// lines that met a triangle outside the cell's set, lines that cross a cell which is no pair with it.
    ///
    /// # Errors
    /// As [`Rounds::restart`].
    fn check(
        &self,
        work: &[(usize, u64)],
        look: u32,
        goes_on: GoesOn<'_>,
    ) -> Result<Found, BackendError>;

    /// Segments from some cells of the division, which join the cells that they cross. Counts of an item:
    /// segments, those that reach their end, later cells at which they could be cast.
    ///
    /// # Errors
    /// As [`Rounds::restart`].
    fn segments(&self, work: &SegmentWork<'_>, goes_on: GoesOn<'_>) -> Result<Found, BackendError>;

    /// What went over the bus.
    fn traffic(&self) -> Traffic;

    /// The time of each kernel; empty unless the backend measures it.
    fn kernel_times(&self) -> Vec<KernelTime>;
}
