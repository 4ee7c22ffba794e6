//! Instances of EXT_mesh_gpu_instancing.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use serde_json::{Value, json};
use support::Gltf;

/// Creates a node with a translation, a square of two triangles, and instance attributes.
fn instanced(change: impl FnOnce(&mut Gltf) -> Value) -> Gltf {
    let mut g = Gltf::default();
    let p = g.positions(&[
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ]);
    let i = g.indices(5123, &[0, 1, 2, 0, 2, 3]);
    let primitive = json!({"attributes": {"POSITION": p}, "indices": i});
    g.mesh(json!([primitive, primitive]));
    let attributes = change(&mut g);
    g.json["nodes"] = json!([
        {"name": "tree", "mesh": 0, "translation": [10, 0, 0],
         "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}},
        {"name": "rock", "mesh": 0},
    ]);
    g.json["scenes"][0]["nodes"] = json!([0, 1]);
    g.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    g
}

fn shorts(g: &mut Gltf, quaternions: &[[i16; 4]]) -> usize {
    let bytes: Vec<u8> = quaternions
        .iter()
        .flatten()
        .flat_map(|c| c.to_le_bytes())
        .collect();
    let accessor = g.accessor(&bytes, 5122, "VEC4", quaternions.len());
    g.json["accessors"][accessor]["normalized"] = json!(true);
    accessor
}

#[test]
fn instances_have_triangles_under_transform_of_node() {
    let g = instanced(|g| {
        let translation = g.positions(&[[0.0, 5.0, 0.0], [0.0, 0.0, 7.0]]);
        let scale = g.positions(&[[1.0, 1.0, 1.0], [2.0, 3.0, 1.0]]);
        // The identity, and half a turn around z.
        let rotation = shorts(g, &[[0, 0, 0, 32767], [0, 0, 32767, 0]]);
        json!({"TRANSLATION": translation, "SCALE": scale, "ROTATION": rotation, "_OTHER": 99})
    });
    let scene = g.load().unwrap();
    let names: Vec<&str> = scene.objects().iter().map(|o| o.name.as_str()).collect();
    let expected = [
        "tree[0]/mesh0#0",
        "tree[0]/mesh0#1",
        "tree[1]/mesh0#0",
        "tree[1]/mesh0#1",
        "rock/mesh0#0",
        "rock/mesh0#1",
    ];
    assert_eq!(names, expected);
    assert_eq!(scene.len(), 12);
    let corner = |t: usize, k: usize| scene.triangles()[t].v[k].to_array();
    assert_eq!(
        [corner(0, 0), corner(0, 2)],
        [[10.0, 5.0, 0.0], [11.0, 6.0, 0.0]]
    );
    let turned = corner(4, 2);
    let near = [10.0 - 2.0, -3.0, 7.0]
        .iter()
        .zip(turned)
        .all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-5);
    assert!(near, "{turned:?}");
    assert_eq!(corner(8, 2), [1.0, 1.0, 0.0]);
}

#[test]
fn rejects_inconsistent_attributes_with_node() {
    let refused = |g: Gltf, part: &str| {
        let e = g.load().unwrap_err().to_string();
        assert!(e.contains("node 0") && e.contains(part), "{part} in {e}");
    };
    refused(instanced(|_| json!({})), "neither TRANSLATION");
    refused(instanced(|_| json!({"TRANSLATION": 99})), "accessor 99");
    let g = instanced(|g| {
        let (two, one) = (g.positions(&[[0.0; 3]; 2]), g.positions(&[[1.0; 3]]));
        json!({"TRANSLATION": two, "SCALE": one})
    });
    refused(g, "same number");
    let g = instanced(|g| json!({"ROTATION": shorts(g, &[[0; 4]])}));
    refused(g, "instance 0");
    let g = instanced(|g| json!({"TRANSLATION": shorts(g, &[[0; 4]])}));
    refused(g, "must be VEC3");
    let g = instanced(|g| json!({"SCALE": g.positions(&[[f32::NAN; 3]])}));
    refused(g, "instance 0");
}

#[test]
fn zero_instances_result_in_no_object() {
    let g = instanced(|g| json!({"TRANSLATION": g.positions(&[])}));
    assert_eq!(g.load().unwrap().objects().len(), 2);
}
