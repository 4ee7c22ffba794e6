//! The parts of view cells in which viewpoints can be.
//!
//! Marks are a [`PartMask`]: each cell of a grid has 4×4×4 parts, and a part is marked if a viewpoint may be
//! in the part. The client computes the marks before it submits a job. This crate does not sample visibility
//! and does not depend on jobs. `docs/viewpoints.md` describes the options.
//!
//! # Modules
//!
//! - `boxes`: marks from a union of boxes.
//! - `mesh`: marks from closed meshes, or from heights above a navigation mesh.
//! - `points`: files of viewpoints with weights, and marks around points.
//! - `reach`, `walk`: marks of the parts that free segments from given points cross.
//!
//! # Invariants
//!
//! - The marks are part of the job. After the submission, the result does not depend on the client's machine
//!   or tracer.
//! - `boxes` and `mesh` mark every part that a box or mesh meets. `reach` marks the parts that rays from
//!   points cross, so a part behind a gap that no ray passes stays unmarked.
//!
//! # Limits
//!
//! - The cells of adaptive trees have no marks.

pub mod boxes;
pub mod mesh;
pub mod points;
pub mod reach;
mod walk;

pub use sightline_viewcells::PartMask;

use rayon::prelude::*;
use sightline_numbers::Aabb;
use sightline_trace::TracerError;
use sightline_viewcells::part_mask::PARTS;
use sightline_viewcells::{Lattice, UNITS_PER_CELL};

/// The reason why the positions of viewpoints cannot be determined.
#[derive(Debug, thiserror::Error)]
pub enum ViewpointsError {
    /// A file of viewpoints that cannot be read.
    #[error("line {line} of the viewpoints cannot be read: {source}")]
    Read {
        /// The line number, starting at 1.
        line: u64,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A line of a file of viewpoints that is not a viewpoint.
    #[error(
        "line {line} is not a viewpoint: {reason}; write `x y z`, or `x y z weight` with a weight ≥ 0"
    )]
    Line {
        /// The line number, starting at 1.
        line: u64,
        /// The reason why the line is rejected.
        reason: String,
    },
    /// An input without any usable viewpoint. The text describes the input and the remedy.
    #[error("{0}")]
    None(String),
    /// An open mesh that should enclose viewpoints.
    #[error(
        "the view mesh is not closed: {open} of its edges do not join two triangles in opposite directions, \
         the first at ({}, {}, {}); close the mesh, or give --eye-heights LO,HI for a navigation mesh",
        at[0], at[1], at[2]
    )]
    Open {
        /// The number of open edges.
        open: u64,
        /// An end of the first open edge, in world space.
        at: [f32; 3],
    },
    /// A starting point that is inside a solid.
    #[error(
        "the point ({}, {}, {}) is inside the closed surface of {object:?}; give a point outside of \
         solids",
        point[0], point[1], point[2]
    )]
    Solid {
        /// The point inside the solid, in world space.
        point: [f32; 3],
        /// The name of the object that encloses the point.
        object: String,
    },
    /// A point outside the view box.
    #[error(
        "the point ({}, {}, {}) is outside the view box, {min:?} to {max:?}; move the point inside, or \
         give a larger --view-box",
        point[0], point[1], point[2]
    )]
    Outside {
        /// The point outside the view box, in world space.
        point: [f32; 3],
        /// The minimum corner of the view box.
        min: [f32; 3],
        /// The maximum corner of the view box.
        max: [f32; 3],
    },
    /// An error of the tracer.
    #[error(transparent)]
    Backend(#[from] TracerError),
}

/// The planes of the parts of a grid, along each axis.
pub struct PartPlanes {
    planes: [Vec<f32>; 3],
}

impl PartPlanes {
    /// Computes the planes of the parts of a grid with `cells` cells along each axis.
    pub fn new(lattice: &Lattice, cells: [u32; 3]) -> Self {
        let plane = |a: usize, k: u32| lattice.coordinate(a, k * (UNITS_PER_CELL / PARTS));
        Self {
            planes: [0, 1, 2].map(|a| (0..=cells[a] * PARTS).map(|k| plane(a, k)).collect()),
        }
    }

    /// Returns the number of parts along each axis.
    pub fn sides(&self) -> [u32; 3] {
        [0, 1, 2].map(|a| self.planes[a].len() as u32 - 1)
    }

    /// Returns the box of the part at these coordinates in the grid of parts.
    pub fn bounds(&self, part: [u32; 3]) -> Aabb {
        let corner =
            |up: u32| glam::Vec3::from([0, 1, 2].map(|a| self.planes[a][(part[a] + up) as usize]));
        Aabb {
            min: corner(0),
            max: corner(1),
        }
    }

    /// Returns the box that contains all parts.
    pub fn whole(&self) -> Aabb {
        let sides = self.sides();
        Aabb {
            min: self.bounds([0; 3]).min,
            max: self.bounds(sides.map(|s| s - 1)).max,
        }
    }

    /// Returns the parts whose closed box touches the closed box `bounds`, as a range of coordinates along
    /// each axis.
    pub fn touched(&self, bounds: &Aabb) -> [std::ops::Range<u32>; 3] {
        [0, 1, 2].map(|a| {
            let planes = &self.planes[a];
            let from = planes[1..].partition_point(|p| *p < bounds.min[a]) as u32;
            let to = planes[..planes.len() - 1].partition_point(|p| *p <= bounds.max[a]) as u32;
            from..to.max(from)
        })
    }

    /// Returns the coordinates of the part that contains a point, or `None` if the point is outside the grid.
    pub fn of_point(&self, point: [f32; 3]) -> Option<[u32; 3]> {
        let inside = (0..3).all(|a| {
            let planes = &self.planes[a];
            planes[0] <= point[a] && point[a] <= planes[planes.len() - 1]
        });
        // A point on a plane belongs to the upper side, as in the tree of a result.
        inside.then(|| {
            [0, 1, 2].map(|a| {
                let planes = &self.planes[a];
                (planes.partition_point(|p| *p <= point[a]) as u32)
                    .clamp(1, planes.len() as u32 - 1)
                    - 1
            })
        })
    }
}

/// Marks every part for whose box `meets` returns true. `cells` are the numbers of cells along each axis.
pub fn mark_where(
    parts: &PartPlanes,
    cells: [u32; 3],
    meets: impl Fn(Aabb) -> bool + Sync,
) -> PartMask {
    let all: Vec<[u32; 3]> = each(parts.sides()).collect();
    let met: Vec<[u32; 3]> = all
        .into_par_iter()
        .filter(|p| meets(parts.bounds(*p)))
        .collect();
    let mut marks = PartMask::empty(cells);
    met.into_iter().for_each(|p| marks.mark(p));
    marks
}

/// Returns the mask of the parts that are marked in both masks, which must have the same grid.
pub fn both(a: &PartMask, b: &PartMask) -> PartMask {
    let mut out = PartMask::empty(a.cells());
    each(a.sides())
        .filter(|p| a.has(*p) && b.has(*p))
        .for_each(|p| out.mark(p));
    out
}

/// Returns the coordinates of all parts of a grid with `sides` parts along each axis, with x varying fastest.
pub(crate) fn each(sides: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
    let [nx, ny, nz] = sides;
    (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
}

/// Returns the coordinates of the parts in a range along each axis.
pub(crate) fn within([xs, ys, zs]: [std::ops::Range<u32>; 3]) -> impl Iterator<Item = [u32; 3]> {
    zs.flat_map(move |z| {
        let xs = xs.clone();
        ys.clone()
            .flat_map(move |y| xs.clone().map(move |x| [x, y, z]))
    })
}
