//! The Delaunay tetrahedra of points and of a box around them.

use super::curve::{Curve, insertion_order};
use super::enclosure::corners;
use super::error::DelaunayError;
use super::mesh::{Cell, MOST_POINTS, Mesh, NONE};
use super::predicates::Predicates;
use crate::watch::{Quiet, Stage, Watch};

/// Memory that the tetrahedra of a scene's points take: about 8 a point, with 110 bytes each.
const BYTES_A_POINT: u64 = 880;
/// Points between two calls that tell how far it is.
const TELL_EVERY: u64 = 4096;

/// Delaunay tetrahedra of distinct points and a box around them. They fill the box, and none is flat.
///
/// The result depends on the points and their numbers alone. Where five or more points lie on one sphere and
/// several choices are Delaunay, the points are lifted by infinitely small heights, larger for smaller
/// numbers, so the choices agree with each other and the tetrahedra have a front-to-back order from every
/// viewpoint.
#[derive(Clone, Debug, PartialEq)]
pub struct Delaunay {
    /// The given points in their order, then the 8 corners of the box: corner k has the upper x if bit 0 of k
    /// is set, the upper y for bit 1, the upper z for bit 2.
    pub points: Vec<[f32; 3]>,
    /// The corners a, b, c, d of each tetrahedron: numbers of points with (b − a) × (c − a) · (d − a) > 0.
    /// The first two are the smallest, in ascending order. Tetrahedra are in the order of their centres
    /// along a Hilbert curve.
    pub tetrahedra: Vec<[u32; 4]>,
    /// For each tetrahedron and k the tetrahedron across the face opposite to corner k; [`NONE`] on the
    /// border of the box.
    pub neighbours: Vec<[u32; 4]>,
}

impl Delaunay {
    /// The Delaunay tetrahedra of distinct finite points.
    ///
    /// Needs about 110 bytes a tetrahedron while it runs; a scene has 6 to 8 tetrahedra a point, but points
    /// on two skew curves have about the square of their number.
    ///
    /// # Errors
    ///
    /// Points that are not finite or not distinct, that leave no room for the box in `f32`, or that are too
    /// many.
    pub fn new(points: &[[f32; 3]]) -> Result<Self, DelaunayError> {
        Self::with_seed(points, 0, &Quiet)
    }

    /// [`Self::new`] with somebody who follows it.
    ///
    /// # Errors
    ///
    /// Those of [`Self::new`], and [`DelaunayError::Memory`].
    pub fn watched(points: &[[f32; 3]], watch: &dyn Watch) -> Result<Self, DelaunayError> {
        Self::with_seed(points, 0, watch)
    }

    /// [`Self::new`] with another order of insertion. The result is the same for every seed: tests show it.
    ///
    /// # Errors
    ///
    /// Those of [`Self::new`].
    pub fn with_seed(
        points: &[[f32; 3]],
        seed: u64,
        watch: &dyn Watch,
    ) -> Result<Self, DelaunayError> {
        if points.len() > MOST_POINTS {
            return Err(DelaunayError::TooManyPoints {
                points: points.len(),
                most: MOST_POINTS,
            });
        }
        if let Some(index) = points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            return Err(DelaunayError::NotFinite {
                index,
                point: points[index],
            });
        }
        watch
            .needs(points.len() as u64 * BYTES_A_POINT)
            .map_err(DelaunayError::Memory)?;
        let corners = corners(points)?;
        let curve = Curve::new(corners[0], corners[7]);
        let order = insertion_order(points, &curve, seed);
        let mut all = Vec::with_capacity(points.len() + 8);
        all.extend_from_slice(points);
        all.extend_from_slice(&corners);
        let (cells, alive) = {
            let predicates = Predicates::new(&all);
            let mut mesh = Mesh::of_box(&predicates, points.len() as u32);
            for (done, number) in (0..).zip(order) {
                if done % TELL_EVERY == 0 {
                    watch.done(Stage::Points, done, points.len() as u64);
                    // Points on few curves have far more tetrahedra than others.
                    watch.needs(mesh.bytes()).map_err(DelaunayError::Memory)?;
                }
                mesh.insert(number)
                    .map_err(|refusal| refusal.of(number, points[number as usize]))?;
            }
            mesh.into_cells()
        };
        let (tetrahedra, neighbours) = arranged(&all, &curve, cells, &alive);
        Ok(Self {
            points: all,
            tetrahedra,
            neighbours,
        })
    }
}

/// The corners and neighbours of the living cells, in an order that depends on the set of cells alone.
fn arranged(
    points: &[[f32; 3]],
    curve: &Curve,
    mut cells: Vec<Cell>,
    alive: &[bool],
) -> (Vec<[u32; 4]>, Vec<[u32; 4]>) {
    for cell in &mut cells {
        *cell = ascending(*cell);
    }
    let centre = |corners: [u32; 4]| {
        let sum = |k: usize| {
            corners
                .iter()
                .map(|c| f64::from(points[*c as usize][k]))
                .sum::<f64>()
        };
        [sum(0) * 0.25, sum(1) * 0.25, sum(2) * 0.25]
    };
    let mut order: Vec<(u64, u32)> = (0..)
        .zip(cells.iter().zip(alive))
        .filter(|(_, (_, alive))| **alive)
        .map(|(number, (cell, _))| (curve.place(centre(cell.corners)), number))
        .collect();
    let corners = |number: u32| cells[number as usize].corners;
    order.sort_unstable_by(|a, b| a.0.cmp(&b.0).then_with(|| corners(a.1).cmp(&corners(b.1))));
    let mut renumbered = vec![NONE; cells.len()];
    for (new, (_, old)) in (0..).zip(&order) {
        renumbered[*old as usize] = new;
    }
    let tetrahedra = order.iter().map(|(_, old)| corners(*old)).collect();
    // `NONE` is beyond the end and stays.
    let number = |old: u32| renumbered.get(old as usize).copied().unwrap_or(NONE);
    let neighbours = order
        .iter()
        .map(|(_, old)| cells[*old as usize].across.map(number))
        .collect();
    (tetrahedra, neighbours)
}

/// The cell with its two smallest corners first, ascending. The orientation then tells the order of the
/// others.
fn ascending(cell: Cell) -> Cell {
    let mut by_corner = [0, 1, 2, 3];
    by_corner.sort_unstable_by_key(|&k| cell.corners[k]);
    let pairs = (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j)));
    if pairs.filter(|&(i, j)| by_corner[i] > by_corner[j]).count() % 2 == 1 {
        by_corner.swap(2, 3);
    }
    Cell {
        corners: by_corner.map(|k| cell.corners[k]),
        across: by_corner.map(|k| cell.across[k]),
    }
}
