//! Viewpoints in closed meshes, or at eye height above a navigation mesh.
//!
//! A part that a triangle of a closed mesh touches is marked. The other parts form regions of neighbours
//! without a triangle between them, so a region is completely inside or completely outside. The winding
//! number of one point of a region (the sum of the solid angles of all triangles; Van Oosterom and Strackee
//! 1983) determines if the region is inside.

use std::collections::BTreeMap;

use glam::{DVec3, Vec3};
use sightline_numbers::Aabb;
use sightline_scene::{Scene, Triangle, overlap};
use sightline_viewcells::PartMask;

use crate::{PartPlanes, ViewpointsError, each, within};

/// Marks the parts inside the closed surfaces of `mesh`, and the parts that triangles of `mesh` touch.
///
/// # Errors
/// [`ViewpointsError::Open`] if the mesh is not closed.
pub fn mark_closed(
    parts: &PartPlanes,
    cells: [u32; 3],
    mesh: &Scene,
) -> Result<PartMask, ViewpointsError> {
    check_closed(mesh)?;
    let mut marks = PartMask::empty(cells);
    for triangle in mesh.triangles().iter().filter(|t| !t.is_degenerate()) {
        let touching = within(parts.touched(&triangle.bounds()));
        for part in touching.filter(|p| overlap::triangle_touches_box(triangle, &parts.bounds(*p)))
        {
            marks.mark(part);
        }
    }
    let sides = parts.sides();
    let index = |p: [u32; 3]| {
        ((p[2] as usize * sides[1] as usize) + p[1] as usize) * sides[0] as usize + p[0] as usize
    };
    let mut known = vec![false; sides.iter().map(|s| *s as usize).product()];
    each(sides)
        .filter(|p| marks.has(*p))
        .for_each(|p| known[index(p)] = true);
    for start in each(sides) {
        if known[index(start)] {
            continue;
        }
        let at = parts.bounds(start);
        let inside = winding(mesh.triangles(), ((at.min + at.max) * 0.5).as_dvec3()).abs() > 0.5;
        known[index(start)] = true;
        let mut open = vec![start];
        while let Some(part) = open.pop() {
            if inside {
                marks.mark(part);
            }
            for (axis, up) in (0..3).flat_map(|a| [(a, false), (a, true)]) {
                let mut next = part;
                next[axis] = if up {
                    part[axis] + 1
                } else {
                    part[axis].wrapping_sub(1)
                };
                if next[axis] < sides[axis] && !known[index(next)] {
                    known[index(next)] = true;
                    open.push(next);
                }
            }
        }
    }
    Ok(marks)
}

/// Marks the parts that contain points from `heights[0]` to `heights[1]` above a navigation mesh, in world
/// units along the axis `up` (0 = x, 1 = y, 2 = z).
pub fn mark_above(
    parts: &PartPlanes,
    cells: [u32; 3],
    mesh: &Scene,
    up: usize,
    heights: [f32; 2],
) -> PartMask {
    let mut marks = PartMask::empty(cells);
    for triangle in mesh.triangles() {
        let prism = Prism::new(triangle, up, heights);
        for part in within(parts.touched(&prism.bounds())) {
            if prism.meets(&parts.bounds(part)) {
                marks.mark(part);
            }
        }
    }
    marks
}

/// Computes the box around all points from `heights[0]` to `heights[1]` above a navigation mesh, in world
/// units along the axis `up`.
pub fn bounds_above(mesh: &Scene, up: usize, heights: [f32; 2]) -> Aabb {
    let Aabb { mut min, mut max } = mesh.bounds();
    min[up] += heights[0];
    max[up] += heights[1];
    Aabb { min, max }
}

/// The volume between two copies of a triangle that are moved to two heights along an axis.
struct Prism {
    corners: [DVec3; 6],
    /// The directions that may separate the prism from a box.
    axes: Vec<DVec3>,
}

impl Prism {
    fn new(triangle: &Triangle, up: usize, heights: [f32; 2]) -> Self {
        let v = triangle.v.map(Vec3::as_dvec3);
        let mut axis = DVec3::ZERO;
        axis[up] = 1.0;
        let [low, high] = heights.map(|h| axis * f64::from(h));
        let corners = [
            v[0] + low,
            v[1] + low,
            v[2] + low,
            v[0] + high,
            v[1] + high,
            v[2] + high,
        ];
        let edges = [v[1] - v[0], v[2] - v[1], v[0] - v[2], axis];
        let normal = edges[0].cross(edges[1]);
        // The separating axes are the normals of both shapes and the cross products of their edges. Cross
        // products with `axis` are the normals of the prism's sides.
        let units = [DVec3::X, DVec3::Y, DVec3::Z];
        let crosses = edges.into_iter().flat_map(|e| units.map(|u| e.cross(u)));
        let axes = crosses
            .chain([normal])
            .chain(edges.map(|e| e.cross(axis)))
            .collect();
        Self { corners, axes }
    }

    fn bounds(&self) -> Aabb {
        Aabb::around(self.corners.map(DVec3::as_vec3))
    }

    /// Returns true if the prism meets a box. If the distance of the two is about 0, rounding may determine
    /// the result. The error is below the resolution of single precision.
    fn meets(&self, bounds: &Aabb) -> bool {
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        self.axes.iter().all(|axis| {
            let [mut low, mut high] = [f64::INFINITY, f64::NEG_INFINITY];
            for corner in &self.corners {
                let at = corner.dot(*axis);
                (low, high) = (low.min(at), high.max(at));
            }
            let [mut least, mut most] = [0.0, 0.0];
            for a in 0..3 {
                let (p, q) = (min[a] * axis[a], max[a] * axis[a]);
                least += p.min(q);
                most += p.max(q);
            }
            low <= most && least <= high
        })
    }
}

/// Checks that every edge joins two triangles in opposite directions, or several such pairs. Vertices with
/// equal coordinates are the same vertex.
fn check_closed(mesh: &Scene) -> Result<(), ViewpointsError> {
    // For each edge, directed from its smaller corner: the number of triangles in this direction minus the
    // number of triangles in the opposite direction, and an end of the edge.
    let mut edges: BTreeMap<[[u32; 3]; 2], (i64, Vec3)> = BTreeMap::new();
    let key = |v: Vec3| v.to_array().map(|x| (x + 0.0).to_bits());
    for triangle in mesh.triangles().iter().filter(|t| !t.is_degenerate()) {
        for k in 0..3 {
            let (a, b) = (triangle.v[k], triangle.v[(k + 1) % 3]);
            let along = key(a) < key(b);
            let ends = if along {
                [key(a), key(b)]
            } else {
                [key(b), key(a)]
            };
            edges.entry(ends).or_insert((0, a)).0 += if along { 1 } else { -1 };
        }
    }
    let mut open = edges.values().filter(|(sum, _)| *sum != 0);
    match open.next() {
        None => Ok(()),
        Some((_, at)) => Err(ViewpointsError::Open {
            open: open.count() as u64 + 1,
            at: at.to_array(),
        }),
    }
}

/// Computes the winding number of the triangles around a point: the sum of their solid angles over 4π (Van
/// Oosterom and Strackee 1983).
pub(crate) fn winding(triangles: &[Triangle], point: DVec3) -> f64 {
    let angle = |t: &Triangle| {
        let [a, b, c] = t.v.map(|v| v.as_dvec3() - point);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        let over = a.dot(b.cross(c));
        let under = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * over.atan2(under)
    };
    triangles
        .iter()
        .filter(|t| !t.is_degenerate())
        .map(angle)
        .sum::<f64>()
        / (4.0 * std::f64::consts::PI)
}

#[cfg(test)]
mod tests {
    use sightline_scene::Object;
    use sightline_viewcells::Division;

    use super::*;

    fn scene(triangles: Vec<Triangle>) -> Scene {
        let count = triangles.len() as u32;
        Scene::new(
            "test",
            triangles,
            vec![Object {
                name: "all".into(),
                first: 0,
                count,
            }],
        )
        .unwrap()
    }

    /// Creates the surface of a box, facing outwards.
    fn solid(min: Vec3, max: Vec3) -> Vec<Triangle> {
        let at = |k: u32| {
            Vec3::from([0, 1, 2].map(|a| {
                if k >> a & 1 == 1 {
                    max[a as usize]
                } else {
                    min[a as usize]
                }
            }))
        };
        let quads = [
            [0, 4, 6, 2],
            [1, 3, 7, 5],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 2, 3, 1],
            [4, 5, 7, 6],
        ];
        let triangle = |q: [u32; 3]| Triangle { v: q.map(at) };
        quads
            .iter()
            .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
            .map(triangle)
            .collect()
    }

    fn parts() -> (PartPlanes, [u32; 3]) {
        let cells = [2, 2, 2];
        let lattice = Division::Grid(cells)
            .lattice(Vec3::ZERO, Vec3::splat(8.0))
            .unwrap();
        (PartPlanes::new(&lattice, cells), cells)
    }

    #[test]
    fn marks_inside_of_closed_mesh_and_not_cavity() {
        let (parts, cells) = parts();
        let mut triangles = solid(Vec3::splat(0.5), Vec3::splat(7.5));
        // A cavity: a smaller box that faces inwards.
        let hollow = solid(Vec3::splat(2.5), Vec3::splat(5.5));
        triangles.extend(hollow.iter().map(|t| Triangle {
            v: [t.v[0], t.v[2], t.v[1]],
        }));
        let marks = mark_closed(&parts, cells, &scene(triangles.clone())).unwrap();
        for part in each(marks.sides()) {
            let inside = part.iter().all(|p| (3..5).contains(p));
            assert_eq!(marks.has(part), !inside, "{part:?}");
        }
        triangles.pop();
        let refused = mark_closed(&parts, cells, &scene(triangles)).unwrap_err();
        assert!(
            matches!(refused, ViewpointsError::Open { open: 3, .. }),
            "{refused}"
        );
    }

    #[test]
    fn navigation_mesh_is_raised_to_eye_height() {
        let (parts, cells) = parts();
        let v = [
            Vec3::new(0.2, 1.0, 0.2),
            Vec3::new(3.8, 1.0, 0.2),
            Vec3::new(0.2, 1.0, 3.8),
        ];
        let marks = mark_above(&parts, cells, &scene(vec![Triangle { v }]), 1, [1.2, 1.8]);
        let marked: Vec<[u32; 3]> = each(marks.sides()).filter(|p| marks.has(*p)).collect();
        assert!(marked.iter().all(|p| p[1] == 2), "{marked:?}");
        // The triangle x + z ≤ 4 over squares with sides of 1.
        let over: Vec<[u32; 2]> = marked.iter().map(|p| [p[0], p[2]]).collect();
        let expected: Vec<[u32; 2]> = (0..4)
            .flat_map(|z| (0..4 - z).map(move |x| [x, z]))
            .collect();
        assert_eq!(over, expected);
    }
}
