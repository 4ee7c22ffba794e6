//! Masked triangles hide where their texels do.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use base64::Engine as _;
use glam::{DVec3, Vec3};
use serde_json::json;
use sightline_ambient::{Prepared, Receiver, Settings, Solver};
use sightline_scene::load::{Options, load_bytes_with};
use sightline_scene::{Object, Scene, Triangle};

const SIZE: [u32; 2] = [5, 3];
/// Row by row from the top of the image: 1 hides.
const TEXELS: [u8; 15] = [1, 1, 0, 0, 1, 0, 1, 1, 0, 1, 0, 1, 1, 0, 0];

/// The corners of a tilted card over the origin, with texture coordinates that repeat the image.
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
    let options = Options {
        alpha_textures: true,
        ..Options::default()
    };
    load_bytes_with("card.gltf", file.to_string().as_bytes(), None, &options)
        .unwrap()
        .scene
}

/// The texels that hide as quads of their own. The card is 1.5 images wide.
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
fn a_card_hides_what_its_texels_hide() {
    for distance in [f64::INFINITY, 1.3] {
        for fragments in [false, true] {
            let open = |scene: &Scene| {
                let settings = Settings {
                    fragments,
                    ..Settings::new(distance)
                };
                let at = Receiver {
                    point: DVec3::new(0.1, 0.2, 0.0),
                    normal: DVec3::Z,
                    triangle: None,
                };
                let prepared = Prepared::new(scene, fragments).unwrap();
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
fn a_card_hides_nothing_from_what_lies_on_it() {
    let prepared = Prepared::new(&masked(), false).unwrap();
    let solver = Solver::new(&prepared, Settings::new(1.0));
    // In the first texel, rounded to below the card.
    let on = |triangle| Receiver {
        point: DVec3::new(-0.9, 0.9, 1.0 - 0.25 * 0.9 - 1e-9),
        normal: DVec3::new(-0.25, 0.0, 1.0),
        triangle,
    };
    assert!(solver.solve(&[on(Some(1))], |_| {})[0].openness.open > 0.999);
    assert!(solver.solve(&[on(None)], |_| {})[0].openness.open < 0.5);
}
