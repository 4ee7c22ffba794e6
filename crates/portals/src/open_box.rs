//! Boxes along walls, for rays: if a wall is in a face of the box, the face moves inward.
//!
//! Rays have origins in single precision, and rounding could move an origin through a wall in the box's face.
//! Exact queries need no gap ([`crate::OpenFaces`]).

use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_scene::overlap::triangle_touches_box;

use crate::planes::blocks;

/// Returns the box `view_box` with each face that contains a blocking triangle moved inward by `gap`, in
/// units of the scene.
///
/// If the box would become empty along an axis, the function does not move the two faces perpendicular to
/// that axis.
pub fn open_box(scene: &Scene, view_box: Aabb, gap: f32) -> Aabb {
    let mut is_walled = [[false; 2]; 3];
    for (id, axis) in walls_in_faces(scene, view_box) {
        let level = scene.triangles()[id as usize].v[0][axis];
        is_walled[axis][usize::from(level == view_box.max[axis])] = true;
    }
    let mut open = view_box;
    for (axis, [below, above]) in is_walled.into_iter().enumerate() {
        let lo = if below {
            view_box.min[axis] + gap
        } else {
            view_box.min[axis]
        };
        let hi = if above {
            view_box.max[axis] - gap
        } else {
            view_box.max[axis]
        };
        if lo < hi {
            (open.min[axis], open.max[axis]) = (lo, hi);
        }
    }
    open
}

/// Returns the ids of the blocking triangles in the faces of a box, each with the axis that the triangle is
/// perpendicular to.
pub fn walls_in_faces(scene: &Scene, bounds: Aabb) -> Vec<(u32, usize)> {
    let axis_of = |id: u32| {
        let triangle = &scene.triangles()[id as usize];
        let v = triangle.v;
        (0..3).find(|axis| {
            let level = v[0][*axis];
            let mut flat = bounds;
            (flat.min[*axis], flat.max[*axis]) = (level, level);
            (level == bounds.min[*axis] || level == bounds.max[*axis])
                && v.iter().all(|p| p[*axis] == level)
                && triangle_touches_box(triangle, &flat)
                && blocks(scene, id)
        })
    };
    (0..scene.len())
        .filter_map(|id| axis_of(id).map(|axis| (id, axis)))
        .collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use sightline_scene::{Object, Triangle};

    #[test]
    fn open_box_moves_only_faces_with_walls() {
        let wall = Triangle {
            v: [Vec3::ZERO, Vec3::Y, Vec3::Z],
        };
        let object = Object {
            name: "wall".to_owned(),
            first: 0,
            count: 1,
        };
        let scene = Scene::new("wall", vec![wall], vec![object]).unwrap();
        let make_box = |min: [f32; 3], max: [f32; 3]| Aabb::new(min.into(), max.into());
        let beside = make_box([0.0; 3], [1.0; 3]);
        assert_eq!(
            open_box(&scene, beside, 0.25),
            make_box([0.25, 0.0, 0.0], [1.0; 3])
        );
        // On the other side of the wall, the upper face moves. Beyond the wall's corner, no face moves.
        let other = open_box(&scene, make_box([-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]), 0.25);
        assert_eq!(other, make_box([-1.0, 0.0, 0.0], [-0.25, 1.0, 1.0]));
        let far = make_box([0.0, 2.0, 0.0], [1.0, 3.0, 1.0]);
        assert_eq!(open_box(&scene, far, 0.25), far);
        let thin = make_box([0.0; 3], [0.125, 1.0, 1.0]);
        assert_eq!(open_box(&scene, thin, 0.25), thin);
    }
}
