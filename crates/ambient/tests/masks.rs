//! Masked triangles, compared with separate quads for their blocking texels.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use base64::Engine as _;
use glam::{DVec3, Vec3};
use serde_json::json;
use sightline_ambient::{AmbientScene, Receiver, Solver, SolverSettings};
use sightline_scene::load::{LoadOptions, load_bytes_with};
use sightline_scene::{Object, Scene, Triangle, TriangleId};

const SIZE: [u32; 2] = [5, 3];
/// The texels of the mask, row by row from the top of the image: 1 blocks.
const TEXELS: [u8; 15] = [1, 1, 0, 0, 1, 0, 1, 1, 0, 1, 0, 1, 1, 0, 0];

/// Creates the corners of a tilted card over the origin, with texture coordinates that repeat the image.
fn card() -> [(Vec3, [f32; 2]); 4] {
    [[-1.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-1.0, 1.0]].map(|[x, y]: [f32; 2]| {
        (
            Vec3::new(x, y, 1.0 + 0.25 * x),
            [(x + 1.0) * 0.5, (1.0 - y) * 0.5],
        )
    })
}

fn masked() -> Scene {
    let mut image = Vec::new();
    let mut encoder = png::Encoder::new(&mut image, SIZE[0], SIZE[1]);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    let texels: Vec<u8> = TEXELS.iter().flat_map(|t| [0, 255 * t]).collect();
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&texels)
        .unwrap();
    let corners = [0, 1, 2, 0, 2, 3].map(|k| card()[k]);
    let mut bytes: Vec<u8> = corners
        .iter()
        .flat_map(|c| c.0.to_array())
        .flat_map(f32::to_le_bytes)
        .collect();
    let of_positions = bytes.len();
    bytes.extend(corners.iter().flat_map(|c| c.1).flat_map(f32::to_le_bytes));
    let uri = |kind: &str, bytes: &[u8]| {
        format!(
            "data:{kind};base64,{}",
            base64::engine::general_purpose::STANDARD.encode(bytes)
        )
    };
    let file = json!({
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "materials": [{"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": uri("image/png", &image)}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 6, "type": "VEC2"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": of_positions},
            {"buffer": 0, "byteOffset": of_positions, "byteLength": bytes.len() - of_positions},
        ],
        "buffers": [{"uri": uri("application/octet-stream", &bytes), "byteLength": bytes.len()}],
    });
    let options = LoadOptions {
        alpha_textures: true,
        ..LoadOptions::default()
    };
    load_bytes_with("card.gltf", file.to_string().as_bytes(), None, &options)
        .unwrap()
        .scene
}

/// Creates a scene with a quad for each blocking texel. The card is 1.5 images wide.
fn cut() -> Scene {
    let mut triangles = Vec::new();
    for (row, column) in (0..3).flat_map(|row| (0..8).map(move |column| (row, column))) {
        if TEXELS[row * 5 + column % 5] == 0 {
            continue;
        }
        let at = |column: f32, row: f32| {
            let (x, y) = ((column / 5.0 * 2.0 - 1.0).min(2.0), 1.0 - row / 3.0 * 2.0);
            Vec3::new(x, y, 1.0 + 0.25 * x)
        };
        let (x, y) = (column as f32, row as f32);
        let [a, b, c, d] = [
            at(x, y),
            at(x + 1.0, y),
            at(x + 1.0, y + 1.0),
            at(x, y + 1.0),
        ];
        triangles.extend([Triangle { v: [a, b, c] }, Triangle { v: [a, c, d] }]);
    }
    let object = Object {
        name: "cut".to_owned(),
        first: 0,
        count: triangles.len() as u32,
    };
    Scene::new("cut", triangles, vec![object]).unwrap()
}

#[test]
fn masked_card_hides_as_much_as_texels() {
    for distance in [f64::INFINITY, 1.3] {
        for fragments in [false, true] {
            let open = |scene: &Scene| {
                let settings = SolverSettings {
                    fragments,
                    ..SolverSettings::new(distance)
                };
                let at = Receiver {
                    point: DVec3::new(0.1, 0.2, 0.0),
                    normal: DVec3::Z,
                    triangle: None,
                };
                let prepared = AmbientScene::new(scene, fragments).unwrap();
                Solver::new(&prepared, settings).solve(&[at], |_| {})[0]
                    .openness
                    .open
            };
            let (by_texels, by_quads) = (open(&masked()), open(&cut()));
            assert!(
                (by_texels - by_quads).abs() < 1e-6,
                "{by_texels} {by_quads}"
            );
            assert!(by_quads < 0.9);
        }
    }
}

#[test]
fn card_does_not_hide_receiver_on_card() {
    let prepared = AmbientScene::new(&masked(), false).unwrap();
    let solver = Solver::new(&prepared, SolverSettings::new(1.0));
    // A point in the first texel, which is slightly below the card.
    let on = |triangle| Receiver {
        point: DVec3::new(-0.9, 0.9, 1.0 - 0.25 * 0.9 - 1e-9),
        normal: DVec3::new(-0.25, 0.0, 1.0),
        triangle,
    };
    assert!(
        solver.solve(&[on(Some(TriangleId(1)))], |_| {})[0]
            .openness
            .open
            > 0.999
    );
    assert!(solver.solve(&[on(None)], |_| {})[0].openness.open < 0.5);
}
