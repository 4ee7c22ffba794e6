//! Records of the purpose and the hits of lines, for developers who improve the sampler. An observer does not
//! affect the result of a sampler.

use std::time::Duration;

use sightline_model::LineKind;
use sightline_scene::TriangleId;

/// An attempt at a candidate.
#[derive(Clone, Copy, Debug)]
pub struct Attempt {
    /// The index of the cell in [`sightline_trace::lines::grid::CellGrid::each`].
    pub cell: usize,
    /// The triangle at which the line was aimed.
    pub triangle: TriangleId,
    /// The fraction of the sphere around the cell's centre that the triangle would cover if no other triangle
    /// hid it.
    pub part: f32,
    /// The number of earlier attempts at the triangle in this round.
    pub time: u32,
    /// The number of the cell's faces through which the neighbouring cell sees the triangle.
    pub faces: u32,
    /// The number of the triangle's neighbours that the cell sees.
    pub beside: u32,
    /// True if the line met the triangle.
    pub found: bool,
}

/// An observer of the lines of a sampler.
pub trait LineObserver: Sync {
    /// Returns true if the observer needs [`Self::attempted`], which costs time at each attempt.
    fn wants_attempts(&self) -> bool;

    /// Records the cost and the yield of lines of a kind from a cell.
    ///
    /// `rays` is the number of rays, `finds` the number of triangles that these rays were the first to show,
    /// and `time` their duration. The round of uniform and flood lines is the number of the cell's own round,
    /// counted over all searches.
    fn spent(&self, round: u32, kind: LineKind, rays: u64, finds: u64, time: Duration);

    /// Records an attempt at a candidate.
    fn attempted(&self, round: u32, attempt: Attempt);
}
