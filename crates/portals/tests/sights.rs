//! Tests of the sets through portals: known rooms, and random buildings against free segments.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

mod common;

use common::{across, building, lists, scene, strictly_seen};
use glam::{Quat, Vec3};
use proptest::prelude::*;
use sightline_numbers::Aabb;
use sightline_numbers::random::SplitMix64;
use sightline_portals::{EnclosureLimits, Partition, sights};
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_scene::{Scene, Triangle};

fn seen(scene: &Scene, cell: Aabb) -> Vec<u32> {
    let partition = Partition::new(
        scene,
        None,
        scene.bounds(),
        EnclosureLimits::default(),
        &|| false,
    )
    .unwrap();
    sights(&partition, cell, false, &|| false).unwrap()
}

/// Creates a row of rooms at x = 0 to 5, z from 0 to 3.
///
/// The doors alternate between z from 0 to 1 and z from 2 to 3.
///
/// The floor, at y = 0, consists of squares with sides of 1/4. Its triangles come first, and the function
/// returns their number.
fn zigzag() -> (Scene, usize) {
    let mut all = Vec::new();
    for i in 0..20 {
        for k in 0..12 {
            let (x, z) = (i as f32 / 4.0, k as f32 / 4.0);
            all.extend(across(1, 0.0, [z, z + 0.25], [x, x + 0.25]));
        }
    }
    let floor = all.len();
    all.extend(across(1, 1.0, [0.0, 3.0], [0.0, 5.0]));
    for x in [0.0, 5.0] {
        all.extend(across(0, x, [0.0, 1.0], [0.0, 3.0]));
    }
    for z in [0.0, 3.0] {
        all.extend(across(2, z, [0.0, 5.0], [0.0, 1.0]));
    }
    for (x, door) in [(1.0, 0.0), (2.0, 2.0), (3.0, 0.0), (4.0, 2.0)] {
        for z in [0.0, 1.0, 2.0f32].into_iter().filter(|z| *z != door) {
            all.extend(across(0, x, [0.0, 1.0], [z, z + 1.0]));
        }
    }
    (scene(all), floor)
}

#[test]
fn alternating_doors_show_wedge_of_third_room_only() {
    let (scene, floor) = zigzag();
    // A cell that includes the face at x = 1 sees more, because a wall in the face does not block lines that
    // begin there.
    let first = Aabb::new(Vec3::ZERO, Vec3::new(0.999, 1.0, 3.0));
    let found = seen(&scene, first);
    let is_seen = |id: usize| found.binary_search(&(id as u32)).is_ok();
    let mut counts = [0; 2];
    for id in 0..floor {
        let v = scene.triangles()[id].v;
        let (least, most) = v
            .iter()
            .fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(v.x), b.max(v.x)));
        if most <= 1.0 {
            assert!(is_seen(id), "the room's own floor");
        }
        if least >= 3.0 {
            assert!(!is_seen(id), "{v:?} is in the fourth room or behind it");
        }
        if least >= 2.0 && most <= 3.0 {
            // The wedge is between z = x and z = 3x − 3. The signs of both at the corners tell whether a
            // triangle is in it.
            let below = v.iter().all(|v| v.z - v.x < 0.0);
            let above = v.iter().all(|v| v.z - 3.0 * v.x + 3.0 > 0.0);
            let inside = v
                .iter()
                .all(|v| v.z - v.x > 0.0 && v.z - 3.0 * v.x + 3.0 < 0.0);
            assert!(
                !(is_seen(id) && (below || above)),
                "{v:?} is beside the wedge"
            );
            assert!(is_seen(id) || !inside, "{v:?} is in the wedge");
            counts[usize::from(is_seen(id))] += 1;
        }
    }
    assert!(counts.iter().all(|n| *n > 10), "{counts:?}");
}

#[test]
fn portals_list_at_most_third_more_in_turned_building() {
    // In the straight building the walls are whole, and portals list no other triangles than exact queries.
    let straight = lists(2, 0.0);
    assert_eq!(straight.portals, straight.exact);
    // In the turned building the walls have cracks, and each wall triangle has a separate plane.
    let turned = lists(2, 0.5);
    assert!(turned.leaves > 4 * straight.leaves && turned.exact > straight.exact);
    assert!(
        3 * turned.portals <= 4 * turned.exact,
        "{} of {}",
        turned.portals,
        turned.exact
    );
}

#[test]
fn sets_are_independent_of_triangle_order() {
    let (scene, _) = zigzag();
    let mut random = SplitMix64::new(7);
    let mut order: Vec<usize> = (0..scene.triangles().len()).collect();
    for i in (1..order.len()).rev() {
        order.swap(i, (random.bits() % (i as u64 + 1)) as usize);
    }
    let other = common::scene(order.iter().map(|k| scene.triangles()[*k]).collect());
    for x in 0..5 {
        let cell = Aabb::new(
            Vec3::new(x as f32, 0.0, 0.0),
            Vec3::new(x as f32 + 0.7, 1.0, 2.0),
        );
        let mut found: Vec<u32> = seen(&other, cell)
            .iter()
            .map(|id| order[*id as usize] as u32)
            .collect();
        found.sort_unstable();
        assert_eq!(seen(&scene, cell), found);
    }
}

#[test]
fn turned_walls_hide_nearly_as_much_as_straight_walls() {
    let params = SceneParams {
        triangles: Some(2500),
        grid: Some([4, 3]),
        ..SceneParams::default()
    };
    let rooms = generate(SceneKind::Rooms, &params).unwrap();
    let drawn = |angle: f32| -> usize {
        let turn = Quat::from_rotation_y(angle);
        let turned = |p: Vec3| if angle == 0.0 { p } else { turn * p };
        let all = rooms
            .triangles()
            .iter()
            .map(|t| Triangle { v: t.v.map(turned) })
            .collect();
        let scene = common::scene(all);
        let partition = Partition::new(
            &scene,
            None,
            scene.bounds(),
            EnclosureLimits::default(),
            &|| false,
        )
        .unwrap();
        let Aabb { min, max } = rooms.bounds();
        // The test uses two places in each room, at half its height.
        let places = (0..24).map(|k| Vec3::new((k % 8) as f32 + 0.5, 1.0, (k / 8) as f32 + 0.4));
        let count_seen = |place: Vec3| {
            let middle = turned(min + (max - min) * place / Vec3::new(8.0, 2.0, 3.0));
            sights(
                &partition,
                Aabb::new(middle - 0.1, middle + 0.1),
                false,
                &|| false,
            )
            .unwrap()
            .len()
        };
        places.map(count_seen).sum()
    };
    let straight = drawn(0.0);
    // Otherwise no set could be larger by a quarter.
    assert!(
        straight * 2 < 24 * rooms.triangles().len(),
        "{straight} drawn of {}",
        rooms.triangles().len()
    );
    for angle in [0.5, std::f32::consts::FRAC_PI_2, 1.1] {
        let turned = drawn(angle);
        assert!(
            turned * 4 < straight * 5,
            "{straight} straight, {turned} turned by {angle}"
        );
    }
}

#[test]
fn stopped_search_returns_none() {
    let (scene, _) = zigzag();
    let partition = Partition::new(
        &scene,
        None,
        scene.bounds(),
        EnclosureLimits::default(),
        &|| false,
    )
    .unwrap();
    assert_eq!(sights(&partition, scene.bounds(), false, &|| true), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn sights_contain_triangles_shown_by_free_segments(
        seed in any::<u64>(),
        angle in prop_oneof![Just(0.0f32), -1.5f32..1.5, Just(std::f32::consts::FRAC_PI_2)],
    ) {
        let scene = building(seed, angle);
        let limits = EnclosureLimits::default();
        let partition = Partition::new(&scene, None, scene.bounds(), limits, &|| false).unwrap();
        let mut random = SplitMix64::new(seed ^ 1);
        let bounds = scene.bounds();
        let mut point = |bounds: Aabb| {
            let mut unit = || random.unit_f32();
            bounds.min + (bounds.max - bounds.min) * Vec3::new(unit(), unit(), unit())
        };
        // Large cells of turned buildings are lit through thousands of portals.
        let parts: &[f32] = if angle == 0.0 { &[0.3, 0.3, 0.3, 0.3] } else { &[0.2, 0.1] };
        for part in parts.iter().copied() {
            let (p, q) = (point(bounds), point(bounds));
            let cell = Aabb::new(p.min(p + (q - p) * part), p.max(p + (q - p) * part));
            let found = sights(&partition, cell, false, &|| false).unwrap();
            for _ in 0..400 {
                let (from, to) = (point(cell), point(bounds));
                // Shorter and shorter segments find the first triangle in a direction.
                for part in [1.0f32, 0.5, 0.25, 0.125] {
                    if let Some(id) = strictly_seen(&scene, from, from + (to - from) * part) {
                        prop_assert!(found.binary_search(&id).is_ok(), "{id} from {from} to {to}");
                    }
                }
            }
        }
    }
}

#[test]
fn door_is_opening_with_name() {
    use sightline_scene::kinds::{KindRule, Kinds, SurfaceKind};
    // The scene has two rooms with a wall between them at x = 1, in which a door fills z from 0 to 1.
    let mut walls: Vec<sightline_scene::Triangle> = Vec::new();
    for (axis, [u, v]) in [
        (1, [[0.0, 3.0], [0.0, 2.0]]),
        (2, [[0.0, 2.0], [0.0, 1.0]]),
        (0, [[0.0, 1.0], [0.0, 3.0]]),
    ] {
        for at in [0.0, [2.0, 1.0, 3.0][axis]] {
            walls.extend(across(axis, at, u, v));
        }
    }
    walls.extend(across(0, 1.0, [0.0, 1.0], [1.0, 3.0]));
    let first = walls.len() as u32;
    walls.extend(across(0, 1.0, [0.0, 1.0], [0.0, 1.0]));
    let object = |name: &str, first, count| sightline_scene::Object {
        name: name.to_owned(),
        first,
        count,
    };
    let objects = vec![object("walls", 0, first), object("front door", first, 2)];
    let rule = KindRule {
        kind: SurfaceKind::Door,
        glob: "front*".to_owned(),
    };
    let kinds = Kinds::from_runs(
        [
            (first, SurfaceKind::Opaque, "file"),
            (2, SurfaceKind::Door, "--doors"),
        ],
        vec![rule],
    );
    let scene = Scene::new("test", walls, objects)
        .unwrap()
        .with_kinds("test", kinds)
        .unwrap();
    let partition = Partition::new(
        &scene,
        None,
        scene.bounds(),
        EnclosureLimits::default(),
        &|| false,
    )
    .unwrap();
    let table = sightline_portals::table(&partition);
    assert_eq!(table.doors, ["front door"]);
    let shut: Vec<_> = table.portals.iter().filter(|p| p.door == 0).collect();
    assert!(
        !shut.is_empty()
            && shut
                .iter()
                .all(|p| p.corners.iter().all(|c| c[0] == 1.0 && c[2] <= 1.0))
    );
    // The door does not block: the far wall is visible through it, and no set contains the door itself.
    let cell = Aabb::new(Vec3::new(0.2, 0.2, 0.2), Vec3::new(0.8, 0.8, 0.8));
    let found = sights(&partition, cell, false, &|| false).unwrap();
    let far = (0..first).filter(|id| scene.triangles()[*id as usize].v.iter().all(|v| v.x == 2.0));
    assert!(far.clone().count() == 2 && far.clone().any(|id| found.binary_search(&id).is_ok()));
    assert!(found.iter().all(|id| *id < first));
}
