//! Devices that cast whole rounds of a block: the interface between the rounds of lines and the backends with
//! such a device.
//!
//! The device stores the block's table. It creates the lines of a phase, traces them, credits the cells and
//! counts. The host reads only new words of the table and a few numbers per cell. The sampler still makes the
//! decisions: the open cells, the number of lines per cell, and the end of a cell. The random numbers are the
//! device's own, so a profile with such a device has its own results.

use glam::Vec3;
use sightline_scene::Scene;

pub use super::FLOOD_STEPS;
use super::bits::SeenBits;
use super::grid::{CellGrid, Slot};
pub use super::tally::{DECADES, Tally};
use crate::error::TracerError;
use crate::surface::Surface;

/// A view cell, in the form that a device needs.
#[derive(Clone, Copy, Debug)]
pub struct DeviceCell {
    /// The minimum corner of the cell, in scene units.
    pub low: Vec3,
    /// The size of the cell, in scene units.
    pub size: Vec3,
    /// The coordinates of the cell in the grid.
    pub at: [u32; 3],
    /// The place of the cell's bit in a row.
    pub slot: Slot,
    /// The parts of the cell that contain viewpoints; all bits if all parts do.
    pub parts: u64,
    /// The key of the cell's random numbers, which no other cell of the job has.
    pub key: u64,
}

/// A block in which no cell has seen a triangle.
pub struct DeviceBlock<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The facts about the scene's triangles.
    pub surface: &'a Surface,
    /// The row of each triangle in the table; empty if the row is the triangle's id.
    pub rows: &'a [u32],
    /// The number of rows of the table.
    pub row_count: usize,
    /// The grid of the cells.
    pub grid: &'a CellGrid,
    /// The cells, in the order of [`CellGrid::each`].
    pub cells: &'a [DeviceCell],
    /// The words of a row without the cells that have no viewpoint; empty if all cells have one.
    pub reached: &'a [u64],
    /// The minimum distance between the origin of a line and the start of its other half, in scene units.
    pub step: f32,
    /// The distance at which lines end, in scene units; infinite for unlimited sight.
    pub far: f32,
    /// True if some triangles have one side.
    pub one_way: bool,
    /// The key of the seeds' random numbers.
    pub key: u64,
    /// The division over which pairs of cells are searched; `None` if the job does not request pairs.
    pub pairs: Option<DevicePairs<'a>>,
}

/// The division over which pairs of cells are searched.
pub struct DevicePairs<'a> {
    /// The grid of the division.
    pub grid: &'a CellGrid,
    /// The cells of the division, in the order of [`CellGrid::each`].
    pub cells: &'a [DeviceCell],
    /// The words of a row without the cells that have no viewpoint; empty if all cells have one.
    pub reached: &'a [u64],
    /// The slot in this grid of each cell of the block.
    pub slots: &'a [u32],
    /// The joining intervals of uniform lines and of other lines: one line in this number joins the cells it
    /// crosses.
    pub joins: [u32; 2],
}

/// The segments of a round between random points of two cells of the division.
#[derive(Clone, Copy, Debug)]
pub struct SegmentWork<'a> {
    /// The cells that cast, by their indices in [`DevicePairs::cells`].
    pub cells: &'a [u32],
    /// The number of the round.
    pub round: u32,
    /// True if segments are cast at any later cells, false if only at open pairs.
    pub at_any: bool,
    /// The maximum number of segments from a cell.
    pub most: u32,
}

/// The uniform lines of a round from a cell.
#[derive(Clone, Copy, Debug)]
pub struct UniformWork {
    /// The index of the cell in [`DeviceBlock::cells`].
    pub cell: usize,
    /// The number of tiles of 4×4 lines along a side of a cube's face.
    pub tiles: u32,
    /// The number of tiles that the cell has cast in earlier rounds.
    pub base: u64,
}

/// The lines of a round at the candidates of a cell.
#[derive(Clone, Copy, Debug)]
pub struct AimWork {
    /// The index of the cell in [`DeviceBlock::cells`].
    pub cell: usize,
    /// The minimum fraction of the sphere that a candidate covers.
    pub least: f64,
    /// The number of uniform rays that the cell has cast.
    pub rays: u64,
}

/// The number of attempts at a candidate, by decade of its fraction of the sphere.
#[derive(Clone, Copy, Debug)]
pub struct AimPlan {
    /// The number of the phase among the aiming phases of the block.
    pub phase: u32,
    /// The number of attempts in this round. A fraction is the probability of one more attempt.
    pub times: [f32; DECADES],
    /// The number of attempts in all previous rounds.
    pub so_far: [f32; DECADES],
    /// The number of flood steps from the newly found triangles.
    pub flood_steps: u32,
}

/// The result of a phase on a device.
#[derive(Default)]
pub struct DevicePhaseResult {
    /// Four counts for each item. Their meaning depends on the kind of lines.
    pub counts: Vec<[u32; 4]>,
    /// The number of rays that belong to no cell of the block.
    pub rays: u64,
    /// The tally of attempts at candidates.
    pub tally: Tally,
    /// The new bits of the table, in any order: the index of a word, and its bits.
    pub words: Vec<(u32, u64)>,
    /// The new bits of the table of pairs, in any order: the index of a word, and its bits.
    pub pair_words: Vec<(u32, u64)>,
}

/// The traffic between host and device since the block was created, and the number of cast rays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traffic {
    /// The number of cast rays.
    pub rays: u64,
    /// The number of bytes sent to the device.
    pub up: u64,
    /// The number of bytes read from the device.
    pub down: u64,
    /// The number of waits for the device.
    pub waits: u64,
    /// The sum of all waits in seconds.
    pub seconds: f64,
}

/// The time that a kernel needed since the block was created.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelTime {
    /// The entry point of the kernel.
    pub name: &'static str,
    /// The sum of all runs in seconds.
    pub seconds: f64,
    /// The number of runs.
    pub runs: u64,
}

/// A function that receives the approximate number of rays of the last part of a phase. It returns true if
/// the work continues.
pub type ContinueCheck<'a> = &'a (dyn Fn(u64) -> bool + Sync);

/// A block on a device. At the end of a phase, the device's table contains the phase's results, as if
/// published.
pub trait Rounds: Send + Sync {
    /// Sets the device's tables to the tables of the last barrier. `pairs` is a copy of the table of pairs.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    fn restart(&self, bits: &SeenBits, pairs: Option<&[u64]>) -> Result<(), TracerError>;

    /// Casts a round of uniform lines and floods from the newly found triangles.
    ///
    /// An item has four counts: rays that met a triangle new to the cell, newly found triangles, rays of the
    /// flood, and triangles found by the flood. An interrupted phase need not have counts.
    ///
    /// # Errors
    /// The errors of [`Rounds::restart`].
    fn uniform(
        &self,
        work: &[UniformWork],
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError>;

    /// Casts lines at candidates and floods from the newly found triangles.
    ///
    /// The counts of an item are the rays, the newly found triangles, the rays of the flood, and the
    /// triangles found by the flood.
    ///
    /// # Errors
    /// The errors of [`Rounds::restart`].
    fn aim(
        &self,
        work: &[AimWork],
        plan: &AimPlan,
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError>;

    /// Casts the seeds of the whole scene.
    ///
    /// # Errors
    /// The errors of [`Rounds::restart`].
    fn seeds(&self, goes_on: ContinueCheck<'_>) -> Result<DevicePhaseResult, TracerError>;

    /// Casts held-out lines for look number `look`. Each item is a cell and a number of lines.
    ///
    /// The counts of an item are the lines that met a triangle outside the cell's set, and the lines that
    /// cross a cell that is not a pair with the cell.
    ///
    /// # Errors
    /// The errors of [`Rounds::restart`].
    fn check(
        &self,
        work: &[(usize, u64)],
        look: u32,
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError>;

    /// Casts segments from some cells of the division, which join the cells that they cross.
    ///
    /// The counts of an item are the segments, the segments that reach their end, and the later cells at
    /// which segments could be cast.
    ///
    /// # Errors
    /// The errors of [`Rounds::restart`].
    fn segments(
        &self,
        work: &SegmentWork<'_>,
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError>;

    /// Returns the traffic over the bus.
    fn traffic(&self) -> Traffic;

    /// Returns the time of each kernel. The list is empty unless the backend measures the times.
    fn kernel_times(&self) -> Vec<KernelTime>;
}
