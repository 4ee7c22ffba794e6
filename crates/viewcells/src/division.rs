//! Divisions of the view box into cells: a regular grid, adaptive halving by a triangle budget, or the boxes
//! of a given tree. All divisions are kd-trees.

use std::sync::Arc;

use glam::Vec3;
use serde::Serialize;
use sightline_numbers::MAX_COORDINATE;

use crate::cell::axis_name;
use crate::kd_tree::{KdTree, PlaneError};
use crate::{CellBox, Lattice, Split, UNITS_PER_CELL};

/// The maximum number of grid cells along an axis. With 2¹⁶ units per cell, lattice coordinates fit in a
/// `u32`.
pub const MAX_CELLS_PER_AXIS: u32 = 1 << 15;
/// The maximum number of leaf cells of a job.
pub const MAX_CELLS: u64 = 1 << 22;
/// The maximum depth of an adaptive tree, which then has at most 2²² leaves.
pub const MAX_DEPTH: u32 = 22;
/// The number of levels of an adaptive tree that are always split, so that workers can share the job (2³
/// tiles).
pub const FORCED_DEPTH: u32 = 3;

/// The maximum displacement of the end of a sight line by rounding, in units of the last place of the largest
/// coordinate.
pub const ROUNDING: f32 = 8.0;
/// The distance of rays from the walls in the faces of a tree's boxes, in multiples of the displacement of
/// [`ROUNDING`].
pub const GAP: f32 = 2.0;

/// The reason why a division is not valid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DivisionError {
    /// The view box is empty, inverted, not finite, or farther from the origin than scenes may extend.
    #[error(
        "the view box from {min:?} to {max:?} along {} is empty, not finite or beyond ±{MAX_COORDINATE:e}; \
         give x0,y0,z0,x1,y1,z1 with x0 < x1, y0 < y1 and z0 < z1",
        axis_name(*axis)
    )]
    Box {
        /// The axis: 0 = x, 1 = y, 2 = z.
        axis: usize,
        /// The lowest coordinate of the view box along the axis.
        min: f32,
        /// The highest coordinate of the view box along the axis.
        max: f32,
    },
    /// The division has no cells, or too many cells.
    #[error(
        "{x}x{y}x{z} view cells are not possible; use 1 to {MAX_CELLS_PER_AXIS} along each axis and at most \
         {MAX_CELLS} in all"
    )]
    Cells {
        /// The number of cells along x.
        x: u32,
        /// The number of cells along y.
        y: u32,
        /// The number of cells along z.
        z: u32,
    },
    /// Cells are so thin that their planes coincide in `f32`.
    #[error(
        "{cells} cells along {} are thinner than the resolution of 32-bit coordinates there; \
         use fewer cells, or move the scene nearer to the origin",
        axis_name(*axis)
    )]
    TooFine {
        /// The axis: 0 = x, 1 = y, 2 = z.
        axis: usize,
        /// The number of cells along the axis.
        cells: u32,
    },
    /// Cells are so thin that rounding can move a sight line across a cell.
    #[error(
        "view cells {width:.2e} wide along {} are too thin for coordinates as large as {largest}: \
         rounding can move a sight line by this width; use wider cells, an exact method, or a scene nearer \
         to the origin",
        axis_name(*axis)
    )]
    TooThin {
        /// The axis: 0 = x, 1 = y, 2 = z.
        axis: usize,
        /// The width of a cell, in world units.
        width: f64,
        /// The largest absolute coordinate of the view box.
        largest: f32,
    },
    /// A plane of a tree is not strictly inside the box that it divides.
    #[error(transparent)]
    Plane(#[from] PlaneError),
    /// The limits of an adaptive division are out of range.
    #[error(
        "a triangle budget of {budget} with a depth of at most {depth} is not possible; \
         use a budget of at least 1 and a depth of 1 to {MAX_DEPTH}"
    )]
    Adaptive {
        /// The triangle budget.
        budget: u32,
        /// The maximum depth.
        depth: u32,
    },
}

/// The division of the view box into cells.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Division {
    /// A regular grid with these numbers of cells along x, y and z.
    Grid([u32; 3]),
    /// An adaptive tree. Cells are halved until at most `budget` triangles are visible from a cell, or until
    /// the tree is `max_depth` deep (Nirenstein 2003, section 4.2.2).
    Adaptive {
        /// The number of visible triangles above which a cell is split.
        budget: u32,
        /// The maximum level. The root has level 0.
        max_depth: u32,
    },
    /// The boxes of a given tree.
    #[serde(serialize_with = "tree")]
    Tree(Arc<KdTree>),
}

fn tree<S: serde::Serializer>(tree: &KdTree, to: S) -> Result<S::Ok, S::Error> {
    tree.serialize(to)
}

impl Division {
    /// Checks the division of the view box from `min` to `max` (world space) and returns the lattice of the
    /// division.
    ///
    /// # Errors
    /// [`DivisionError`] with the faulty value.
    pub fn lattice(&self, min: Vec3, max: Vec3) -> Result<Lattice, DivisionError> {
        for axis in 0..3 {
            let (lo, hi) = (min[axis], max[axis]);
            if !(-MAX_COORDINATE <= lo && lo < hi && hi <= MAX_COORDINATE) {
                return Err(DivisionError::Box {
                    axis,
                    min: lo,
                    max: hi,
                });
            }
        }
        match *self {
            Self::Grid([x, y, z]) => {
                let fine = [x, y, z]
                    .iter()
                    .all(|c| (1..=MAX_CELLS_PER_AXIS).contains(c))
                    && u64::from(x) * u64::from(y) * u64::from(z) <= MAX_CELLS;
                if !fine {
                    return Err(DivisionError::Cells { x, y, z });
                }
                let lattice = Lattice::new(min, max, [x, y, z]);
                // Far from the origin, neighbouring planes may round to the same `f32`.
                let told_apart = |a: usize, cells: u32| {
                    let plane = |c: u32| lattice.coordinate(a, c * UNITS_PER_CELL);
                    (0..cells).all(|c| plane(c) < plane(c + 1))
                };
                match [x, y, z]
                    .into_iter()
                    .enumerate()
                    .find(|(a, cells)| !told_apart(*a, *cells))
                {
                    None => Ok(lattice),
                    Some((axis, cells)) => Err(DivisionError::TooFine { axis, cells }),
                }
            }
            Self::Adaptive { budget, max_depth } => {
                if budget == 0 || !(1..=MAX_DEPTH).contains(&max_depth) {
                    return Err(DivisionError::Adaptive {
                        budget,
                        depth: max_depth,
                    });
                }
                Ok(Lattice::new(min, max, [1, 1, 1]))
            }
            Self::Tree(ref tree) => Ok(tree.lattice(min, max)?),
        }
    }

    /// Returns the maximum displacement of the end of a sight line by rounding, as a fraction of the width of
    /// the thinnest cell. For an adaptive tree, the thinnest cell is the thinnest cell of level
    /// [`FORCED_DEPTH`].
    ///
    /// The samplers ignore a sight line in a cell if the line crosses a smaller fraction of the cell.
    ///
    /// # Errors
    /// [`DivisionError::TooThin`] if rounding may move a line by the width of a cell or more.
    pub fn rounding_displacement(&self, lattice: &Lattice) -> Result<f64, DivisionError> {
        let root = self.root(lattice);
        let mut thinnest = root;
        match self {
            Self::Grid(_) => thinnest.hi = [UNITS_PER_CELL; 3],
            // The lower half of each split has the width of the upper half, or one unit less.
            Self::Adaptive { .. } => {
                for depth in 0..FORCED_DEPTH {
                    let Some(split) = self.split(lattice, &thinnest, depth) else {
                        break;
                    };
                    thinnest = thinnest.children(split)[0];
                }
            }
            Self::Tree(_) => {}
        }
        let (min, max) = root.world(lattice);
        let largest = min.abs().max(max.abs()).max_element();
        let moved = f64::from(largest) * f64::from(f32::EPSILON) * f64::from(ROUNDING);
        let width_along = |a: usize| lattice.length(a, thinnest.hi[a] - thinnest.lo[a]);
        let (width, axis) = match self {
            Self::Tree(tree) => {
                let (width, axis) = tree.thinnest(lattice);
                (width - 2.0 * f64::from(GAP) * moved, axis)
            }
            Self::Grid(_) | Self::Adaptive { .. } => {
                let axis = (1..3).fold(0, |a, b| {
                    if width_along(b) < width_along(a) {
                        b
                    } else {
                        a
                    }
                });
                (width_along(axis), axis)
            }
        };
        if moved < width {
            Ok(moved / width)
        } else {
            Err(DivisionError::TooThin {
                axis,
                width,
                largest,
            })
        }
    }

    /// Returns the root cell, which is the whole view box.
    pub fn root(&self, lattice: &Lattice) -> CellBox {
        CellBox {
            lo: [0; 3],
            hi: lattice.units(),
        }
    }

    /// Returns the plane that splits `cell` at `depth`, or `None` if the cell cannot be split. A cell of a
    /// grid is split along the axis with most cells, and a cell of an adaptive tree along its longest side.
    /// Of several such axes, the function chooses the first.
    pub fn split(&self, lattice: &Lattice, cell: &CellBox, depth: u32) -> Option<Split> {
        let span = |a: usize| cell.hi[a] - cell.lo[a];
        // `max_by` returns the last of equal elements, so iterate backwards to get the first axis.
        let pick =
            |key: &dyn Fn(usize) -> f64| (0..3).rev().max_by(|a, b| key(*a).total_cmp(&key(*b)));
        match *self {
            Self::Grid(_) => {
                let axis = pick(&|a| f64::from(span(a)))?;
                let cells = span(axis) / UNITS_PER_CELL;
                (cells > 1).then(|| Split {
                    axis,
                    at: cell.lo[axis] + cells / 2 * UNITS_PER_CELL,
                })
            }
            Self::Adaptive { max_depth, .. } => {
                let axis = pick(&|a| lattice.length(a, span(a)))?;
                let at = cell.lo[axis] + span(axis) / 2;
                let plane = |k: u32| lattice.coordinate(axis, k);
                let inside = plane(cell.lo[axis]) < plane(at) && plane(at) < plane(cell.hi[axis]);
                (depth < max_depth && inside).then_some(Split { axis, at })
            }
            Self::Tree(ref tree) => tree.split(lattice, cell),
        }
    }

    /// Returns the index of a cell, or `None` in an adaptive tree, whose cells are unknown before the bake.
    ///
    /// In a grid, x varies fastest, then y, then z, and `cell` must be a cell. A given tree determines the
    /// order of its cells, and the result is `None` for boxes that are not cells.
    pub fn number(&self, lattice: &Lattice, cell: &CellBox) -> Option<usize> {
        match self {
            Self::Grid([nx, ny, _]) => {
                let [x, y, z] = cell.lo.map(|u| (u / UNITS_PER_CELL) as usize);
                Some((z * *ny as usize + y) * *nx as usize + x)
            }
            Self::Adaptive { .. } => None,
            Self::Tree(tree) => tree.number(lattice, cell),
        }
    }

    /// Returns true if a cell at `depth` must be split if [`Self::split`] returns a plane. `seen` is the
    /// number of triangles that are visible from the cell.
    pub fn wants_split(&self, seen: usize, depth: u32) -> bool {
        match *self {
            Self::Grid(_) | Self::Tree(_) => true,
            Self::Adaptive { budget, .. } => depth < FORCED_DEPTH || seen > budget as usize,
        }
    }
}
