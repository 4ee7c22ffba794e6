//! Tests of sight lines among masked triangles: their ends and the shown triangles, equal on every backend.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::sync::Arc;

use base64::Engine as _;
use serde_json::{Value, json};
use sightline_scene::load::{LoadOptions, load_bytes_with};
use sightline_scene::{Scene, SurfaceKind, TriangleId};
use sightline_trace::cpu::CpuBackend;
use sightline_trace::gpu::{AdapterChoice, GpuBackend};
use sightline_trace::packet::Packet;
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_trace::{CubeSpec, PreparedScene, SKY, Strata, Tracer, TracerError};

/// Squares across the x axis as a glTF file: each at x = `at`, over 0…4 along y and z, with a material.
#[derive(Default)]
struct Cards {
    bytes: Vec<u8>,
    primitives: Vec<Value>,
    accessors: Vec<Value>,
    views: Vec<Value>,
}

/// The materials: opaque; glass; open for y below 2; open for y above 2; chequered in squares of one.
const WALL: u32 = 0;
const GLASS: u32 = 1;
const LOW: u32 = 2;
const HIGH: u32 = 3;
const CHEQUERED: u32 = 4;

impl Cards {
    fn accessor(&mut self, numbers: &[f32], shape: &str, each: usize) -> usize {
        let view =
            json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": numbers.len() * 4});
        self.bytes
            .extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        self.views.push(view);
        let count = numbers.len() / each;
        self.accessors.push(
            json!({"bufferView": self.views.len() - 1, "componentType": 5126, "type": shape, "count": count}),
        );
        self.accessors.len() - 1
    }

    /// Adds a card of two triangles. If `turned`, their winding is reversed, at the same positions.
    fn card(mut self, at: f32, material: u32, turned: bool) -> Self {
        let corner = |y: f32, z: f32| [at, y, z];
        let [a, b, c, d] = [
            corner(0.0, 0.0),
            corner(4.0, 0.0),
            corner(4.0, 4.0),
            corner(0.0, 4.0),
        ];
        let order = if turned {
            [a, c, b, a, d, c]
        } else {
            [a, b, c, a, c, d]
        };
        let uv: Vec<f32> = order
            .iter()
            .flat_map(|p| [p[1] / 4.0, p[2] / 4.0])
            .collect();
        let position = self.accessor(order.as_flattened(), "VEC3", 3);
        let uv = self.accessor(&uv, "VEC2", 2);
        self.primitives.push(
            json!({"attributes": {"POSITION": position, "TEXCOORD_0": uv}, "material": material}),
        );
        self
    }

    fn scene(self) -> Arc<Scene> {
        let base64 = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
        let masked = |texture: u32| {
            let base = json!({"baseColorTexture": {"index": texture}});
            json!({"alphaMode": "MASK", "pbrMetallicRoughness": base})
        };
        let chequered: Vec<u8> = (0..16u32)
            .map(|t| if (t % 4 + t / 4) % 2 == 0 { 255 } else { 0 })
            .collect();
        let image = |size: [u32; 2], alpha: &[u8]| {
            let uri = format!("data:image/png;base64,{}", base64(&png(size, alpha)));
            json!({"uri": uri})
        };
        let file = json!({
            "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "meshes": [{"primitives": self.primitives}],
            "materials": [{}, {"alphaMode": "BLEND"}, masked(0), masked(1), masked(2)],
            "textures": [{"source": 0}, {"source": 1}, {"source": 2}],
            "images": [image([2, 1], &[0, 255]), image([2, 1], &[255, 0]), image([4, 4], &chequered)],
            "accessors": self.accessors, "bufferViews": self.views,
            "buffers": [{
                "uri": format!("data:;base64,{}", base64(&self.bytes)), "byteLength": self.bytes.len()
            }],
        });
        let options = LoadOptions {
            alpha_textures: true,
            ..LoadOptions::default()
        };
        Arc::new(
            load_bytes_with("cards.gltf", file.to_string().as_bytes(), None, &options)
                .unwrap()
                .scene,
        )
    }
}

fn png([width, height]: [u32; 2], alpha: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    let texels: Vec<u8> = alpha.iter().flat_map(|a| [0, *a]).collect();
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&texels)
        .unwrap();
    out
}

/// Returns the backends of this machine. Under `CI`, a missing adapter is a failure.
fn backends(scene: &Arc<Scene>) -> Vec<Box<dyn Tracer>> {
    let spec = CubeSpec {
        resolution: 16,
        strata: Strata::One,
        keep_pixels: false,
    };
    let mut backends: Vec<Box<dyn Tracer>> =
        vec![Box::new(CpuBackend::new(Arc::clone(scene), spec).unwrap())];
    match GpuBackend::new(Arc::clone(scene), spec, AdapterChoice::AllowSoftware) {
        Ok(gpu) => backends.push(Box::new(gpu)),
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            eprintln!("not run on a GPU: {why}");
        }
        Err(e) => panic!("{e}"),
    }
    backends
}

/// The triangles on a line: the triangle at its end, its distance, and the passed triangles.
type LineHit = (u32, f32, Vec<u32>);

/// Traces lines with a backend, as packets or one by one.
fn traced(
    backend: &dyn Tracer,
    scene: &Arc<Scene>,
    lines: &[([f32; 3], [f32; 3])],
    each: bool,
) -> Vec<LineHit> {
    let prepared = PreparedScene::new(Arc::clone(scene)).unwrap();
    let sight = SightLineTracer::new(backend, prepared.traced()).unwrap();
    let mut packets: Vec<Packet> = lines
        .chunks(16)
        .map(|some| {
            let mut packet = Packet::default();
            some.iter()
                .for_each(|(origin, direction)| packet.push(*origin, *direction));
            packet
        })
        .collect();
    let mut passed = Passed::default();
    match each {
        true => sight.trace_each(&mut packets, &mut passed, 1e-6).unwrap(),
        false => sight.trace(&mut packets, &mut passed, 1e-6).unwrap(),
    }
    let shown = |i: usize| {
        let (packet, lane) = (i / 16, i % 16);
        let traced_packet = &packets[packet];
        (
            traced_packet.triangle[lane],
            traced_packet.distance[lane],
            passed.on(packet, lane).collect(),
        )
    };
    (0..lines.len()).map(shown).collect()
}

/// Returns the numbers of the cards that lines along x at these y and z show.
///
/// The result has the card at the end of each line, if there is one, and the other cards.
fn along_x(scene: &Arc<Scene>, at: &[[f32; 2]]) -> Vec<(Option<u32>, Vec<u32>)> {
    let lines: Vec<_> = at
        .iter()
        .map(|[y, z]| ([-1.0, *y, *z], [2.0, 0.0, 0.0]))
        .collect();
    let mut all: Vec<Vec<LineHit>> = Vec::new();
    for backend in backends(scene) {
        all.extend([false, true].map(|each| traced(&*backend, scene, &lines, each)));
    }
    let ids: Vec<Vec<_>> = all
        .iter()
        .map(|shown| shown.iter().map(|s| (s.0, s.2.clone())).collect())
        .collect();
    assert!(
        ids.windows(2).all(|two| two[0] == two[1]),
        "all backends agree: {ids:?}"
    );
    let card = |t: u32| t / 2;
    let first = ids.into_iter().next().unwrap();
    first
        .into_iter()
        .map(|(end, on)| {
            (
                (end != SKY).then(|| card(end)),
                on.into_iter().map(card).collect(),
            )
        })
        .collect()
}

#[test]
fn line_ends_at_blocking_texel_and_passes_open_texel() {
    // Two fences whose open halves do not overlap, glass before and between them, and a wall.
    let scene = Cards::default()
        .card(1.0, GLASS, false)
        .card(2.0, LOW, false)
        .card(3.0, GLASS, false)
        .card(4.0, HIGH, false)
        .card(5.0, WALL, false)
        .scene();
    assert_eq!(scene.kinds().kind(TriangleId(2)), SurfaceKind::Masked);
    // For large y the first fence blocks, for small y the second. No line reaches the wall.
    let low = (Some(3), vec![0, 2]);
    let high = (Some(1), vec![0]);
    let shown = along_x(&scene, &[[1.0, 0.5], [1.9, 3.5], [2.1, 0.7], [3.9, 3.3]]);
    assert_eq!(shown, [low.clone(), low, high.clone(), high]);
    // An open fence in front of the wall. Lines through its holes do not show it.
    let scene = Cards::default()
        .card(2.0, LOW, false)
        .card(5.0, WALL, false)
        .scene();
    let shown = along_x(&scene, &[[1.0, 0.5], [3.0, 0.5]]);
    assert_eq!(shown, [(Some(1), vec![]), (Some(0), vec![])]);
    // Many fences in a row, and no triangle beyond them.
    let many = (0..20)
        .fold(Cards::default(), |cards, i| {
            cards.card(1.0 + i as f32 / 4.0, LOW, i % 2 == 0)
        })
        .scene();
    let shown = along_x(&many, &[[1.0, 0.5], [3.0, 0.5]]);
    assert_eq!(shown, [(None, vec![]), (Some(0), vec![])]);
}

#[test]
fn coincident_fences_block_where_either_blocks() {
    // The same texture twice, as for cards with two sides, and another texture at the same position.
    let scene = Cards::default()
        .card(2.0, LOW, false)
        .card(2.0, LOW, true)
        .card(2.0, CHEQUERED, false)
        .card(5.0, WALL, false)
        .scene();
    // Below 2 only the chequered card blocks. Above 2 both fences block, and the chequered card in some
    // places.
    let shown = along_x(&scene, &[[0.5, 0.3], [1.5, 0.6], [2.5, 0.4], [3.5, 0.3]]);
    let (wall, chequered) = ((Some(3), vec![]), (Some(2), vec![]));
    assert_eq!(
        shown,
        [chequered, wall, (Some(0), vec![1, 2]), (Some(0), vec![1])]
    );
}

#[test]
fn poster_in_plane_of_wall_is_shown_with_wall() {
    let scene = Cards::default()
        .card(2.0, WALL, false)
        .card(2.0, LOW, false)
        .scene();
    let shown = along_x(&scene, &[[1.0, 0.5], [3.0, 0.5]]);
    assert_eq!(shown, [(Some(0), vec![]), (Some(0), vec![1])]);
}

#[test]
fn backends_agree_on_lines_through_chequered_fences() {
    let scene = Cards::default()
        .card(1.0, CHEQUERED, false)
        .card(2.5, CHEQUERED, true)
        .card(4.0, GLASS, false)
        .card(5.0, WALL, false)
        .scene();
    let mut random = Hashed::new(&[23]);
    let lines: Vec<([f32; 3], [f32; 3])> = (0..20_000)
        .map(|_| {
            let [y, z] = [0; 2].map(|_| 0.5 + 3.0 * random.unit());
            let [v, w] = [0; 2].map(|_| random.unit() - 0.5);
            ([-0.5, y, z], [1.0, v, w])
        })
        .collect();
    // Computed in f64: the first card whose square at the crossing is closed.
    let end = |(o, d): &([f32; 3], [f32; 3])| {
        let at = |x: f64| [1, 2].map(|a| f64::from(o[a]) + f64::from(d[a]) * (x + 0.5));
        let inside = |x: f64| at(x).iter().all(|c| (0.0..4.0).contains(c));
        let closed =
            |x: f64| inside(x) && at(x).iter().map(|c| c.floor() as i64).sum::<i64>() % 2 == 0;
        match (closed(1.0), closed(2.5), inside(5.0)) {
            (true, ..) => Some(0),
            (_, true, _) => Some(1),
            (.., true) => Some(3),
            _ => None,
        }
    };
    let truth: Vec<Option<u32>> = lines.iter().map(end).collect();
    assert!(
        [Some(0), Some(1), Some(3), None]
            .iter()
            .all(|e| truth.iter().filter(|t| *t == e).count() > 300)
    );
    for backend in backends(&scene) {
        for each in [false, true] {
            let shown = traced(&*backend, &scene, &lines, each);
            let ends = shown.iter().map(|s| (s.0 != SKY).then_some(s.0 / 2));
            // Lines that graze the border of a card may differ in single precision.
            let other = ends
                .zip(&truth)
                .filter(|(end, truth)| end != *truth)
                .count();
            assert!(other <= 2, "{other} lines of {}", backend.profile());
            for (shown, truth) in shown.iter().zip(&truth) {
                if *truth == Some(1) {
                    assert!(
                        shown.2.is_empty() && (shown.1 - 3.0).abs() < 1e-5,
                        "{shown:?}"
                    );
                }
            }
        }
    }
}
