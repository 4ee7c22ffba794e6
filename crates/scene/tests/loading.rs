//! Files that the loaders accept: all features of the formats that determine triangles, in hand-written
//! files.
#![allow(clippy::unwrap_used)]

mod support;

use std::path::Path;

use proptest::prelude::*;
use serde_json::json;
use sightline_scene::{Object, Scene, Triangle, load, load_bytes, write_mesh_ply};
use support::*;

fn object(name: &str, first: u32, count: u32) -> Object {
    Object {
        name: name.into(),
        first,
        count,
    }
}

#[test]
fn obj_keeps_order_groups_and_fans() {
    let s = load_bytes("a.obj", OBJ.as_bytes(), None).unwrap();
    let p = [
        SQUARE[0],
        SQUARE[1],
        SQUARE[2],
        SQUARE[3],
        [5., 0.5, -0.125],
    ];
    assert_eq!(
        soup(&s),
        by_index(&p, &[[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 1, 4]])
    );
    assert_eq!(
        s.objects(),
        [object("house/wall", 0, 1), object("house/roof", 1, 3)]
    );
}

#[test]
fn repeated_obj_groups_are_separate_objects() {
    let text = "v 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\nf 1 2 3\r\ng a\r\nf 1 2 3\r\ng empty\r\ng a\r\nf 3 2 1\r\n";
    let s = load_bytes("a.obj", text.as_bytes(), None).unwrap();
    assert_eq!(
        s.objects(),
        [
            object("default", 0, 1),
            object("a", 1, 1),
            object("a#2", 2, 1)
        ]
    );
    let old = text.replace("\r\n", "\r");
    assert_eq!(
        soup(&load_bytes("a.obj", old.as_bytes(), None).unwrap()),
        soup(&s)
    );
}

#[test]
fn ply_text_and_both_byte_orders() {
    let s = load_bytes("a.ply", PLY.as_bytes(), None).unwrap();
    assert_eq!(
        soup(&s),
        by_index(&SQUARE, &[[0, 1, 2], [0, 2, 3], [2, 1, 0]])
    );
    assert_eq!(s.objects(), [object("mesh", 0, 3)]);
    for big in [false, true] {
        let s = load_bytes("a.ply", &binary_ply(big, &SQUARE, 3), None).unwrap();
        assert_eq!(soup(&s), by_index(&SQUARE, &[[0, 1, 2], [0, 2, 3]]));
    }
}

#[test]
fn indices_of_every_width_and_none() {
    let want = by_index(&SQUARE, &[[0, 1, 2], [0, 2, 3]]);
    for component in [5121, 5123, 5125] {
        let mut g = Gltf::default();
        let (p, i) = (
            g.positions(&SQUARE),
            g.indices(component, &[0, 1, 2, 0, 2, 3]),
        );
        g.mesh(json!([{"attributes": {"POSITION": p}, "indices": i}]));
        assert_eq!(soup(&g.load().unwrap()), want);
    }
    let mut g = Gltf::default();
    let p = g.positions(&want.concat());
    g.mesh(json!([{"attributes": {"POSITION": p}}]));
    assert_eq!(soup(&g.load().unwrap()), want);
}

#[test]
fn strips_and_fans_wind_as_specified() {
    let p: Vec<[f32; 3]> = (0..5).map(|i| [i as f32, (i * i) as f32, 1.]).collect();
    let mut g = Gltf::default();
    let a = g.positions(&p);
    let prim = |mode: u32| json!({"attributes": {"POSITION": a}, "mode": mode});
    g.mesh(json!([prim(5), prim(6)]));
    let want = by_index(
        &p,
        &[
            [0, 1, 2],
            [1, 3, 2],
            [2, 3, 4],
            [1, 2, 0],
            [2, 3, 0],
            [3, 4, 0],
        ],
    );
    assert_eq!(soup(&g.load().unwrap()), want);
}

/// The strip is long enough to be read in several parts.
#[test]
fn long_strip_winds_like_short_strip() {
    let n = 20_000usize;
    let p: Vec<[f32; 3]> = (0..n + 2)
        .map(|i| [i as f32, (i % 2) as f32, (i % 7) as f32])
        .collect();
    let mut g = Gltf::default();
    let a = g.positions(&p);
    g.mesh(json!([{"attributes": {"POSITION": a}, "mode": 5}]));
    let turned = |i: usize| {
        if i.is_multiple_of(2) {
            [i, i + 1, i + 2]
        } else {
            [i, i + 2, i + 1]
        }
    };
    let want = by_index(&p, &(0..n).map(turned).collect::<Vec<_>>());
    assert_eq!(soup(&g.load().unwrap()), want);
}

#[test]
fn points_and_lines_are_objects_without_triangles() {
    let mut g = square();
    g.json["meshes"][0]["primitives"] = json!([
        {"attributes": {"POSITION": 0}, "mode": 0},
        {"attributes": {"POSITION": 0}, "indices": 1},
        {"attributes": {}}
    ]);
    g.json["nodes"][0]["name"] = json!("n");
    let s = g.load().unwrap();
    assert_eq!(
        s.objects(),
        [
            object("n/mesh0#0", 0, 0),
            object("n/mesh0#1", 0, 2),
            object("n/mesh0#2", 2, 0)
        ]
    );
}

#[test]
fn sparse_replaces_elements_with_and_without_base() {
    let mut g = square();
    let i = g.view(&[1, 3]);
    let v = g.view(bytemuck::cast_slice(&[7f32, 8., 9., -1., -2., -3.]));
    g.json["accessors"][0]["sparse"] = json!({
        "count": 2, "indices": {"bufferView": i, "componentType": 5121}, "values": {"bufferView": v}
    });
    let tris = [[0, 1, 2], [0, 2, 3]];
    let p = [SQUARE[0], [7., 8., 9.], SQUARE[2], [-1., -2., -3.]];
    assert_eq!(soup(&g.load().unwrap()), by_index(&p, &tris));
    g.json["accessors"][0]
        .as_object_mut()
        .unwrap()
        .remove("bufferView");
    let p = [[0.; 3], [7., 8., 9.], [0.; 3], [-1., -2., -3.]];
    assert_eq!(soup(&g.load().unwrap()), by_index(&p, &tris));
}

#[test]
fn strided_views_with_offsets() {
    let mut g = square();
    let mut bytes = vec![0xffu8; 8];
    for p in SQUARE {
        bytes.extend(bytemuck::cast_slice(&p));
        bytes.extend([0xee; 8]);
    }
    bytes.truncate(bytes.len() - 8);
    let v = g.view(&bytes);
    g.json["bufferViews"][v]["byteStride"] = json!(20);
    g.json["accessors"][0]["bufferView"] = json!(v);
    g.json["accessors"][0]["byteOffset"] = json!(8);
    assert_eq!(soup(&g.load().unwrap()), soup(&square().load().unwrap()));
}

/// The component type, true if normalised, the raw bytes of three coordinates, and the expected values.
type Case = (u32, bool, Vec<Vec<u8>>, [f32; 3]);

#[test]
fn quantized_positions_of_each_kind() {
    let cases: [Case; 6] = [
        (
            5120,
            false,
            vec![vec![0x80], vec![3], vec![127]],
            [-128., 3., 127.],
        ),
        (
            5121,
            false,
            vec![vec![0], vec![3], vec![255]],
            [0., 3., 255.],
        ),
        (
            5122,
            false,
            vec![vec![0, 0x80], vec![3, 0], vec![0xff, 0x7f]],
            [-32768., 3., 32767.],
        ),
        (
            5123,
            false,
            vec![vec![0, 0], vec![3, 1], vec![0xff, 0xff]],
            [0., 259., 65535.],
        ),
        (
            5120,
            true,
            vec![vec![0x80], vec![0], vec![127]],
            [-1., 0., 1.],
        ),
        (
            5123,
            true,
            vec![vec![0, 0], vec![0x33, 0x33], vec![0xff, 0xff]],
            [0., 0.2, 1.],
        ),
    ];
    for (component, normalized, raw, [a, b, c]) in cases {
        let mut g = Gltf::default();
        // Vertices (a,b,c), (b,c,a), (c,a,b) at a stride of 8 bytes.
        let mut bytes = Vec::new();
        for turn in 0..3 {
            let start = bytes.len();
            for i in 0..3 {
                bytes.extend(&raw[(turn + i) % 3]);
            }
            bytes.resize(start + 8, 0);
        }
        let p = g.accessor(&bytes, component, "VEC3", 3);
        g.json["accessors"][p]["normalized"] = json!(normalized);
        g.json["bufferViews"][0]["byteStride"] = json!(8);
        g.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
        g.mesh(json!([{"attributes": {"POSITION": p}}]));
        assert_eq!(
            soup(&g.load().unwrap()),
            [[[a, b, c], [b, c, a], [c, a, b]]],
            "{component} {normalized}"
        );
    }
}

#[test]
fn meshopt_views_decode_to_original_data() {
    let got = soup(&packed_square().load().unwrap());
    // The encoder may rotate a triangle. The square's two triangles keep their corners.
    for (got, mut want) in got.into_iter().zip(soup(&square().load().unwrap())) {
        assert!((0..3).any(|_| {
            want.rotate_left(1);
            got == want
        }));
    }
}

#[test]
fn transforms_nest_in_depth_first_order() {
    let s = rich().load().unwrap();
    let names: Vec<_> = s
        .objects()
        .iter()
        .map(|o| (o.name.as_str(), o.count))
        .collect();
    assert_eq!(
        names,
        [
            ("root/mesh0#0", 2),
            ("node1/mesh1#0", 2),
            ("node1/mesh1#1", 2),
            ("node1/mesh1#2", 0),
            ("node2/mesh0#0", 2)
        ]
    );
    let p = [[0., 0., 0.], [5., 0., 0.], [1., 1., 0.], [0., 5., 0.]];
    let moved = |t: [f32; 3]| p.map(|q: [f32; 3]| [q[0] + t[0], q[1] + t[1], q[2] + t[2]]);
    let got = soup(&s);
    assert_eq!(
        got[..2],
        by_index(&moved([1., 2., 3.]), &[[0, 1, 2], [0, 2, 3]])
    );
    assert_eq!(
        got[6..],
        by_index(&moved([1., 2., 12.]), &[[0, 1, 2], [0, 2, 3]])
    );
    // A quarter turn about z and a scale of two map (5,0,0) to (0,10,0), then (1,2,3) is added.
    let turned = got[2][0];
    for (g, w) in turned.iter().zip([1., 12., 3.]) {
        assert!((g - w).abs() < 1e-5, "{turned:?}");
    }
}

#[test]
fn scene_is_default_or_first_or_all_roots() {
    let mut g = square();
    g.json["nodes"] =
        json!([{"mesh": 0, "name": "a"}, {"children": [2], "name": "b"}, {"mesh": 0, "name": "c"}]);
    g.json["scenes"] = json!([{"nodes": [0]}, {"nodes": [1, 0]}]);
    let names = |g: &Gltf| -> Vec<String> {
        g.load()
            .unwrap()
            .objects()
            .iter()
            .map(|o| o.name.split('/').next().unwrap().to_owned())
            .collect()
    };
    g.json["scene"] = json!(1);
    assert_eq!(names(&g), ["c", "a"]);
    g.json.as_object_mut().unwrap().remove("scene");
    assert_eq!(names(&g), ["a"]);
    g.json.as_object_mut().unwrap().remove("scenes");
    assert_eq!(names(&g), ["a", "c"]);
}

#[test]
fn buffers_from_data_uris_and_files() {
    use base64::Engine;
    let encode = |b: &[u8]| base64::engine::general_purpose::STANDARD.encode(b);
    let mut g = square();
    let views = g.json["bufferViews"].as_array().unwrap().len();
    let (first, second) = g.bin.split_at(48);
    g.json["buffers"] = json!([
        {"byteLength": 48, "uri": "my%20points.bin"},
        {
            "byteLength": second.len(),
            "uri": format!("data:application/octet-stream;base64,{}", encode(second)),
        }
    ]);
    assert_eq!(views, 2);
    g.json["bufferViews"][1]["buffer"] = json!(1);
    g.json["bufferViews"][1]["byteOffset"] = json!(0);
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("my points.bin"), first).unwrap();
    let file = dir.path().join("scene.gltf");
    std::fs::write(&file, g.json.to_string()).unwrap();
    assert_eq!(soup(&load(&file).unwrap()), soup(&square().load().unwrap()));
}

#[test]
fn harmless_required_extensions_are_accepted() {
    let mut g = square();
    g.json["extensionsRequired"] = json!([
        "KHR_materials_unlit",
        "KHR_texture_transform",
        "KHR_lights_punctual"
    ]);
    assert_eq!(g.load().unwrap().len(), 2);
}

#[test]
fn deep_nesting_needs_no_stack() {
    let mut g = square();
    let depth = 200_000;
    let mut nodes: Vec<_> = (1..depth).map(|i| json!({"children": [i]})).collect();
    nodes.push(json!({"mesh": 0}));
    g.json["nodes"] = json!(nodes);
    assert_eq!(g.load().unwrap().len(), 2);
}

#[test]
fn shared_scenes_have_listed_triangle_counts() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes");
    if !dir.is_dir() {
        println!("shared scenes are absent; not run");
        return;
    }
    for (name, count) in [
        ("quake_e1m3.glb", 12_231),
        ("city_ingolstadt_lod3.glb", 147_829),
        ("stk_candela_city.glb", 428_832),
        ("nexuiz_ons-reborn.glb", 124_112),
    ] {
        assert_eq!(load(&dir.join(name)).unwrap().len(), count, "{name}");
    }
}

proptest! {
    /// All coordinates that loaders accept, ids and corners survive encoding bit for bit.
    #[test]
    fn written_meshes_survive_bit_for_bit(
        raw in proptest::collection::vec(proptest::array::uniform9(any::<f32>()), 1..50)
    ) {
        let near = |c: f32| if c.abs() <= sightline_scene::MAX_COORDINATE { c } else { -0.0 };
        let triangles: Vec<Triangle> = raw.iter()
            .map(|r| {
                let at = |i: usize| glam::Vec3::new(near(r[i]), near(r[i + 1]), near(r[i + 2]));
                Triangle { v: [0, 3, 6].map(at) }
            })
            .collect();
        let all = object("all", 0, triangles.len() as u32);
        let scene = Scene::new("test", triangles, vec![all]).unwrap();
        let mut out = Vec::new();
        write_mesh_ply(&scene, &mut out).unwrap();
        let again = load_bytes("again.ply", &out, None).unwrap();
        let bits = |s: &Scene| bytemuck::cast_slice::<_, u32>(s.triangles()).to_vec();
        prop_assert_eq!(bits(&again), bits(&scene));
    }
}
