//! The sides of triangles that loaders find when back faces are culled.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use glam::DVec3;
use serde_json::{Value, json};
use sightline_scene::load::{LoadOptions, load_bytes_with};
use sightline_scene::{Scene, Side, SurfaceKind, TriangleId};
use support::Gltf;

fn culling() -> LoadOptions {
    LoadOptions {
        cull_back_faces: true,
        ..LoadOptions::default()
    }
}

fn load(name: &str, bytes: &[u8], options: &LoadOptions) -> Scene {
    load_bytes_with(name, bytes, None, options).unwrap().scene
}

/// Creates a file with `nodes` nodes, each with a mesh of one triangle in the plane z = 0 that winds
/// counter-clockwise as seen from +z.
fn triangles(nodes: usize, change: impl FnOnce(&mut Gltf)) -> Vec<u8> {
    let mut g = Gltf::default();
    let p = g.positions(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    for _ in 0..nodes {
        g.mesh(json!([{"attributes": {"POSITION": p}}]));
    }
    g.json["nodes"] = (0..nodes).map(|n| json!({"mesh": n})).collect();
    g.json["scenes"][0]["nodes"] = (0..nodes).collect();
    change(&mut g);
    g.glb()
}

fn sides(scene: &Scene) -> Vec<Side> {
    (0..scene.len())
        .map(|t| scene.sides().side(TriangleId(t)))
        .collect()
}

#[test]
fn double_sided_material_keeps_both_sides() {
    let file = triangles(4, |g| {
        g.json["materials"] =
            json!([{"doubleSided": true}, {"doubleSided": false}, {"doubleSided": "yes"}]);
        (0..3).for_each(|m| g.json["meshes"][m]["primitives"][0]["material"] = json!(m));
    });
    let scene = load("test.glb", &file, &culling());
    assert_eq!(
        sides(&scene),
        [
            Side::Both,
            Side::CounterClockwise,
            Side::CounterClockwise,
            Side::CounterClockwise
        ]
    );
    assert_eq!(scene.sides().one_sided(), 3);
    assert_eq!(scene.front(TriangleId(0)), DVec3::ZERO);
    assert!(scene.front(TriangleId(1)).z > 0.0);
    // Without the flag all triangles have both sides, which add no bytes. A glTF file adds only its sources.
    let plain = load("test.glb", &file, &LoadOptions::default());
    assert!(plain.sides().are_both());
    let without_sources = plain.clone().with_sources("test.glb", Vec::new()).unwrap();
    assert!(without_sources.to_blob().starts_with(b"SLSCENE1"));
    assert_eq!(without_sources.digest(), plain.digest_without_sources());
}

#[test]
fn mirrored_node_reverses_front_and_keeps_vertex_order() {
    let file = triangles(5, |g| {
        g.json["nodes"][0]["scale"] = json!([-1, 1, 1]);
        // The transform mirrors twice, once by the parent.
        g.json["nodes"][1] = json!({"mesh": 1, "scale": [1, -1, 1], "children": [2]});
        g.json["nodes"][2]["scale"] = json!([-1, 1, 1]);
        g.json["nodes"][3]["rotation"] = json!([0, 1, 0, 0]);
        g.json["nodes"][4]["matrix"] = json!([0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
        g.json["scenes"][0]["nodes"] = json!([0, 1, 3, 4]);
    });
    let scene = load("test.glb", &file, &culling());
    use Side::{Clockwise, CounterClockwise};
    assert_eq!(
        sides(&scene),
        [
            Clockwise,
            Clockwise,
            CounterClockwise,
            CounterClockwise,
            Clockwise
        ]
    );
    // A mirrored triangle still faces +z, and a triangle after half a turn faces −z.
    let towards: Vec<f64> = (0..5)
        .map(|t| scene.front(TriangleId(t)).z.signum())
        .collect();
    assert_eq!(towards, [1.0, 1.0, 1.0, -1.0, 1.0]);
    assert_eq!(
        scene.triangles(),
        load("test.glb", &file, &LoadOptions::default()).triangles()
    );
}

#[test]
fn instances_have_side_of_own_transform() {
    let file = triangles(1, |g| {
        let scale = g.positions(&[[1.0, 1.0, 1.0], [1.0, 1.0, -1.0]]);
        g.json["nodes"][0]["extensions"] =
            json!({"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": scale}}});
    });
    let scene = load("test.glb", &file, &culling());
    assert_eq!(sides(&scene), [Side::CounterClockwise, Side::Clockwise]);
}

#[test]
fn strips_and_fans_have_one_front() {
    for mode in [5, 6] {
        let mut g = Gltf::default();
        let corners = match mode {
            5 => [
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [1.0, 1.0, 0.0],
            ],
            _ => [
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0],
                [0.0, 1.0, 0.0],
            ],
        };
        let p = g.positions(&corners);
        g.mesh(json!([{"attributes": {"POSITION": p}, "mode": mode}]));
        g.json["nodes"] = json!([{"mesh": 0}]);
        g.json["scenes"][0]["nodes"] = json!([0]);
        let scene = load("test.glb", &g.glb(), &culling());
        assert!(
            (0..2).all(|t| scene.front(TriangleId(t)).z > 0.0),
            "mode {mode}"
        );
    }
}

#[test]
fn triangles_of_obj_and_ply_files_have_one_side() {
    let obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 3 2 4\n";
    let scene = load("test.obj", obj, &culling());
    assert_eq!(sides(&scene), [Side::CounterClockwise; 2]);
    let mut ply = Vec::new();
    sightline_scene::write_mesh_ply(&scene, &mut ply).unwrap();
    assert_eq!(
        sides(&load("test.ply", &ply, &culling())),
        [Side::CounterClockwise; 2]
    );
}

#[test]
fn sides_and_kinds_are_part_of_canonical_bytes() {
    let file = |material: Value| {
        triangles(2, |g| {
            g.json["materials"] = json!([material]);
            g.json["meshes"][1]["primitives"][0]["material"] = json!(0);
        })
    };
    let scene_with = |material| load("test.glb", &file(material), &culling());
    let (opaque, glass) = (
        scene_with(json!({})),
        scene_with(json!({"alphaMode": "BLEND"})),
    );
    let (double, glass_double) = (
        scene_with(json!({"doubleSided": true})),
        scene_with(json!({"alphaMode": "BLEND", "doubleSided": true})),
    );
    let plain = load("test.glb", &file(json!({})), &LoadOptions::default());
    let mut digests = Vec::new();
    for scene in [&opaque, &glass, &double, &glass_double, &plain] {
        let again = Scene::from_blob("blob", &scene.to_blob()).unwrap();
        assert_eq!(
            (again.sides(), again.kinds()),
            (scene.sides(), scene.kinds())
        );
        assert_eq!(again.to_blob(), scene.to_blob());
        digests.push(scene.digest());
    }
    assert_eq!(glass.kinds().kind(TriangleId(1)), SurfaceKind::SeeThrough);
    digests.sort();
    digests.dedup();
    assert_eq!(digests.len(), 5);
    // Bytes after the last section, and truncated bytes, are rejected.
    let mut long = glass.to_blob();
    long.push(0);
    assert!(Scene::from_blob("blob", &long).is_err());
    for scene in [&opaque, &glass] {
        let blob = scene.to_blob();
        let cuts = (0..blob.len())
            .filter(|n| Scene::from_blob("blob", &blob[..*n]).is_ok())
            .count();
        assert_eq!(cuts, 0);
    }
}
