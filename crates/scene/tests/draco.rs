//! Primitives compressed with KHR_draco_mesh_compression.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use draco_core::EncoderOptions;
use proptest::prelude::*;
use serde_json::{Value, json};
use sightline_scene::TriangleId;
use sightline_scene::load::{LoadOptions, load_bytes_with};
use support::{SQUARE, by_index, card, compress_primitive, draco, draco_square, soup};

/// Sorts triangles as sets: compression may change their order and the corner at which each begins.
fn sorted(mut soup: Vec<[[f32; 3]; 3]>) -> Vec<[[u32; 3]; 3]> {
    let turned = |t: &[[f32; 3]; 3]| {
        let t = t.map(|v| v.map(|c| (c + 0.0).to_bits()));
        (0..3)
            .map(|k| [t[k], t[(k + 1) % 3], t[(k + 2) % 3]])
            .min()
            .unwrap()
    };
    let mut all: Vec<_> = soup.iter_mut().map(|t| turned(t)).collect();
    all.sort_unstable();
    all
}

#[test]
fn compressed_square_equals_square() {
    let scene = draco_square().load().unwrap();
    assert_eq!(
        sorted(soup(&scene)),
        sorted(by_index(&SQUARE, &[[0, 1, 2], [0, 2, 3]]))
    );
    // The compressed data are also used if a file does not require the extension, as the extension recommends
    // to readers.
    let mut g = draco_square();
    g.json["extensionsUsed"] = g.json["extensionsRequired"].take();
    g.json.as_object_mut().unwrap().remove("extensionsRequired");
    assert_eq!(soup(&g.load().unwrap()), soup(&scene));
}

#[test]
fn texture_coordinates_are_decoded_with_their_vertices() {
    let uv = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    let options = EncoderOptions::new();
    // The left half of the image is open.
    let open = [0, 1, 4, 5];
    let plain = card(&open, |_| ());
    let mut g = card(&open, |_| ());
    let packed = draco(&SQUARE, &uv, &[[0, 1, 2], [0, 2, 3]], &options);
    compress_primitive(&mut g, 0, &packed, json!({"POSITION": 0, "TEXCOORD_0": 1}));
    let options = LoadOptions {
        alpha_textures: true,
        ..LoadOptions::default()
    };
    let blocks = |g: &support::Gltf, at: [f32; 2]| {
        let scene = load_bytes_with("a.glb", &g.glb(), None, &options)
            .unwrap()
            .scene;
        let inside = |t: &[[f32; 3]; 3]| {
            (0..3).all(|k| {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                (b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0]) > 0.0
            })
        };
        let triangle = soup(&scene).iter().position(inside).unwrap();
        scene.mask_blocks(
            TriangleId(triangle as u32),
            [at[0], at[1], -1.0],
            [0.0, 0.0, 1.0],
        )
    };
    for at in [
        [0.2, 0.4],
        [0.4, 0.3],
        [0.6, 0.3],
        [0.8, 0.9],
        [0.3, 0.9],
        [0.9, 0.2],
    ] {
        assert_eq!(blocks(&g, at), blocks(&plain, at), "{at:?}");
        assert_eq!(blocks(&g, at), at[0] > 0.5, "{at:?}");
    }
}

#[test]
fn rejects_faults_with_primitive() {
    let refused = |change: &dyn Fn(&mut Value), parts: &[&str]| {
        let mut g = draco_square();
        change(&mut g.json);
        let e = g.load().unwrap_err().to_string();
        for part in parts {
            assert!(e.contains(part), "{part} in {e}");
        }
    };
    fn extension(j: &mut Value) -> &mut Value {
        &mut j["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]
    }
    let location = "mesh 0, primitive 0, KHR_draco_mesh_compression";
    refused(
        &|j| extension(j)["bufferView"] = json!(99),
        &[location, "buffer view 99"],
    );
    refused(
        &|j| extension(j)["bufferView"] = json!(0),
        &[location, "cannot be decoded"],
    );
    refused(
        &|j| extension(j)["attributes"]["POSITION"] = json!(7),
        &[location, "attribute 7", "no attribute 7"],
    );
    refused(
        &|j| j["accessors"][0]["count"] = json!(5),
        &[location, "accessor 0 has 5 elements, but 4"],
    );
    refused(
        &|j| j["accessors"][0]["componentType"] = json!(5123),
        &[location, "do not fit accessor 0"],
    );
    refused(
        &|j| j["meshes"][0]["primitives"][0]["mode"] = json!(5),
        &[location, "mode of the primitive must be 4"],
    );
    refused(
        &|j| {
            j["meshes"][0]["primitives"][0]
                .as_object_mut()
                .unwrap()
                .remove("indices");
        },
        &[location, "no indices"],
    );
    // Data beyond the counts of the accessors are not decoded.
    refused(
        &|j| j["accessors"][1]["count"] = json!(3),
        &[location, "ceiling"],
    );
    refused(
        &|j| {
            j["accessors"][0]["sparse"] = json!({
                "count": 1, "indices": {"bufferView": 0, "componentType": 5123}, "values": {"bufferView": 0}
            });
        },
        &[location, "sparse"],
    );
}

#[test]
fn rejects_accessor_of_two_compressed_primitives() {
    let mut g = draco_square();
    let mut other = g.json["meshes"][0]["primitives"][0].clone();
    let again = draco(
        &SQUARE,
        &[],
        &[[0, 1, 2], [0, 2, 3]],
        &EncoderOptions::new(),
    );
    let view = g.view(&again.bytes);
    other["extensions"]["KHR_draco_mesh_compression"]["bufferView"] = json!(view);
    g.json["meshes"][0]["primitives"]
        .as_array_mut()
        .unwrap()
        .push(other);
    let e = g.load().unwrap_err().to_string();
    assert!(
        e.contains("primitive 1, KHR_draco") && e.contains("another compressed primitive"),
        "{e}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Meshes survive every connectivity that the encoder writes, without quantisation.
    #[test]
    fn random_meshes_survive_encoding(
        points in proptest::collection::btree_set([-40i32..40, -40i32..40, -40i32..40], 3..40),
        picks in proptest::collection::vec([any::<usize>(), any::<usize>(), any::<usize>()], 1..60),
        speed in 0i32..11,
    ) {
        let points: Vec<[f32; 3]> = points.iter().map(|p| p.map(|c| c as f32 * 0.25)).collect();
        let picks = picks.iter().map(|t| t.map(|i| (i % points.len()) as u32));
        let faces: Vec<[u32; 3]> = picks.filter(|[a, b, c]| a != b && b != c && c != a).collect();
        prop_assume!(!faces.is_empty());
        let mut options = EncoderOptions::new();
        options.set_global_int("encoding_speed", speed);
        options.set_global_int("decoding_speed", speed);
        let packed = draco(&points, &[], &faces, &options);
        let mut g = support::square();
        compress_primitive(&mut g, 0, &packed, json!({"POSITION": 0}));
        let scene = g.load().unwrap();
        let expected: Vec<[usize; 3]> = faces.iter().map(|t| t.map(|i| i as usize)).collect();
        prop_assert_eq!(sorted(soup(&scene)), sorted(by_index(&points, &expected)));
    }
}
