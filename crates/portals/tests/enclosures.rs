//! Tests of enclosures: known buildings, and random buildings against free segments.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::cmp::Ordering;

use glam::{Quat, Vec3};
use proptest::prelude::*;
use sightline_geometry::predicates::orient3d_sign;
use sightline_numbers::Aabb;
use sightline_portals::{
    Enclosure, EnclosureLimits, RegionPlanes, Tree, enclose, reached, region_of,
};
use sightline_scene::{Object, Scene, Triangle};

/// Creates the two triangles of a quad from its corners in order.
fn quad(v: [[f32; 3]; 4]) -> [Triangle; 2] {
    let v = v.map(Vec3::from);
    [
        Triangle {
            v: [v[0], v[1], v[2]],
        },
        Triangle {
            v: [v[0], v[2], v[3]],
        },
    ]
}

/// Creates the faces of a box.
fn walls(min: [f32; 3], max: [f32; 3]) -> Vec<Triangle> {
    let at = |k: usize| [0, 1, 2].map(|a| if k >> a & 1 == 1 { max[a] } else { min[a] });
    [
        [0, 1, 3, 2],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 3, 7, 5],
    ]
    .iter()
    .flat_map(|face| quad(face.map(at)))
    .collect()
}

/// Creates two rooms next to each other along x.
///
/// The wall between them, at x = 2, has a door at y from 0 to 1 and z from 1 to 2.
fn rooms() -> Vec<Triangle> {
    let mut all = walls([0.0; 3], [4.0, 2.0, 3.0]);
    let wall = |y: [f32; 2], z: [f32; 2]| {
        quad([
            [2.0, y[0], z[0]],
            [2.0, y[1], z[0]],
            [2.0, y[1], z[1]],
            [2.0, y[0], z[1]],
        ])
    };
    all.extend(wall([0.0, 2.0], [0.0, 1.0]));
    all.extend(wall([0.0, 2.0], [2.0, 3.0]));
    all.extend(wall([1.0, 2.0], [1.0, 2.0]));
    all
}

fn door() -> [Triangle; 2] {
    quad([
        [2.0, 0.0, 1.0],
        [2.0, 1.0, 1.0],
        [2.0, 1.0, 2.0],
        [2.0, 0.0, 2.0],
    ])
}

fn scene(triangles: Vec<Triangle>) -> Scene {
    let object = Object {
        name: "all".to_owned(),
        first: 0,
        count: triangles.len() as u32,
    };
    Scene::new("test", triangles, vec![object]).unwrap()
}

/// Returns the enclosure of a point, the region that the point reaches, and the number of leaves.
fn around(scene: &Scene, seed: [f32; 3]) -> (Enclosure, RegionPlanes, usize) {
    let mut tree = Tree::new(scene, &[seed]);
    let found = enclose(&mut tree, &[seed], EnclosureLimits::default(), &mut |_| {
        true
    });
    let leaves = reached(&tree, &[seed]);
    let region = region_of(&tree, &leaves).unwrap();
    (
        found,
        RegionPlanes::new(&region, scene).unwrap(),
        tree.len(),
    )
}

fn holds(region: &RegionPlanes, p: [f32; 3]) -> bool {
    region.holds(p.into())
}

#[test]
fn point_reaches_only_its_closed_room() {
    let mut triangles = rooms();
    triangles.extend(door());
    let (found, region, _) = around(&scene(triangles), [1.0, 1.0, 1.5]);
    assert_eq!(found, Enclosure::Closed);
    assert!(
        holds(&region, [0.5, 0.5, 0.5]) && holds(&region, [2.0, 1.0, 1.0]),
        "walls belong to it"
    );
    // The test checks a wall of the other room, and the door from both sides of a cell that ends there.
    let whole = Aabb::new(Vec3::splat(-1.0), Vec3::splat(9.0));
    assert!(!region.touches(
        [[4.0, 0.0, 0.0], [4.0, 2.0, 0.0], [4.0, 2.0, 3.0]].map(Vec3::from),
        whole
    ));
    assert!(region.touches(door()[0].v, whole));
    let cell = Aabb::new(Vec3::new(1.0, 0.0, 0.0), Vec3::new(2.0, 2.0, 3.0));
    let face = sightline_exact::Polygon::face_of(cell, 0, true);
    assert!(
        region.parts(&face).is_empty(),
        "the wall and the door are in the face"
    );
    let face = sightline_exact::Polygon::face_of(cell, 0, false);
    assert_eq!(region.parts(&face).len(), 1);
    assert!(!holds(&region, [3.0, 1.0, 1.5]) && !holds(&region, [1.0, 1.0, 4.0]));
    assert!(region.meets(Aabb::new(Vec3::splat(-1.0), Vec3::splat(0.1))));
    assert!(
        region.meets(Aabb::new(Vec3::splat(-1.0), Vec3::splat(9.0))),
        "the region is inside the box"
    );
    assert!(
        !region.meets(Aabb::new(Vec3::splat(-1.0), Vec3::splat(0.0))),
        "they share a corner alone"
    );
    assert!(!region.meets(Aabb::new(
        Vec3::new(2.0, 0.0, 0.0),
        Vec3::new(3.0, 1.0, 1.0)
    )));
    let inside = region
        .any_in(Aabb::new(Vec3::splat(-1.0), Vec3::splat(9.0)))
        .unwrap();
    assert!(region.holds(inside));
}

#[test]
fn open_door_connects_rooms_and_furniture_stays_detail() {
    let mut triangles = rooms();
    let (_, _, few) = around(&scene(triangles.clone()), [1.0, 1.0, 1.5]);
    for k in 0..40 {
        let at = 0.3 + 0.08 * (k % 6) as f32;
        let up = 0.1 + 0.02 * k as f32;
        triangles.extend(walls([at, at + 0.3, up], [at + 0.05, at + 0.37, up + 0.01]));
    }
    let (found, region, many) = around(&scene(triangles), [1.0, 1.0, 1.5]);
    assert_eq!(found, Enclosure::Closed);
    assert!(holds(&region, [3.0, 1.0, 1.5]) && !holds(&region, [5.0, 1.0, 1.5]));
    assert!(
        many < few + 10,
        "{many} leaves with furniture, {few} without"
    );
}

#[test]
fn missing_triangle_is_leak_with_position() {
    let mut triangles = rooms();
    // The removed triangle is half of the face at z = 3.
    triangles.remove(2);
    let scene = scene(triangles);
    let seed = [1.0, 1.0, 1.5];
    let mut tree = Tree::new(&scene, &[seed]);
    let Enclosure::Leak(leaves, portals) =
        enclose(&mut tree, &[seed], EnclosureLimits::default(), &mut |_| {
            true
        })
    else {
        panic!("there is a way out")
    };
    assert_eq!(leaves.len(), portals.len() + 1);
    let through = portals.iter().map(|p| &tree.portal(*p).face).any(|face| {
        let middle = face.middle();
        (middle.z - 3.0).abs() < 1e-6 && face.width() > 0.5
    });
    assert!(through, "the way goes through the missing triangle");
}

#[test]
fn point_on_wall_reaches_both_sides() {
    let mut triangles = rooms();
    triangles.extend(door());
    let (found, region, _) = around(&scene(triangles), [2.0, 0.5, 1.5]);
    assert_eq!(found, Enclosure::Closed);
    assert!(holds(&region, [1.0, 1.0, 1.5]) && holds(&region, [3.0, 1.0, 1.5]));
}

#[test]
fn limits_and_stops_end_search() {
    let scene = scene(rooms());
    let seed = [1.0, 1.0, 1.5];
    let search = |limits: EnclosureLimits, go_on: bool| {
        let mut tree = Tree::new(&scene, &[seed]);
        let found = enclose(&mut tree, &[seed], limits, &mut |_| go_on);
        // The region contains all space that may be reached, no matter when the search ends.
        let region = region_of(&tree, &reached(&tree, &[seed])).unwrap();
        assert!(
            RegionPlanes::new(&region, &scene)
                .unwrap()
                .holds(Vec3::new(3.0, 1.0, 1.5))
        );
        found
    };
    assert_eq!(
        search(
            EnclosureLimits {
                leaves: 4,
                ..EnclosureLimits::default()
            },
            true
        ),
        Enclosure::Unknown
    );
    assert_eq!(
        search(
            EnclosureLimits {
                work: 30,
                ..EnclosureLimits::default()
            },
            true
        ),
        Enclosure::Unknown
    );
    assert_eq!(
        search(EnclosureLimits::default(), false),
        Enclosure::Stopped
    );
}

#[test]
fn region_planes_reject_other_scene() {
    let whole = scene(rooms());
    let seed = [1.0, 1.0, 1.5];
    let mut tree = Tree::new(&whole, &[seed]);
    enclose(&mut tree, &[seed], EnclosureLimits::default(), &mut |_| {
        true
    });
    let region = region_of(&tree, &reached(&tree, &[seed])).unwrap();
    let other = scene(rooms()[..2].to_vec());
    assert!(
        RegionPlanes::new(&region, &other)
            .unwrap_err()
            .to_string()
            .contains("no plane in this scene")
    );
}

/// Returns true if exact signs prove that a segment has no point in common with a triangle.
///
/// The result is false for a segment that touches the triangle.
fn misses(t: &Triangle, p: Vec3, q: Vec3) -> bool {
    let [a, b, c] = t.v;
    let (from, to) = (orient3d_sign(a, b, c, p), orient3d_sign(a, b, c, q));
    if from == to && from != Ordering::Equal {
        return true;
    }
    let edges = [
        orient3d_sign(p, q, a, b),
        orient3d_sign(p, q, b, c),
        orient3d_sign(p, q, c, a),
    ];
    edges.contains(&Ordering::Less) && edges.contains(&Ordering::Greater)
}

/// Returns true if a segment passes through the interior of a triangle.
fn passes(t: &Triangle, p: Vec3, q: Vec3) -> bool {
    let [a, b, c] = t.v;
    let (from, to) = (orient3d_sign(a, b, c, p), orient3d_sign(a, b, c, q));
    let edges = [
        orient3d_sign(p, q, a, b),
        orient3d_sign(p, q, b, c),
        orient3d_sign(p, q, c, a),
    ];
    from == to.reverse()
        && from != Ordering::Equal
        && edges[0] != Ordering::Equal
        && edges == [edges[0]; 3]
}

/// Creates the triangles of a building: rooms, holes and loose triangles on a grid, turned about an axis.
fn building(
    boxes: &[([i8; 3], [i8; 3])],
    loose: &[[[i8; 3]; 3]],
    holes: &[usize],
    turn: Option<f32>,
) -> Vec<Triangle> {
    let mut all = Vec::new();
    for (min, size) in boxes {
        let (min, size) = (min.map(f32::from), size.map(f32::from));
        all.extend(walls(min, [0, 1, 2].map(|a| min[a] + size[a])));
    }
    let points = loose
        .iter()
        .map(|t| t.map(|p| Vec3::from(p.map(f32::from))));
    all.extend(
        points
            .map(|v| Triangle { v })
            .filter(|t| !t.is_degenerate()),
    );
    for hole in holes {
        if all.len() > 1 {
            all.remove(hole % all.len());
        }
    }
    if let Some(angle) = turn {
        let turn = Quat::from_axis_angle(Vec3::new(1.0, 2.0, 3.0).normalize(), angle);
        all.iter_mut().for_each(|t| t.v = t.v.map(|v| turn * v));
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    /// Walks from the seed along free segments stay in the region. The answers about boxes, faces and
    /// triangles agree with the answers about points.
    #[test]
    fn walks_stay_in_region(
        boxes in prop::collection::vec((prop::array::uniform3(-3i8..2), prop::array::uniform3(1i8..5)), 1..5),
        loose in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-4i8..5)), 0..6),
        holes in prop::collection::vec(any::<usize>(), 0..3),
        turn in prop::option::of(0.0f32..3.0),
        seed in prop::array::uniform3(-1.9f32..1.9),
        ends in prop::collection::vec(prop::array::uniform3(-6.0f32..6.0), 300),
        spots in prop::collection::vec((prop::array::uniform3(-5.0f32..5.0), 0.1f32..4.0), 10),
    ) {
        let triangles = building(&boxes, &loose, &holes, turn);
        let scene = scene(triangles);
        let (found, region, _) = around(&scene, seed);
        prop_assert!(matches!(found, Enclosure::Closed | Enclosure::Leak(..)));
        prop_assert!(holds(&region, seed));
        let mut known: Vec<Vec3> = vec![seed.into()];
        for (k, end) in ends.iter().enumerate() {
            let (from, to) = (known[k % known.len()], Vec3::from(*end));
            if scene.triangles().iter().all(|t| misses(t, from, to)) {
                prop_assert!(region.holds(to), "{to} is reached from {from}");
                known.push(to);
            }
            // A triangle that is visible from this point shares an area with the region.
            let met: Vec<&Triangle> = scene.triangles().iter().filter(|t| !misses(t, from, to)).collect();
            if let [t] = met[..]
                && passes(t, from, to)
            {
                let everything = Aabb::new(Vec3::splat(-50.0), Vec3::splat(50.0));
                prop_assert!(region.touches(t.v, everything), "{t:?} is seen from {from} towards {to}");
            }
        }
        for (at, size) in spots {
            let min = Vec3::from(at);
            let bounds = Aabb::new(min, min + Vec3::splat(size));
            let inside: Vec<&Vec3> = known.iter().filter(|p| bounds.contains(**p)).collect();
            prop_assert!(inside.is_empty() || region.meets(bounds), "the region meets {bounds:?}");
            if let Some(point) = region.any_in(bounds) {
                prop_assert!(region.meets(bounds) && region.holds(point) && bounds.contains(point));
            }
            for face in sightline_exact::Polygon::faces_of(bounds) {
                let parts = region.parts(&face);
                prop_assert!(parts.is_empty() || region.meets(bounds));
                for part in parts {
                    let middle = part.rounded().iter().sum::<glam::DVec3>() / part.points().len() as f64;
                    // In a turned building, rounding may move the point over a wall.
                    if turn.is_none() {
                        prop_assert!(region.holds(middle.as_vec3()));
                    }
                }
            }
        }
    }

    /// A turned building, and a building whose triangles have another order, enclose the same space.
    #[test]
    fn enclosure_is_independent_of_rotation_and_order(
        boxes in prop::collection::vec((prop::array::uniform3(-3i8..1), prop::array::uniform3(2i8..5)), 1..4),
        angle in 0.0f32..3.0,
        seed in prop::array::uniform3(-0.9f32..0.9),
        spots in prop::collection::vec(prop::array::uniform3(-5.0f32..5.0), 40),
    ) {
        // A seed on a wall belongs to both sides of the wall, and after rounding to only one side.
        prop_assume!(seed.iter().all(|s| (s - s.round()).abs() > 1e-3));
        let straight = building(&boxes, &[], &[], None);
        let mut other = straight.clone();
        other.reverse();
        let turned = building(&boxes, &[], &[], Some(angle));
        let turn = Quat::from_axis_angle(Vec3::new(1.0, 2.0, 3.0).normalize(), angle);
        let (first, region, _) = around(&scene(straight), seed);
        let (second, again, _) = around(&scene(other), seed);
        prop_assert_eq!(first == Enclosure::Closed, second == Enclosure::Closed);
        // A turned box is closed in exact arithmetic, because its faces share their corners. With several
        // boxes, the planes determine which other boxes are separated from the first.
        if let [only] = &boxes[..] {
            for spot in spots.iter().filter(|_| first == Enclosure::Closed) {
                prop_assert_eq!(holds(&region, *spot), holds(&again, *spot));
            }
            let seed = turn * Vec3::from(seed);
            let (third, rounded, _) = around(&scene(turned), seed.to_array());
            prop_assert_eq!(first == Enclosure::Closed, third == Enclosure::Closed);
            let (min, max) = (only.0.map(f32::from), [0, 1, 2].map(|a| f32::from(only.0[a] + only.1[a])));
            let far = |p: &&[f32; 3]| {
                (0..3).all(|a| (p[a] - min[a]).abs() > 1e-3 && (p[a] - max[a]).abs() > 1e-3)
            };
            // If a way leads out, the inside of the box may be left undivided.
            for spot in spots.iter().filter(far).filter(|_| first == Enclosure::Closed) {
                prop_assert_eq!(holds(&region, *spot), rounded.holds(turn * Vec3::from(*spot)));
            }
        }
    }
}
