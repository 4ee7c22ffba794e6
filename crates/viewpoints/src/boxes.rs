//! Viewpoints in the union of several boxes.

use sightline_numbers::Aabb;
use sightline_viewcells::PartMask;

use crate::{PartPlanes, within};

/// Marks the parts that share a volume with one of the boxes. A flat box must share an area, a length or a
/// point with a part. `cells` are the numbers of cells along each axis of the grid of `parts`.
pub fn mark(parts: &PartPlanes, cells: [u32; 3], boxes: &[Aabb]) -> PartMask {
    let mut marks = PartMask::empty(cells);
    for marked in boxes {
        for part in within(parts.touched(marked)) {
            let at = parts.bounds(part);
            let shares = |a: usize| match marked.min[a] == marked.max[a] {
                // A box without extent along the axis belongs to the part above it, like a point.
                true => {
                    let last = at.max[a] == parts.whole().max[a] && marked.min[a] == at.max[a];
                    at.min[a] <= marked.min[a] && (marked.min[a] < at.max[a] || last)
                }
                // A shared face, edge or corner is not a volume.
                false => at.min[a] < marked.max[a] && marked.min[a] < at.max[a],
            };
            if (0..3).all(shares) {
                marks.mark(part);
            }
        }
    }
    marks
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_viewcells::Division;

    use super::*;

    #[test]
    fn marks_only_parts_that_share_volume_with_box() {
        let cells = [2, 1, 1];
        let lattice = Division::Grid(cells)
            .lattice(Vec3::ZERO, Vec3::new(8.0, 4.0, 4.0))
            .unwrap();
        let parts = PartPlanes::new(&lattice, cells);
        // The sides of the parts are 1.
        let boxes = [
            Aabb {
                min: Vec3::new(0.5, 0.0, 0.0),
                max: Vec3::new(2.0, 1.0, 1.0),
            },
            Aabb {
                min: Vec3::new(7.5, 3.5, 3.5),
                max: Vec3::splat(20.0),
            },
        ];
        let marks = mark(&parts, cells, &boxes);
        let marked: Vec<[u32; 3]> = crate::each(marks.sides())
            .filter(|p| marks.has(*p))
            .collect();
        assert_eq!(marked, [[0, 0, 0], [1, 0, 0], [7, 3, 3]]);
        // Flat boxes on planes between parts, and at the end of the view box.
        let flat = |x: f32| {
            mark(
                &parts,
                cells,
                &[Aabb {
                    min: Vec3::new(x, 0.0, 0.0),
                    max: Vec3::new(x, 1.0, 1.0),
                }],
            )
        };
        assert!(flat(2.0).has([2, 0, 0]) && flat(2.0).marked() == 1);
        assert!(flat(8.0).has([7, 0, 0]) && flat(8.0).marked() == 1);
        assert_eq!(parts.of_point([8.0, 4.0, 4.0]), Some([7, 3, 3]));
        assert_eq!(parts.of_point([1.0, 0.0, 0.0]), Some([1, 0, 0]));
        assert_eq!(parts.of_point([8.1, 0.0, 0.0]), None);
    }
}
