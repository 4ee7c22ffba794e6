//! Construction of the Delaunay tetrahedra of points and of a box around these points.

use super::curve::{Curve, insertion_order};
use super::enclosure::corners;
use super::error::DelaunayError;
use super::mesh::{Cell, MOST_POINTS, Mesh, NONE};
use super::predicates::Predicates;
use crate::watch::{BuildObserver, BuildStage, Quiet};

/// Expected memory per point, in bytes: about 8 tetrahedra with 110 bytes each.
const BYTES_A_POINT: u64 = 880;
/// Number of inserted points between two progress reports.
const TELL_EVERY: u64 = 4096;

/// Delaunay tetrahedra of distinct points and a box around the points.
///
/// The tetrahedra fill the box, and each has a volume. The result depends only on the points and their
/// numbers. If five or more points lie on one sphere, several choices are Delaunay. Then the points are
/// lifted by infinitely small heights, which are larger for smaller numbers. So the choices agree with each
/// other, and the tetrahedra have a front-to-back order from every viewpoint.
#[derive(Clone, Debug, PartialEq)]
pub struct Delaunay {
    /// The given points in their order, then the 8 corners of the box.
    ///
    /// Corner k has the upper x if bit 0 of k is set, the upper y if bit 1 is set, and the upper z if bit 2
    /// is set.
    pub points: Vec<[f32; 3]>,
    /// The corners a, b, c, d of each tetrahedron, as point numbers.
    ///
    /// The corners satisfy (b − a) × (c − a) · (d − a) > 0.
    ///
    /// The first two corners are the smallest of the four numbers, in ascending order. Tetrahedra are in the
    /// order of their centres along a Hilbert curve.
    pub tetrahedra: Vec<[u32; 4]>,
    /// The four neighbours of each tetrahedron.
    ///
    /// Entry k is the number of the tetrahedron across the face opposite corner k, or [`NONE`] on the border
    /// of the box.
    pub neighbours: Vec<[u32; 4]>,
}

impl Delaunay {
    /// Computes the Delaunay tetrahedra of distinct finite points.
    ///
    /// The function needs about 110 bytes per tetrahedron while it runs. A scene has 6 to 8 tetrahedra per
    /// point, but N points on two skew curves have about N² tetrahedra.
    ///
    /// # Errors
    ///
    /// [`DelaunayError`] if points are not finite or not distinct, if the box exceeds the range of `f32`, or
    /// if the points or the tetrahedra are too many for 32-bit numbers.
    pub fn new(points: &[[f32; 3]]) -> Result<Self, DelaunayError> {
        Self::with_seed(points, 0, &Quiet)
    }

    /// Computes the tetrahedra like [`Self::new`] and reports the progress to an observer.
    ///
    /// # Errors
    ///
    /// The errors of [`Self::new`], and [`DelaunayError::Memory`] if the observer rejects the memory use.
    pub fn watched(points: &[[f32; 3]], watch: &dyn BuildObserver) -> Result<Self, DelaunayError> {
        Self::with_seed(points, 0, watch)
    }

    /// Computes the tetrahedra like [`Self::watched`], with an insertion order that `seed` determines.
    ///
    /// The result is the same for every seed. Tests check this.
    ///
    /// # Errors
    ///
    /// The errors of [`Self::watched`].
    pub fn with_seed(
        points: &[[f32; 3]],
        seed: u64,
        watch: &dyn BuildObserver,
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
                    watch.done(BuildStage::Points, done, points.len() as u64);
                    // Points on few curves have far more tetrahedra than other points.
                    watch.needs(mesh.bytes()).map_err(DelaunayError::Memory)?;
                }
                mesh.insert(number)
                    .map_err(|refusal| refusal.into_error(number, points[number as usize]))?;
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

/// Returns the corners and neighbours of the existing cells, sorted along the Hilbert curve.
///
/// The order depends only on the set of cells. `alive` is true for the cells that exist.
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
    // `NONE` is beyond the end of the list and remains `NONE`.
    let number = |old: u32| renumbered.get(old as usize).copied().unwrap_or(NONE);
    let neighbours = order
        .iter()
        .map(|(_, old)| cells[*old as usize].across.map(number))
        .collect();
    (tetrahedra, neighbours)
}

/// Moves the two smallest corners of the cell to the front, in ascending order.
///
/// The positive orientation then determines the order of the other two corners.
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
