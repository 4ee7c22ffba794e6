//! The parts of the user's file that stay unchanged, and the values that differ between nodes.

#![allow(clippy::unwrap_used, reason = "tests")]

mod support;

use serde_json::{Value as Json, json};
use sightline_texels::{Plan, ReceiverValue, Settings, TexCoordSource, TextureSize, ValueTarget};
use support::{Maker, Read, add_cube, cube_primitive, scene, written};

const TEXTURE: Settings = Settings {
    target: ValueTarget::Texture,
    size: TextureSize::Resolution(64),
    coordinates: TexCoordSource::Any,
    bits: sightline_texels::BitDepth::Eight,
};
const VERTICES: Settings = Settings {
    target: ValueTarget::Vertices,
    ..TEXTURE
};

/// Creates a file with two nodes that share one mesh, and with many optional elements.
fn rich() -> Maker {
    let mut maker = Maker::new();
    let paint = maker.push(
        "materials",
        json!({ "name": "paint", "doubleSided": true, "extras": { "a": [1, 2.5, "x"] },
                "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.25, 1.0, 1.0] } }),
    );
    let mut primitive = cube_primitive(&mut maker);
    primitive["material"] = json!(paint);
    primitive["extras"] = json!({ "of": "primitive" });
    let lines = json!({ "attributes": primitive["attributes"], "mode": 1, "material": paint });
    let mesh = maker.push(
        "meshes",
        json!({ "name": "box", "primitives": [primitive, lines], "extras": 7 }),
    );
    let first = maker.node(json!({ "name": "left", "mesh": mesh, "extras": { "tag": "a" } }));
    let hidden = json!({ "KHR_node_visibility": { "visible": false } });
    maker.node(
        json!({ "name": "right", "mesh": mesh, "translation": [3, 0, 0], "extensions": hidden }),
    );
    let times = maker.floats("SCALAR", &[0.0, 1.0]);
    let moves = maker.floats("VEC3", &[0., 0., 0., 0., 1., 0.]);
    maker.push(
        "animations",
        json!({ "name": "up", "samplers": [{ "input": times, "output": moves }],
                "channels": [{ "sampler": 0, "target": { "node": first, "path": "translation" } }] }),
    );
    maker.push(
        "cameras",
        json!({ "type": "perspective", "perspective": { "yfov": 1.0, "znear": 0.1 } }),
    );
    maker.json["extensionsUsed"] = json!(["EXAMPLE_thing", "KHR_node_visibility"]);
    maker.json["extensions"] = json!({ "EXAMPLE_thing": { "deep": [{ "er": null }] } });
    maker.json["extras"] = json!("of the file");
    maker
}

#[test]
fn other_elements_stay_unchanged() {
    let maker = rich();
    for settings in [TEXTURE, VERTICES] {
        let made = written(&maker.glb(), &settings, |p, _| p.x / 4.0);
        let json = Read::new(&made.glb).json;
        for key in [
            "animations",
            "cameras",
            "extensionsUsed",
            "extensions",
            "extras",
            "asset",
            "scene",
            "scenes",
        ] {
            assert_eq!(json[key], maker.json[key], "{key}");
        }
        for (n, node) in maker.json["nodes"].as_array().unwrap().iter().enumerate() {
            let mut expected = node.clone();
            expected["mesh"] = json!(n);
            assert_eq!(json["nodes"][n], expected);
        }
        // The mesh was copied; both copies keep their original members.
        assert_eq!(json["meshes"].as_array().unwrap().len(), 2);
        for mesh in json["meshes"].as_array().unwrap() {
            assert_eq!((&mesh["name"], &mesh["extras"]), (&json!("box"), &json!(7)));
            assert_eq!(
                mesh["primitives"][0]["extras"],
                json!({ "of": "primitive" })
            );
            assert_eq!(
                mesh["primitives"][1],
                maker.json["meshes"][0]["primitives"][1]
            );
        }
        assert_eq!(json["materials"][0], maker.json["materials"][0]);
        let materials = json["materials"].as_array().unwrap();
        match settings.target {
            // The lines keep the material without a texture.
            ValueTarget::Texture => {
                let mut copy = materials[1].clone();
                assert_eq!(materials.len(), 2);
                assert_eq!(copy["occlusionTexture"]["index"], 0);
                copy.as_object_mut().unwrap().remove("occlusionTexture");
                assert_eq!(copy, maker.json["materials"][0]);
            }
            ValueTarget::Vertices => assert_eq!(materials.len(), 1),
        }
    }
}

#[test]
fn nodes_with_shared_mesh_have_separate_values() {
    let glb = rich().glb();
    let read = Read::new(&written(&glb, &VERTICES, |p, _| p.x / 4.0).glb);
    for (mesh, shift) in [(0, 0.0), (1, 3.0)] {
        let (at, values) = (
            read.attribute(mesh, 0, "POSITION"),
            read.attribute(mesh, 0, "_OCCLUSION"),
        );
        assert_eq!(values.len(), 8);
        for (at, value) in at.chunks(3).zip(values) {
            assert!(
                (value - (at[0] + shift) / 4.0).abs() < 0.02,
                "{mesh} {at:?} {value}"
            );
        }
    }
    let read = Read::new(&written(&glb, &TEXTURE, |p, _| if p.x < 2.0 { 0.25 } else { 0.75 }).glb);
    let image = read.image();
    for (mesh, value) in [(0, 0.25), (1, 0.75)] {
        for uv in read.coordinates(mesh, 0).iter().flatten() {
            assert!((image.at(*uv) - value).abs() < 0.01);
        }
    }
}

#[test]
fn overlapping_coordinates_are_moved_apart() {
    let mut maker = Maker::new();
    let positions = maker.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0., 1., 1., 0.]);
    let uv = maker.floats("VEC2", &[0., 0., 1., 0., 0., 1., 1., 1.]);
    let indices = maker.indices(&[0, 1, 2, 2, 1, 3]);
    let attributes = json!({ "POSITION": positions, "TEXCOORD_0": uv, "TEXCOORD_1": uv });
    // A texture uses the second set: the set stays, and a third set is created.
    let lightmap = json!({ "emissiveTexture": { "index": 0, "texCoord": 1 } });
    maker.push(
        "images",
        json!({ "uri": "data:image/png;base64,iVBORw0KGgo=" }),
    );
    maker.push("textures", json!({ "source": 0 }));
    let material = maker.push("materials", lightmap);
    let primitive = json!({ "attributes": attributes, "indices": indices, "material": material });
    let mesh = maker.mesh(primitive.clone());
    let mut plain = primitive;
    plain.as_object_mut().unwrap().remove("material");
    let other = maker.mesh(plain);
    maker.node(json!({ "mesh": mesh }));
    maker.node(json!({ "mesh": mesh, "translation": [0, 0, 5], "scale": [3, 3, 3] }));
    maker.node(json!({ "mesh": other, "translation": [0, 0, 9] }));
    let settings = Settings {
        coordinates: TexCoordSource::Keep,
        ..TEXTURE
    };
    let made = written(&maker.glb(), &settings, |p, _| p.z / 10.0);
    assert_eq!(
        (made.facts.moved, made.facts.kept, made.facts.unwrapped),
        (3, 0, 0)
    );
    let read = Read::new(&made.glb);
    let image = read.image();
    for (mesh, value, set) in [(0, 0.0, 2), (2, 0.5, 2), (1, 0.9, 1)] {
        for uv in read.coordinates(mesh, 0).iter().flatten() {
            assert!((image.at(*uv) - value).abs() < 0.01, "{mesh} {uv:?}");
        }
        let material = read.primitive(mesh, 0)["material"].as_u64().unwrap() as usize;
        assert_eq!(
            read.json["materials"][material]["occlusionTexture"]["texCoord"],
            set
        );
    }
    assert_eq!(
        read.attribute(0, 0, "TEXCOORD_1"),
        [0., 0., 1., 0., 0., 1., 1., 1.]
    );
    // The larger square has three times as many texels per side.
    let side = |mesh: usize| {
        let uv = read.coordinates(mesh, 0);
        (uv[0][1][0] - uv[0][0][0]) * image.width as f64
    };
    assert!(
        (side(2) / side(0) - 3.0).abs() < 0.5,
        "{} {}",
        side(2),
        side(0)
    );
    assert_eq!(read.json["images"][0], maker.json["images"][0]);
}

#[test]
fn instances_become_nodes() {
    let mut maker = Maker::new();
    let primitive = cube_primitive(&mut maker);
    let mesh = maker.mesh(primitive);
    let offsets = maker.floats("VEC3", &[0., 0., 0., 2., 0., 0., 4., 0., 0.]);
    let scales = maker.floats("VEC3", &[1., 1., 1., -1., 1., 1., 1., 2., 1.]);
    let child = maker.push("nodes", json!({ "mesh": mesh, "translation": [0, 0, 7] }));
    let attributes = json!({ "TRANSLATION": offsets, "SCALE": scales });
    let extensions = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    maker.node(
        json!({ "name": "row", "mesh": mesh, "extensions": extensions, "children": [child] }),
    );
    maker.json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    maker.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let glb = maker.glb();
    for settings in [TEXTURE, VERTICES] {
        // `written` compares the triangles of both files.
        let made = written(&glb, &settings, |p, _| p.z / 8.0);
        let json = Read::new(&made.glb).json;
        assert!(json.get("extensionsUsed").is_none() && json.get("extensionsRequired").is_none());
        let node = &json["nodes"][1];
        assert!(node.get("mesh").is_none() && node.get("extensions").is_none());
        assert_eq!(node["children"].as_array().unwrap().len(), 4);
        assert_eq!(json["meshes"].as_array().unwrap().len(), 4);
    }
    let scene = scene(&glb);
    let plan = Plan::new("test.glb", &glb, None, &scene, &TEXTURE).unwrap();
    for r in plan.receivers() {
        let object = scene
            .objects()
            .iter()
            .find(|o| (o.first..o.first + o.count).contains(&r.triangle.0))
            .unwrap();
        let own = &scene.triangles()[object.first as usize..][..object.count as usize];
        let middle = own
            .iter()
            .flat_map(|t| t.v)
            .map(|v| v.as_dvec3())
            .sum::<glam::DVec3>()
            / own.len() as f64
            / 3.0;
        assert!(r.normal.dot(r.point - middle) > 0.0);
    }
}

#[test]
fn strips_fans_targets_and_small_types_survive_new_vertices() {
    let mut maker = Maker::new();
    let positions = maker.floats(
        "VEC3",
        &[0., 0., 0., 1., 0., 0., 0., 1., 0., 1., 1., 1., 0., 2., 0.],
    );
    let targets = maker.floats("VEC3", &[0.5; 15]);
    // Colours of three bytes, four bytes apart.
    let colors = maker.floats(
        "SCALAR",
        &(0..5)
            .map(|i| f32::from_bits(0x0102_0300 + i))
            .collect::<Vec<_>>(),
    );
    maker.json["bufferViews"][colors]["byteStride"] = json!(4);
    maker.json["accessors"][colors] = json!({
        "bufferView": colors, "componentType": 5121, "normalized": true, "count": 5, "type": "VEC3",
    });
    let attributes = json!({ "POSITION": positions, "COLOR_0": colors });
    let primitives: Vec<Json> = [5, 6]
        .map(|mode| json!({ "attributes": attributes, "mode": mode, "targets": [{ "POSITION": targets }] }))
        .to_vec();
    let mesh = maker.push(
        "meshes",
        json!({ "primitives": primitives, "weights": [0.5] }),
    );
    maker.node(json!({ "mesh": mesh }));
    let made = written(&maker.glb(), &TEXTURE, |_, _| 0.5);
    let read = Read::new(&made.glb);
    for p in 0..2 {
        let primitive = read.primitive(0, p);
        assert_eq!(primitive["mode"], 4);
        let (at, colors) = (
            read.attribute(0, p, "POSITION"),
            read.attribute(0, p, "COLOR_0"),
        );
        let target = read.accessor(primitive["targets"][0]["POSITION"].as_u64().unwrap() as usize);
        assert!(at.len() >= 15 && colors.len() == at.len() && target == vec![0.5; at.len()]);
        let original = [
            [0., 0., 0.],
            [1., 0., 0.],
            [0., 1., 0.],
            [1., 1., 1.],
            [0., 2., 0.],
        ];
        for (at, color) in at.chunks(3).zip(colors.chunks(3)) {
            let i = original.iter().position(|o| o == at).unwrap();
            assert_eq!(color, [i as f64, 3.0, 2.0]);
        }
    }
}

#[test]
fn material_variants_get_texture() {
    let mut maker = Maker::new();
    let (positions, indices) = add_cube(&mut maker);
    let old = maker.push(
        "materials",
        json!({ "name": "a", "occlusionTexture": { "index": 0, "strength": 0.5 } }),
    );
    let other = maker.push("materials", json!({ "name": "b" }));
    let unused = maker.push("materials", json!({ "name": "c" }));
    maker.push(
        "images",
        json!({ "uri": "data:image/png;base64,iVBORw0KGgo=" }),
    );
    maker.push("textures", json!({ "source": 0 }));
    let mappings =
        json!([{ "material": other, "variants": [0] }, { "material": old, "variants": [1] }]);
    let primitive = json!({
        "attributes": { "POSITION": positions }, "indices": indices, "material": old,
        "extensions": { "KHR_materials_variants": { "mappings": mappings } },
    });
    let mesh = maker.mesh(primitive);
    maker.node(json!({ "mesh": mesh }));
    let made = written(&maker.glb(), &TEXTURE, |_, _| 0.5);
    assert_eq!(
        (made.facts.materials, made.facts.replaced, made.notes.len()),
        (0, 1, 1)
    );
    let json = Read::new(&made.glb).json;
    for (material, index) in [(old, json!(1)), (other, json!(1)), (unused, Json::Null)] {
        assert_eq!(
            json["materials"][material]["occlusionTexture"]["index"],
            index
        );
    }
    assert_eq!(
        json["meshes"][0]["primitives"][0]["extensions"]["KHR_materials_variants"]["mappings"],
        mappings
    );
}

#[test]
fn external_files_are_embedded() {
    let folder = tempfile::tempdir().unwrap();
    let mut maker = Maker::new();
    let primitive = cube_primitive(&mut maker);
    let mesh = maker.mesh(primitive);
    maker.node(json!({ "mesh": mesh }));
    let glb = maker.glb();
    let image = b"\x89PNG\r\n\x1a\nrest";
    std::fs::write(folder.path().join("a b.png"), image).unwrap();
    std::fs::write(folder.path().join("cube.bin"), &Read::new(&glb).bytes).unwrap();
    let mut json = maker.json.clone();
    let length = Read::new(&glb).bytes.len();
    json["buffers"] = json!([{ "uri": "cube.bin", "byteLength": length, "name": "of cubes" }]);
    json["images"] = json!([{ "uri": "a%20b.png", "name": "picture" }]);
    let text = serde_json::to_vec(&json).unwrap();
    let scene = sightline_scene::load_bytes("cube.gltf", &text, Some(folder.path())).unwrap();
    let plan = Plan::new("cube.gltf", &text, Some(folder.path()), &scene, &TEXTURE).unwrap();
    let values = vec![
        ReceiverValue {
            open: 0.5,
            inside: false
        };
        plan.receivers().len()
    ];
    let made = plan.write(&values).unwrap();
    let read = Read::new(&made.glb);
    assert_eq!(
        read.view(read.json["images"][0]["bufferView"].as_u64().unwrap() as usize),
        image
    );
    assert_eq!(
        (
            &read.json["images"][0]["mimeType"],
            &read.json["images"][0]["name"]
        ),
        (&json!("image/png"), &json!("picture"))
    );
    assert_eq!(read.json["buffers"][0]["name"], "of cubes");
    assert!(
        sightline_scene::load_bytes("out.glb", &made.glb, None)
            .unwrap()
            .triangles()
            == scene.triangles()
    );
    // The file is incomplete without the image.
    std::fs::remove_file(folder.path().join("a b.png")).unwrap();
    assert!(
        plan.write(&values)
            .unwrap_err()
            .to_string()
            .contains("image 0")
    );
}

#[test]
fn other_formats_become_gltf() {
    let text = "o floor\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nf 1 2 3 4\no empty\no wall\nv 4 0 4\n\
                f 1 2 5\nf 1 1 2\n";
    let scene = sightline_scene::load_bytes("floor.obj", text.as_bytes(), None).unwrap();
    for settings in [TEXTURE, VERTICES] {
        let plan = Plan::new("floor.obj", text.as_bytes(), None, &scene, &settings).unwrap();
        let values = vec![
            ReceiverValue {
                open: 0.5,
                inside: false
            };
            plan.receivers().len()
        ];
        let made = plan.write(&values).unwrap();
        let again = sightline_scene::load_bytes("out.glb", &made.glb, None).unwrap();
        assert!(again.triangles() == scene.triangles());
        assert_eq!(
            Read::new(&made.glb).json["meshes"][0]["name"],
            scene.objects()[0].name.as_str()
        );
    }
}
