//! Where viewpoints can be: marks the parts of view cells that hold viewpoints, from boxes, closed meshes,
//! navigation meshes, points, and the parts that free segments from these points reach.
//!
//! Marks are [`PartMask`]: each cell of a grid has 4×4×4 parts, and a part is marked when a viewpoint may
//! be in it. Boxes and meshes mark every part that they meet. Points mark the parts that rays from them
//! cross, so a part behind a gap that no ray finds stays unmarked.
//!
//! This crate samples no visibility and depends on no job.

pub mod boxes;
pub mod mesh;
pub mod points;
pub mod reach;
mod walk;

pub use sightline_viewcells::PartMask;

use rayon::prelude::*;
use sightline_numbers::Aabb;
use sightline_trace::BackendError;
use sightline_viewcells::part_mask::PARTS;
use sightline_viewcells::{Lattice, UNITS_PER_CELL};

/// Why it is not known where viewpoints can be.
#[derive(Debug, thiserror::Error)]
pub enum ViewpointsError {
    /// A file of viewpoints cannot be read.
    #[error("line {line} of the viewpoints cannot be read: {source}")]
    Read {
        /// From 1.
        line: u64,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A line is no viewpoint.
    #[error(
        "line {line} is not a viewpoint: {reason}; write `x y z`, or `x y z weight` with a weight ≥ 0"
    )]
    Line {
        /// From 1.
        line: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// There is no viewpoint at all.
    #[error("{0}")]
    None(String),
    /// A mesh that should enclose viewpoints is open.
    #[error(
        "the view mesh is not closed: {open} of its edges do not join two triangles in opposite directions, \
         the first at ({}, {}, {}); close it, or give --eye-heights LO,HI if it is a navigation mesh",
        at[0], at[1], at[2]
    )]
    Open {
        /// Number of edges.
        open: u64,
        /// An end of the first of them, world space.
        at: [f32; 3],
    },
    /// A point from which places are reached is inside something solid.
    #[error(
        "the point ({}, {}, {}) is inside the closed surface of {object:?}; give a point where a viewpoint \
         can be",
        point[0], point[1], point[2]
    )]
    Solid {
        /// The point.
        point: [f32; 3],
        /// The object that encloses it.
        object: String,
    },
    /// A point is outside the view box.
    #[error(
        "the point ({}, {}, {}) is outside the view box, {min:?} to {max:?}; move it inside, or give a \
         larger --view-box",
        point[0], point[1], point[2]
    )]
    Outside {
        /// The point.
        point: [f32; 3],
        /// Least corner of the view box.
        min: [f32; 3],
        /// Greatest corner of the view box.
        max: [f32; 3],
    },
    /// The tracer failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
}

/// The planes of the parts of a grid, along each axis.
pub struct Parts {
    planes: [Vec<f32>; 3],
}

impl Parts {
    /// The parts of a grid of `cells` cells.
    pub fn new(lattice: &Lattice, cells: [u32; 3]) -> Self {
        let plane = |a: usize, k: u32| lattice.coordinate(a, k * (UNITS_PER_CELL / PARTS));
        Self {
            planes: [0, 1, 2].map(|a| (0..=cells[a] * PARTS).map(|k| plane(a, k)).collect()),
        }
    }

    /// Parts along each axis.
    pub fn sides(&self) -> [u32; 3] {
        [0, 1, 2].map(|a| self.planes[a].len() as u32 - 1)
    }

    /// The box of a part.
    pub fn bounds(&self, part: [u32; 3]) -> Aabb {
        let corner =
            |up: u32| glam::Vec3::from([0, 1, 2].map(|a| self.planes[a][(part[a] + up) as usize]));
        Aabb {
            min: corner(0),
            max: corner(1),
        }
    }

    /// The whole box.
    pub fn whole(&self) -> Aabb {
        let sides = self.sides();
        Aabb {
            min: self.bounds([0; 3]).min,
            max: self.bounds(sides.map(|s| s - 1)).max,
        }
    }

    /// The parts whose closed box the closed box `of` touches, as ranges along each axis.
    pub fn touched(&self, of: &Aabb) -> [std::ops::Range<u32>; 3] {
        [0, 1, 2].map(|a| {
            let planes = &self.planes[a];
            let from = planes[1..].partition_point(|p| *p < of.min[a]) as u32;
            let to = planes[..planes.len() - 1].partition_point(|p| *p <= of.max[a]) as u32;
            from..to.max(from)
        })
    }

    /// The part of a point; `None` outside the box.
    pub fn of_point(&self, point: [f32; 3]) -> Option<[u32; 3]> {
        let inside = (0..3).all(|a| {
            let planes = &self.planes[a];
            planes[0] <= point[a] && point[a] <= planes[planes.len() - 1]
        });
        // A point on a plane belongs to the upper side, as in a result's tree.
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

/// Marks every part of which `meets` says that its box holds viewpoints.
pub fn mark_where(parts: &Parts, cells: [u32; 3], meets: impl Fn(Aabb) -> bool + Sync) -> PartMask {
    let all: Vec<[u32; 3]> = each(parts.sides()).collect();
    let met: Vec<[u32; 3]> = all
        .into_par_iter()
        .filter(|p| meets(parts.bounds(*p)))
        .collect();
    let mut marks = PartMask::empty(cells);
    met.into_iter().for_each(|p| marks.mark(p));
    marks
}

/// The parts that both have marked.
pub fn both(a: &PartMask, b: &PartMask) -> PartMask {
    let mut out = PartMask::empty(a.cells());
    each(a.sides())
        .filter(|p| a.has(*p) && b.has(*p))
        .for_each(|p| out.mark(p));
    out
}

/// All parts, x fastest.
pub(crate) fn each(sides: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
    let [nx, ny, nz] = sides;
    (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
}

/// The parts in ranges along each axis.
pub(crate) fn within([xs, ys, zs]: [std::ops::Range<u32>; 3]) -> impl Iterator<Item = [u32; 3]> {
    zs.flat_map(move |z| {
        let xs = xs.clone();
        ys.clone()
            .flat_map(move |y| xs.clone().map(move |x| [x, y, z]))
    })
}
