//! View cells along walls: a kd-tree of boxes whose planes are walls across an axis, where there are some
//! (Teller 1992, sections 5.2.1 and 5.2.2).
//!
//! The largest box is divided next: along the wall that covers most of it, less the more unevenly it divides,
//! and in the middle of its longest side where no wall covers much. Which planes are chosen decides how large
//! sets are, never whether they are right, so the arithmetic is rounded.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use glam::{DVec2, Vec3};
use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_viewcells::division::ROUNDING;
use sightline_viewcells::kd_tree::{KdTree, MOST_PLANES};

use crate::enclose::WALL;
use crate::planes::{blocks, by_place};

/// How much an uneven division counts against a covered section.
const UNEVEN: f64 = 0.3;
/// The least width of a box, in roundings of the greatest coordinate.
const LEAST: f32 = 64.0;
/// Boxes with more planes above them are halved, so that a row of walls makes no tree that is too deep.
const DEEP: usize = MOST_PLANES / 2;

/// A triangle across an axis: the axis, its level, and its corners along the other axes.
struct Wall {
    axis: usize,
    level: f32,
    corners: [DVec2; 3],
}

/// A box of the tree, and its planes' children.
struct BoxNode {
    of: Aabb,
    depth: usize,
    split: Option<(usize, f32, [usize; 2])>,
}

/// A tree of at most `most` boxes of a view box. Boxes for which `is_used` is false are divided no further.
///
/// # Panics
/// When `most` is 0 or above the most boxes of a [`KdTree`].
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
        of: view_box,
        depth: 0,
        split: None,
    }];
    let mut boxes = 1;
    // Volumes are not negative, so their bits are in their order; the first of equals comes first.
    let mut open = BinaryHeap::new();
    let offer = |open: &mut BinaryHeap<_>, node: usize, of: Aabb, inside: Vec<u32>| {
        if is_used(of) {
            let size = (of.max - of.min).as_dvec3();
            open.push((size.element_product().to_bits(), Reverse(node), inside));
        }
    };
    offer(&mut open, 0, view_box, all);
    while boxes < most
        && let Some((_, Reverse(node), inside)) = open.pop()
    {
        let (bounds, depth) = (nodes[node].of, nodes[node].depth);
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
        for (of, child) in [below, above].into_iter().zip(children) {
            nodes.push(BoxNode {
                of,
                depth: depth + 1,
                split: None,
            });
            let in_it = inside
                .iter()
                .copied()
                .filter(|k| covered(&walls[*k as usize], of) > 0.0);
            if depth + 1 < MOST_PLANES {
                offer(&mut open, child, of, in_it.collect());
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

/// A triangle as a wall, if it blocks and is across an axis.
fn wall(scene: &Scene, id: u32) -> Option<Wall> {
    let v = scene.triangles()[id as usize].v;
    let axis = (0..3).find(|a| v.iter().all(|p| p[*a] == v[0][*a]))?;
    let along = |p: Vec3| DVec2::new(f64::from(p[(axis + 1) % 3]), f64::from(p[(axis + 2) % 3]));
    // −0 and 0 are one level.
    blocks(scene, id).then(|| Wall {
        axis,
        level: v[0][axis] + 0.0,
        corners: v.map(along),
    })
}

/// The area of a wall within a box; 0 if its level is not in the closed box.
fn covered(wall: &Wall, of: Aabb) -> f64 {
    if !(of.min[wall.axis] <= wall.level && wall.level <= of.max[wall.axis]) {
        return 0.0;
    }
    let [a, b] = [(wall.axis + 1) % 3, (wall.axis + 2) % 3];
    let bounds = [(0, of.min[a], of.max[a]), (1, of.min[b], of.max[b])];
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

/// The part of a polygon where `sign` times the distance from a level is not negative.
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

/// The wall that divides a box best.
fn best(walls: &[Wall], inside: &[u32], of: Aabb, least: f32) -> Option<(usize, f32)> {
    let mut areas: BTreeMap<(usize, u32), (f32, f64)> = BTreeMap::new();
    for wall in inside.iter().map(|k| &walls[*k as usize]) {
        if wall.level - of.min[wall.axis] >= least && of.max[wall.axis] - wall.level >= least {
            areas
                .entry((wall.axis, wall.level.to_bits()))
                .or_insert((wall.level, 0.0))
                .1 += covered(wall, of);
        }
    }
    let size = (of.max - of.min).as_dvec3();
    let merit = |((axis, _), (level, area)): (&(usize, u32), &(f32, f64))| {
        let section = size[(axis + 1) % 3] * size[(axis + 2) % 3];
        let covered = (area / section).min(1.0);
        let place = f64::from(level - of.min[*axis]) / size[*axis];
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

/// The middle of the longest side of a box.
fn middle(of: Aabb, least: f32) -> Option<(usize, f32)> {
    let size = of.max - of.min;
    let axis = (1..3).fold(
        0,
        |longest, a| if size[a] > size[longest] { a } else { longest },
    );
    let at = of.min[axis].midpoint(of.max[axis]) + 0.0;
    (at - of.min[axis] >= least && of.max[axis] - at >= least).then_some((axis, at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sightline_scene::{Object, Triangle};

    /// A wall across x at 1/4 that covers all of the unit cube's section.
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
    fn walls_come_first_and_then_the_middle() {
        let cube = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let divide_cube = |most, is_used: &dyn Fn(Aabb) -> bool| {
            along_walls(&scene(), cube, most, is_used).parts()
        };
        assert_eq!(divide_cube(1, &|_| true), (vec![3], vec![]));
        assert_eq!(divide_cube(2, &|_| true), (vec![0, 3, 3], vec![0.25]));
        // The larger box is halved, along y as its sides along y and z are the longest.
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

    /// Floors of a tower that grows narrower: each is the best wall of what is left.
    #[test]
    fn a_row_of_walls_makes_no_deep_tree() {
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
