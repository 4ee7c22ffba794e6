//! View cells along walls: a kd-tree of boxes whose planes are walls perpendicular to an axis, if such walls
//! exist (Teller 1992, sections 5.2.1 and 5.2.2).
//!
//! The algorithm divides the box with the largest volume next. The dividing plane contains the walls that
//! cover most of the box's section, with a penalty for uneven division. If no walls cover enough, the plane
//! is perpendicular to the box's longest side and in its middle. The choice of planes affects the size of
//! sets but never their correctness, so the arithmetic is rounded.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use glam::{DVec2, Vec3};
use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_viewcells::division::ROUNDING;
use sightline_viewcells::kd_tree::{KdTree, MOST_PLANES};

use crate::enclosure::WALL;
use crate::planes::{blocks, by_place};

/// The weight of an uneven division against the covered fraction of the section.
const UNEVEN: f64 = 0.3;
/// The minimum width of a box, in units of the rounding error of the view box's largest coordinate.
const LEAST: f32 = 64.0;
/// The depth in the tree from which the algorithm halves boxes instead of dividing them along walls.
///
/// This bounds the depth of the tree if a scene has a long row of walls.
const DEEP: usize = MOST_PLANES / 2;

/// A wall triangle perpendicular to an axis.
struct Wall {
    axis: usize,
    /// The coordinate of the triangle on the axis.
    level: f32,
    /// The coordinates of the corners on the other two axes.
    corners: [DVec2; 3],
}

/// A box of the tree.
struct BoxNode {
    bounds: Aabb,
    depth: usize,
    /// The plane that divides the box, as axis and coordinate on the axis, and the indices of both child
    /// boxes. `None` for a leaf.
    split: Option<(usize, f32, [usize; 2])>,
}

/// Divides a view box into a kd-tree of at most `most` boxes.
///
/// The function does not divide a box for which `is_used` returns false.
///
/// # Panics
/// If `most` is 0 or above the maximum number of boxes of a [`KdTree`].
pub fn along_walls(
    scene: &Scene,
    view_box: Aabb,
    most: usize,
    is_used: &dyn Fn(Aabb) -> bool,
) -> KdTree {
    let largest = view_box.min.abs().max(view_box.max.abs()).max_element();
    let least = largest * f32::EPSILON * ROUNDING * LEAST;
    let walls: Vec<Wall> = by_place(scene)
        .into_iter()
        .filter_map(|id| wall(scene, id))
        .collect();
    let all: Vec<u32> = (0..walls.len() as u32).collect();
    let mut nodes = vec![BoxNode {
        bounds: view_box,
        depth: 0,
        split: None,
    }];
    let mut boxes = 1;
    // The bits of volumes have the order of the volumes, because volumes are not negative. Of equal volumes,
    // the node with the lowest index comes first.
    let mut open = BinaryHeap::new();
    let offer = |open: &mut BinaryHeap<_>, node: usize, node_bounds: Aabb, inside: Vec<u32>| {
        if is_used(node_bounds) {
            let size = (node_bounds.max - node_bounds.min).as_dvec3();
            open.push((size.element_product().to_bits(), Reverse(node), inside));
        }
    };
    offer(&mut open, 0, view_box, all);
    while boxes < most
        && let Some((_, Reverse(node), inside)) = open.pop()
    {
        let (bounds, depth) = (nodes[node].bounds, nodes[node].depth);
        let wall = if depth < DEEP {
            best(&walls, &inside, bounds, least)
        } else {
            None
        };
        let Some((axis, at)) = wall.or_else(|| middle(bounds, least)) else {
            continue;
        };
        let [mut below, mut above] = [bounds; 2];
        below.max[axis] = at;
        above.min[axis] = at;
        let children = [nodes.len(), nodes.len() + 1];
        nodes[node].split = Some((axis, at, children));
        boxes += 1;
        for (bounds, child) in [below, above].into_iter().zip(children) {
            nodes.push(BoxNode {
                bounds,
                depth: depth + 1,
                split: None,
            });
            let in_it = inside
                .iter()
                .copied()
                .filter(|k| covered(&walls[*k as usize], bounds) > 0.0);
            if depth + 1 < MOST_PLANES {
                offer(&mut open, child, bounds, in_it.collect());
            }
        }
    }
    let (mut axes, mut planes, mut waiting) = (Vec::new(), Vec::new(), vec![0]);
    while let Some(node) = waiting.pop() {
        match nodes[node].split {
            None => axes.push(3),
            Some((axis, at, [below, above])) => {
                axes.push(axis as u32);
                planes.push(at);
                waiting.extend([above, below]);
            }
        }
    }
    KdTree::new(&axes, &planes).expect("the boxes are a tree")
}

/// Returns a triangle as a wall if the triangle blocks and is perpendicular to an axis.
fn wall(scene: &Scene, id: u32) -> Option<Wall> {
    let v = scene.triangles()[id as usize].v;
    let axis = (0..3).find(|a| v.iter().all(|p| p[*a] == v[0][*a]))?;
    let along = |p: Vec3| DVec2::new(f64::from(p[(axis + 1) % 3]), f64::from(p[(axis + 2) % 3]));
    // −0 and 0 are the same coordinate.
    blocks(scene, id).then(|| Wall {
        axis,
        level: v[0][axis] + 0.0,
        corners: v.map(along),
    })
}

/// Computes the area of the part of a wall that is within a box.
///
/// The area is 0 if the plane of the wall does not meet the closed box.
fn covered(wall: &Wall, region: Aabb) -> f64 {
    if !(region.min[wall.axis] <= wall.level && wall.level <= region.max[wall.axis]) {
        return 0.0;
    }
    let [a, b] = [(wall.axis + 1) % 3, (wall.axis + 2) % 3];
    let bounds = [
        (0, region.min[a], region.max[a]),
        (1, region.min[b], region.max[b]),
    ];
    let mut part = wall.corners.to_vec();
    for (axis, min, max) in bounds {
        for (level, sign) in [(f64::from(min), 1.0), (f64::from(max), -1.0)] {
            part = clip(&part, axis, level, sign);
        }
    }
    let Some(first) = part.first() else {
        return 0.0;
    };
    let fan = part
        .windows(2)
        .map(|w| (w[0] - *first).perp_dot(w[1] - *first));
    fan.sum::<f64>().abs() / 2.0
}

/// Returns the part of a polygon where `sign` times the coordinate along `axis`, relative to `level`, is not
/// negative.
fn clip(part: &[DVec2], axis: usize, level: f64, sign: f64) -> Vec<DVec2> {
    let far = |p: DVec2| sign * (p[axis] - level);
    let mut out = Vec::with_capacity(part.len() + 1);
    for (k, p) in part.iter().enumerate() {
        let next = part[(k + 1) % part.len()];
        let (a, b) = (far(*p), far(next));
        if a >= 0.0 {
            out.push(*p);
        }
        if a * b < 0.0 {
            out.push(p.lerp(next, a / (a - b)));
        }
    }
    out
}

/// Returns the best plane of walls for the division of a box, as its axis and its coordinate on the axis.
///
/// Both parts of the box must be at least `least` wide. The result is `None` if no plane has walls that cover
/// at least the fraction [`WALL`] of the box's section.
fn best(walls: &[Wall], inside: &[u32], bounds: Aabb, least: f32) -> Option<(usize, f32)> {
    let mut areas: BTreeMap<(usize, u32), (f32, f64)> = BTreeMap::new();
    for wall in inside.iter().map(|k| &walls[*k as usize]) {
        if wall.level - bounds.min[wall.axis] >= least
            && bounds.max[wall.axis] - wall.level >= least
        {
            areas
                .entry((wall.axis, wall.level.to_bits()))
                .or_insert((wall.level, 0.0))
                .1 += covered(wall, bounds);
        }
    }
    let size = (bounds.max - bounds.min).as_dvec3();
    let merit = |((axis, _), (level, area)): (&(usize, u32), &(f32, f64))| {
        let section = size[(axis + 1) % 3] * size[(axis + 2) % 3];
        let covered = (area / section).min(1.0);
        let place = f64::from(level - bounds.min[*axis]) / size[*axis];
        (covered >= WALL).then_some((
            covered - UNEVEN * (2.0 * place - 1.0).abs(),
            (*axis, *level),
        ))
    };
    let better = |best: (f64, (usize, f32)), next: (f64, (usize, f32))| {
        if next.0 > best.0 { next } else { best }
    };
    areas
        .iter()
        .filter_map(merit)
        .reduce(better)
        .map(|(_, plane)| plane)
}

/// Returns the axis of a box's longest side, and the coordinate of the middle of this side.
///
/// The result is `None` if a half would be narrower than `least`.
fn middle(bounds: Aabb, least: f32) -> Option<(usize, f32)> {
    let size = bounds.max - bounds.min;
    let axis = (1..3).fold(
        0,
        |longest, a| if size[a] > size[longest] { a } else { longest },
    );
    let at = bounds.min[axis].midpoint(bounds.max[axis]) + 0.0;
    (at - bounds.min[axis] >= least && bounds.max[axis] - at >= least).then_some((axis, at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sightline_scene::{Object, Triangle};

    /// Creates a scene with a wall across x at 1/4 that covers the whole section of the unit cube.
    fn scene() -> Scene {
        let at = |y: f32, z: f32| Vec3::new(0.25, y, z);
        let triangles = vec![
            Triangle {
                v: [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)],
            },
            Triangle {
                v: [at(1.0, 1.0), at(1.0, 0.0), at(0.0, 1.0)],
            },
        ];
        let object = Object {
            name: "wall".to_owned(),
            first: 0,
            count: 2,
        };
        Scene::new("wall", triangles, vec![object]).unwrap()
    }

    #[test]
    fn division_prefers_walls_to_middle() {
        let cube = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let divide_cube = |most, is_used: &dyn Fn(Aabb) -> bool| {
            along_walls(&scene(), cube, most, is_used).parts()
        };
        assert_eq!(divide_cube(1, &|_| true), (vec![3], vec![]));
        assert_eq!(divide_cube(2, &|_| true), (vec![0, 3, 3], vec![0.25]));
        // The larger box is halved along y, because its sides along y and z are the longest.
        assert_eq!(
            divide_cube(3, &|_| true),
            (vec![0, 3, 1, 3, 3], vec![0.25, 0.5])
        );
        assert_eq!(
            divide_cube(8, &|part| part.max.x <= 0.25 || part.min == Vec3::ZERO).1[0],
            0.25
        );
        assert_eq!(divide_cube(8, &|_| false), (vec![3], vec![]));
    }

    /// Uses the floors of a tower that grows narrower: each floor is the best wall of the remaining box.
    #[test]
    fn row_of_walls_makes_no_deep_tree() {
        let floor = |k: usize| {
            let (x, y) = (1.0 - k as f32 / 400.0, k as f32);
            let at = |u: f32, v: f32| Vec3::new(x * u, y, x * v);
            [
                [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)],
                [at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)],
            ]
            .map(|v| Triangle { v })
        };
        let triangles: Vec<Triangle> = (0..150).flat_map(floor).collect();
        let object = Object {
            name: "tower".to_owned(),
            first: 0,
            count: triangles.len() as u32,
        };
        let tower = Scene::new("tower", triangles, vec![object]).unwrap();
        assert_eq!(
            along_walls(&tower, tower.bounds(), 128, &|_| true).boxes(),
            128
        );
    }
}
