//! Viewpoints in any of several boxes.

use sightline_numbers::Aabb;
use sightline_viewcells::PartMask;

use crate::{Parts, within};

/// Marks the parts that share a volume with one of the boxes, or an area or a length with a flat one.
/// `cells` are those of the grid of `parts`.
pub fn mark(parts: &Parts, cells: [u32; 3], boxes: &[Aabb]) -> PartMask {
    let mut marks = PartMask::empty(cells);
    for of in boxes {
        for part in within(parts.touched(of)) {
            let at = parts.bounds(part);
            let shares = |a: usize| match of.min[a] == of.max[a] {
                // As of a point: the part above it.
                true => {
                    let last = at.max[a] == parts.whole().max[a] && of.min[a] == at.max[a];
                    at.min[a] <= of.min[a] && (of.min[a] < at.max[a] || last)
                }
                // A common face, edge or corner is no volume.
                false => at.min[a] < of.max[a] && of.min[a] < at.max[a],
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
    fn parts_that_share_volume_with_a_box_are_marked_and_no_others() {
        let cells = [2, 1, 1];
        let lattice = Division::Grid(cells)
            .lattice(Vec3::ZERO, Vec3::new(8.0, 4.0, 4.0))
            .unwrap();
        let parts = Parts::new(&lattice, cells);
        // Parts have sides of one.
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
        // Flat ones on planes between parts, and at the end of the box.
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
