//! The weights of the cells of a grid: the shares of the weights of a file's viewpoints.

use sightline_viewcells::{Lattice, PartMask, UNITS_PER_CELL};
use sightline_viewpoints::points::WeightedViewpoint;

/// The sum of the weights of all cells, apart from rounding.
const WHOLE: f64 = (1u32 << 24) as f64;

/// Returns the planes of a grid along each axis, ascending.
pub(crate) fn grid_planes(lattice: &Lattice, cells: [u32; 3]) -> [Vec<f32>; 3] {
    [0, 1, 2].map(|axis: usize| {
        (0..=cells[axis])
            .map(|at| lattice.coordinate(axis, at * UNITS_PER_CELL))
            .collect()
    })
}

/// Computes the weights of the cells between these planes, x fastest, then y, then z. A cell that contains a
/// viewpoint has a weight of at least 1. Viewpoints in cells without marked parts have no weight. Returns
/// `None` if no viewpoint has a weight.
pub(crate) fn cell_weights(
    points: &[WeightedViewpoint],
    planes: &[Vec<f32>; 3],
    reached: Option<&PartMask>,
) -> Option<Vec<u32>> {
    let [nx, ny, nz] = planes.each_ref().map(|planes| planes.len() - 1);
    let mut sums = vec![0f64; nx * ny * nz];
    for viewpoint in points {
        let along = |axis: usize| {
            let (planes, at) = (&planes[axis], viewpoint.point[axis]);
            let inside = planes[0] <= at && at <= planes[planes.len() - 1];
            let above = planes.partition_point(|plane| *plane <= at);
            inside.then(|| above.min(planes.len() - 1) - 1)
        };
        let Some([x, y, z]) = along(0)
            .zip(along(1))
            .zip(along(2))
            .map(|((x, y), z)| [x, y, z])
        else {
            continue;
        };
        let number = (z * ny + y) * nx + x;
        if reached.is_none_or(|mask| mask.parts(number) != 0) {
            sums[number] += viewpoint.weight;
        }
    }
    let total: f64 = sums.iter().sum();
    let weight = |sum: &f64| match *sum > 0.0 {
        true => ((sum / total * WHOLE).round() as u32).max(1),
        false => 0,
    };
    (total > 0.0 && total.is_finite()).then(|| sums.iter().map(weight).collect())
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_viewcells::Division;

    use super::*;

    fn at(point: [f32; 3], weight: f64) -> WeightedViewpoint {
        WeightedViewpoint { point, weight }
    }

    #[test]
    fn weights_are_shares_of_reached_cells() {
        let cells = [2, 1, 2];
        let lattice = Division::Grid(cells)
            .lattice(Vec3::ZERO, Vec3::splat(4.0))
            .unwrap();
        let points = [
            at([1.0, 0.0, 1.0], 3.0),
            at([4.0, 4.0, 4.0], 1.0),
            at([2.0, 1.0, 0.0], 1e-12),
            at([5.0, 1.0, 1.0], 9.0),
        ];
        let planes = grid_planes(&lattice, cells);
        let weights = cell_weights(&points, &planes, None).unwrap();
        assert_eq!(weights, [3 << 22, 1, 0, 1 << 22]);
        // Cell 3 has no viewpoints.
        let mut mask = PartMask::empty(cells);
        mask.mark_all(0);
        let weights = cell_weights(&points, &planes, Some(&mask)).unwrap();
        assert_eq!(weights, [1 << 24, 0, 0, 0]);
        assert_eq!(cell_weights(&points[3..], &planes, None), None);
    }
}
