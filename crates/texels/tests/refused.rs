//! Rejected input: each error states the reason, the element and a remedy, and damaged files never cause a
//! panic.

#![allow(clippy::unwrap_used, reason = "tests")]

mod support;

use proptest::prelude::*;
use serde_json::{Value as Json, json};
use sightline_texels::{Plan, ReceiverValue, Settings, TexCoordSource, TextureSize, ValueTarget};
use support::{Maker, cube_primitive, scene};

const TEXTURE: Settings = Settings {
    target: ValueTarget::Texture,
    size: TextureSize::Resolution(64),
    coordinates: TexCoordSource::Keep,
    bits: sightline_texels::BitDepth::Eight,
};

fn error(maker: &Maker, settings: &Settings) -> String {
    let glb = maker.glb();
    let scene = scene(&glb);
    Plan::new("test.glb", &glb, None, &scene, settings)
        .unwrap_err()
        .to_string()
}

/// Creates two triangles with these texture coordinates.
fn square(uv: &[f32]) -> Maker {
    let mut maker = Maker::new();
    let positions = maker.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0., 1., 1., 0.]);
    let mut attributes = json!({ "POSITION": positions });
    if !uv.is_empty() {
        attributes["TEXCOORD_1"] = json!(maker.floats("VEC2", uv));
    }
    let indices = maker.indices(&[0, 1, 2, 2, 1, 3]);
    let mesh = maker.mesh(json!({ "attributes": attributes, "indices": indices }));
    maker.node(json!({ "mesh": mesh }));
    maker
}

#[test]
fn unusable_coordinates_are_named() {
    let cases: [(&[f32], &str); 5] = [
        (
            &[],
            "mesh 0, primitive 0 (at node 0): the primitive has no TEXCOORD_1",
        ),
        (
            &[0., 0., 1., 0., 0., 1., 0.2, 0.2],
            "mesh 0, primitive 0 (at node 0), triangles 0 and 1: the triangles overlap",
        ),
        (
            &[0., 0., 1., 0., 0., 1., 1.5, 1.],
            "triangle 1: a corner has TEXCOORD_1 outside 0 to 1",
        ),
        (
            &[0., 0., 1., 0., 0., 1., f32::NAN, 1.],
            "triangle 1: a corner has TEXCOORD_1 outside 0 to 1",
        ),
        (&[0.5; 8], "more than 1 % of the surface has no area"),
    ];
    for (uv, expected) in cases {
        let maker = square(uv);
        let said = error(&maker, &TEXTURE);
        assert!(
            said.contains(expected) && said.contains("--uv keep"),
            "{said}"
        );
        // Otherwise new coordinates are created, and a note states the reason.
        let any = Settings {
            coordinates: TexCoordSource::Any,
            ..TEXTURE
        };
        let glb = maker.glb();
        let scene = scene(&glb);
        let plan = Plan::new("test.glb", &glb, None, &scene, &any).unwrap();
        assert!(
            plan.notes().len() == 1 && plan.notes()[0].contains(expected),
            "{:?}",
            plan.notes()
        );
    }
}

#[test]
fn sizes_have_limits() {
    let maker = square(&[0., 0., 1., 0., 0., 1., 1., 1.]);
    for coordinates in [TexCoordSource::Keep, TexCoordSource::Unwrap] {
        let with = |size| {
            error(
                &maker,
                &Settings {
                    size,
                    coordinates,
                    ..TEXTURE
                },
            )
        };
        assert!(with(TextureSize::Texel(1e-5)).contains("16384 x 16384"));
        assert!(with(TextureSize::Texel(1e-300)).contains("16384 x 16384"));
        for size in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(with(TextureSize::Texel(size)).contains("--texel"));
        }
        for side in [0, 15, 16385, u32::MAX] {
            assert!(with(TextureSize::Resolution(side)).contains("--resolution"));
        }
    }
}

#[test]
fn many_charts_need_large_image() {
    let mut maker = Maker::new();
    let primitive = cube_primitive(&mut maker);
    let mesh = maker.mesh(primitive);
    for i in 0..20 {
        maker.node(json!({ "mesh": mesh, "translation": [2 * i, 0, 0] }));
    }
    let settings = Settings {
        size: TextureSize::Resolution(32),
        coordinates: TexCoordSource::Unwrap,
        ..TEXTURE
    };
    let said = error(&maker, &settings);
    assert!(said.contains("do not fit into 32 x 32 texels"), "{said}");
}

#[test]
fn compressions_are_named() {
    let maker = square(&[]);
    let glb = maker.glb();
    let scene = scene(&glb);
    let mut draco = square(&[]);
    draco.json["meshes"][0]["primitives"][0]["extensions"] =
        json!({ "KHR_draco_mesh_compression": { "bufferView": 0 } });
    let mut meshopt = square(&[]);
    meshopt.json["bufferViews"][1]["extensions"] = json!({ "EXT_meshopt_compression": {} });
    for (maker, expected) in [
        (
            draco,
            "mesh 0, primitive 0: data compressed with KHR_draco_mesh_compression",
        ),
        (
            meshopt,
            "buffer view 1: data compressed with EXT_meshopt_compression",
        ),
    ] {
        let said = Plan::new("test.glb", &maker.glb(), None, &scene, &TEXTURE)
            .unwrap_err()
            .to_string();
        assert!(
            said.contains(expected) && said.contains("export it uncompressed"),
            "{said}"
        );
    }
}

#[test]
fn scene_without_area_is_rejected() {
    let mut maker = Maker::new();
    let positions = maker.floats("VEC3", &[0., 0., 0., 1., 1., 1., 2., 2., 2.]);
    let mesh = maker.mesh(json!({ "attributes": { "POSITION": positions } }));
    maker.node(json!({ "mesh": mesh }));
    for (target, coordinates) in [
        (ValueTarget::Texture, TexCoordSource::Any),
        (ValueTarget::Vertices, TexCoordSource::Any),
    ] {
        let said = error(
            &maker,
            &Settings {
                target,
                coordinates,
                ..TEXTURE
            },
        );
        assert!(said.contains("no triangle has an area"), "{said}");
    }
}

#[test]
fn foreign_scene_is_rejected() {
    let glb = square(&[]).glb();
    let mut other = Maker::new();
    let primitive = cube_primitive(&mut other);
    let mesh = other.mesh(primitive);
    other.node(json!({ "mesh": mesh }));
    let scene = scene(&other.glb());
    let said = Plan::new("test.glb", &glb, None, &scene, &TEXTURE)
        .unwrap_err()
        .to_string();
    assert!(
        said.contains("the primitive has 2 triangles in the file and 12 in the scene"),
        "{said}"
    );
}

#[test]
fn values_must_be_complete_and_in_range() {
    let glb = square(&[0., 0., 1., 0., 0., 1., 1., 1.]).glb();
    let scene = scene(&glb);
    let plan = Plan::new("test.glb", &glb, None, &scene, &TEXTURE).unwrap();
    let mut values = vec![
        ReceiverValue {
            open: 0.5,
            inside: false
        };
        plan.receivers().len()
    ];
    for open in [f64::NAN, 1.5, -0.1, f64::INFINITY] {
        values[3].open = open;
        assert!(plan.write(&values).is_err());
    }
    values[3].inside = true;
    assert!(plan.write(&values).is_ok());
    assert!(plan.write(&values[1..]).is_err());
}

/// Creates a file with most of the elements that the crate reads.
fn seed() -> Vec<u8> {
    let mut maker = Maker::new();
    let mut primitive = cube_primitive(&mut maker);
    let normals = maker.floats("VEC3", &[0.6; 24]);
    let uv = maker.floats(
        "VEC2",
        &(0..16).map(|i| i as f32 / 16.0).collect::<Vec<_>>(),
    );
    primitive["attributes"]["NORMAL"] = json!(normals);
    primitive["attributes"]["TEXCOORD_1"] = json!(uv);
    primitive["targets"] = json!([{ "POSITION": normals }]);
    primitive["material"] =
        json!(maker.push("materials", json!({ "normalTexture": { "texCoord": 1 } })));
    let mut strip = primitive.clone();
    strip["mode"] = json!(5);
    let mesh = maker.push("meshes", json!({ "primitives": [primitive, strip] }));
    let offsets = maker.floats("VEC3", &[0., 0., 0., 2., 0., 0.]);
    let attributes = json!({ "TRANSLATION": offsets, "SCALE": offsets });
    let extensions = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    let child = maker.push("nodes", json!({ "mesh": mesh, "scale": [-1, 1, 1] }));
    maker.node(json!({ "mesh": mesh, "extensions": extensions, "children": [child] }));
    maker.push(
        "images",
        json!({ "bufferView": 0, "mimeType": "image/png" }),
    );
    maker.glb()
}

/// Reads, plans and writes arbitrary bytes.
fn exercise(glb: &[u8]) {
    let Ok(scene) = sightline_scene::load_bytes("x.glb", glb, None) else {
        return;
    };
    for coordinates in [TexCoordSource::Any, TexCoordSource::Keep] {
        for target in [ValueTarget::Texture, ValueTarget::Vertices] {
            let settings = Settings {
                target,
                coordinates,
                ..TEXTURE
            };
            let Ok(plan) = Plan::new("x.glb", glb, None, &scene, &settings) else {
                continue;
            };
            let values = plan.receivers().iter().enumerate();
            let values: Vec<ReceiverValue> = values
                .map(|(i, r)| ReceiverValue {
                    open: r.point.x.rem_euclid(1.0).min(1.0),
                    inside: i % 7 == 0,
                })
                .collect();
            let Ok(made) = plan.write(&values) else {
                continue;
            };
            let again = sightline_scene::load_bytes("out.glb", &made.glb, None).unwrap();
            assert!(again.triangles() == scene.triangles());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn changed_bytes_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)
    ) {
        let mut glb = seed();
        for (at, to) in changes {
            let at = at.index(glb.len() - 20) + 20;
            glb[at] = to;
        }
        exercise(&glb);
    }

    #[test]
    fn changed_numbers_never_panic(at in any::<prop::sample::Index>(), to in prop_oneof![
        Just(json!(-1)), Just(json!(0)), Just(json!(3)), Just(json!(1 << 20)), Just(json!(u64::MAX)),
        Just(json!("x")),
        Just(json!([])), Just(Json::Null), Just(json!(5121)), Just(json!("VEC4"))
    ]) {
        let glb = seed();
        let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
        let mut json: Json = serde_json::from_slice(&glb[20..20 + length]).unwrap();
        // The paths of all values; one of these values is replaced.
        let mut places = vec![String::new()];
        let mut open = vec![(String::new(), &json)];
        while let Some((path, value)) = open.pop() {
            let children: Vec<(String, &Json)> = match value {
                Json::Object(o) => o.iter().map(|(k, v)| (format!("{path}/{k}"), v)).collect(),
                Json::Array(a) => a.iter().enumerate().map(|(k, v)| (format!("{path}/{k}"), v)).collect(),
                _ => Vec::new(),
            };
            places.extend(children.iter().map(|c| c.0.clone()));
            open.extend(children);
        }
        *json.pointer_mut(&places[at.index(places.len())]).unwrap() = to;
        let mut text = serde_json::to_vec(&json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut out = glb[..12].to_vec();
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(b"JSON");
        out.extend(&text);
        out.extend(&glb[20 + length..]);
        let total = out.len() as u32;
        out[8..12].copy_from_slice(&total.to_le_bytes());
        exercise(&out);
    }
}
