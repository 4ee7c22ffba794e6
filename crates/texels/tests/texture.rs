//! Texels compared with the known means of functions of the position.

#![allow(clippy::unwrap_used, reason = "tests")]

mod support;

use glam::DVec3;
use serde_json::json;
use sightline_texels::{BitDepth, Plan, ReceiverValue, Settings, TexCoordSource, TextureSize};
use support::{Maker, Read, cube_primitive, scene, written};

fn settings(side: u32) -> Settings {
    Settings {
        size: TextureSize::Resolution(side),
        bits: BitDepth::Sixteen,
        ..Settings::default()
    }
}

/// Creates a square of 8 x 8 in the plane z = 0 whose `TEXCOORD_1` covers the image, or half of this square.
fn plane(half: bool) -> Maker {
    let mut maker = Maker::new();
    let positions = maker.floats("VEC3", &[0., 0., 0., 8., 0., 0., 0., 8., 0., 8., 8., 0.]);
    let uv = maker.floats("VEC2", &[0., 0., 1., 0., 0., 1., 1., 1.]);
    let other = maker.floats("VEC2", &[0., 0., 9., 0., 0., 9., 9., 9.]);
    let indices = maker.indices(if half {
        &[0, 1, 2]
    } else {
        &[0, 1, 2, 2, 1, 3]
    });
    let attributes = json!({ "POSITION": positions, "TEXCOORD_0": other, "TEXCOORD_1": uv });
    let mesh = maker.mesh(json!({ "attributes": attributes, "indices": indices }));
    maker.node(json!({ "mesh": mesh }));
    maker
}

#[test]
fn texel_is_mean_over_its_part() {
    let f = |x: f64, y: f64| (x + 2.0 * y) / 32.0;
    for half in [false, true] {
        let glb = plane(half).glb();
        let made = written(&glb, &settings(16), |p, n| {
            assert_eq!(n, DVec3::Z);
            f(p.x, p.y)
        });
        assert_eq!(
            (made.facts.kept, made.facts.texels),
            (1, if half { 136 } else { 256 })
        );
        let read = Read::new(&made.glb);
        let image = read.image();
        for y in 0..16 {
            for x in 0..16 {
                // On the long side of the half square, texels are half covered.
                let middle = match (half, x + y) {
                    (true, 16..) => continue,
                    (true, 15) => 1.0 / 3.0,
                    _ => 0.5,
                };
                let expected = f((x as f64 + middle) / 2.0, (y as f64 + middle) / 2.0);
                let value = image.values[y * 16 + x];
                assert!(
                    (value - expected).abs() < 2e-5,
                    "{half} {x} {y}: {value} for {expected}"
                );
            }
        }
        // The coordinates are unchanged.
        let before = Read::new(&glb);
        assert_eq!(
            read.attribute(0, 0, "TEXCOORD_1"),
            before.attribute(0, 0, "TEXCOORD_1")
        );
        let material = &read.json["materials"][0]["occlusionTexture"];
        assert_eq!(
            *material,
            json!({ "index": 0, "texCoord": 1, "strength": 1 })
        );
    }
}

#[test]
fn texel_size_determines_image_size() {
    let glb = plane(false).glb();
    let scene = scene(&glb);
    for (coordinates, least, most) in [
        (TexCoordSource::Keep, 32, 32),
        (TexCoordSource::Unwrap, 32, 48),
    ] {
        let settings = Settings {
            size: TextureSize::Texel(0.25),
            coordinates,
            ..Settings::default()
        };
        let plan = Plan::new("test.glb", &glb, None, &scene, &settings).unwrap();
        let [width, height] = plan.image_size().unwrap();
        assert!(
            (least..=most).contains(&width) && (least..=most).contains(&height),
            "{width} x {height}"
        );
        let fully = plan.receivers().len();
        assert!((32 * 32..=36 * 36 + 200).contains(&fully), "{fully}");
    }
}

/// Returns the values at the midpoints of the quarters of each edge, from each of its two triangles.
fn edge_differences(read: &Read, scene: &sightline_scene::Scene) -> Vec<(f64, f64)> {
    let (image, uv) = (read.image(), read.coordinates(0, 0));
    let mut edges: Vec<([u32; 6], u32, f64, DVec3)> = Vec::new();
    for (triangle, uv) in scene.triangles().iter().zip(&uv) {
        let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
        let normal = (b - a).cross(c - a).normalize();
        for k in 0..3 {
            let mut ends = [
                (triangle.v[k], uv[k]),
                (triangle.v[(k + 1) % 3], uv[(k + 1) % 3]),
            ];
            let bits = |v: glam::Vec3| v.to_array().map(f32::to_bits);
            ends.sort_by_key(|e| bits(e.0));
            let (p, q) = (bits(ends[0].0), bits(ends[1].0));
            for quarter in 0..4u32 {
                let t = (f64::from(quarter) + 0.5) / 4.0;
                let at = [0, 1].map(|i| ends[0].1[i] + (ends[1].1[i] - ends[0].1[i]) * t);
                edges.push((
                    [p[0], p[1], p[2], q[0], q[1], q[2]],
                    quarter,
                    image.at(at),
                    normal,
                ));
            }
        }
    }
    edges.sort_by_key(|e| (e.0, e.1));
    let pairs = edges
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .filter(|c| c.len() == 2);
    pairs
        .map(|c| ((c[0].2 - c[1].2).abs(), c[0].3.dot(c[1].3)))
        .collect()
}

#[test]
fn both_sides_of_seam_agree() {
    let mut maker = Maker::new();
    let primitive = cube_primitive(&mut maker);
    let mesh = maker.mesh(primitive);
    maker.node(json!({ "mesh": mesh }));
    let glb = maker.glb();
    // A function of the position is continuous across the edges of a cube.
    let made = written(&glb, &settings(128), |p, _| {
        0.5 + 0.2 * (3.0 * p.x + 2.0 * p.y - p.z).sin()
    });
    assert!(
        made.facts.charts >= 6 && made.facts.unwrapped == 1,
        "{:?}",
        made.facts
    );
    let differences = edge_differences(&Read::new(&made.glb), &scene(&glb));
    assert_eq!(differences.len(), 18 * 4);
    for (difference, _) in differences {
        // The difference is at most the change of the function within a texel.
        assert!(difference < 0.75 * 3.0 / 40.0 * 0.75, "{difference}");
    }
}

#[test]
fn seams_of_round_surface_are_closed() {
    // A sphere of few faces, whose values differ from texel to texel.
    let mut maker = Maker::new();
    let (across, down) = (24u16, 12u16);
    let mut positions = Vec::new();
    for i in 0..=down {
        for j in 0..across {
            let (a, b) = (
                f64::from(i) / f64::from(down),
                f64::from(j) / f64::from(across),
            );
            let (polar, round) = (a * std::f64::consts::PI, b * std::f64::consts::TAU);
            let at = [
                polar.sin() * round.cos(),
                polar.sin() * round.sin(),
                polar.cos(),
            ];
            positions.extend(at.map(|c| {
                if i == 0 || i == down {
                    (c as f32).round()
                } else {
                    c as f32
                }
            }));
        }
    }
    let mut indices = Vec::new();
    for i in 0..down {
        for j in 0..across {
            let at = |i: u16, j: u16| i * across + j % across;
            indices.extend([
                at(i, j),
                at(i + 1, j),
                at(i + 1, j + 1),
                at(i, j),
                at(i + 1, j + 1),
                at(i, j + 1),
            ]);
        }
    }
    let (positions, indices) = (maker.floats("VEC3", &positions), maker.indices(&indices));
    let mesh = maker.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    maker.node(json!({ "mesh": mesh }));
    let glb = maker.glb();
    let made = written(&glb, &settings(128), |p, _| {
        0.5 + 0.4 * (5.0 * p.x).sin() * (4.0 * p.y + p.z).cos()
    });
    assert!(made.facts.seams > 20, "{:?}", made.facts);
    let smooth: Vec<f64> = edge_differences(&Read::new(&made.glb), &scene(&glb))
        .into_iter()
        .filter(|d| d.1 > 0.71)
        .map(|d| d.0)
        .collect();
    let largest = smooth.iter().copied().fold(0.0, f64::max);
    // The difference is below one step of 8 bits. Without closed seams it is ten times as large.
    assert!(
        smooth.len() > 2000 && largest < 1.0 / 255.0,
        "{} {largest}",
        smooth.len()
    );
}

#[test]
fn fronts_follow_transform() {
    for scale in [[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [-1, -1, -1]] {
        let mut maker = Maker::new();
        let primitive = cube_primitive(&mut maker);
        let mesh = maker.mesh(primitive);
        let child = maker.push("nodes", json!({ "mesh": mesh, "scale": scale }));
        maker.node(json!({ "children": [child], "translation": [5, 6, 7] }));
        let glb = maker.glb();
        let scene = scene(&glb);
        let bounds = scene.bounds();
        let middle = (bounds.min + bounds.max).as_dvec3() * 0.5;
        let plan = Plan::new("test.glb", &glb, None, &scene, &settings(64)).unwrap();
        for r in plan.receivers() {
            assert!(r.normal.dot(r.point - middle) > 0.49, "{scale:?}");
            assert!((r.normal.length() - 1.0).abs() < 1e-12);
        }
    }
}

#[test]
fn inside_texels_get_values_of_neighbours() {
    let glb = plane(false).glb();
    let scene = scene(&glb);
    let plan = Plan::new("test.glb", &glb, None, &scene, &settings(16)).unwrap();
    let values = plan.receivers().iter();
    // A wall is on the plane; below the wall everything is dark.
    let values: Vec<ReceiverValue> = values
        .map(|r| {
            let inside = (2.0..4.0).contains(&r.point.x);
            ReceiverValue {
                open: if inside { 0.0 } else { 0.75 },
                inside,
            }
        })
        .collect();
    let made = plan.write(&values).unwrap();
    assert_eq!((made.facts.inside, made.facts.texels), (64, 192));
    let image = Read::new(&made.glb).image();
    assert!(
        image.values.iter().all(|v| (v - 0.75).abs() < 1e-4),
        "dark comes through"
    );
}

#[test]
fn output_is_deterministic() {
    let mut maker = Maker::new();
    let primitive = cube_primitive(&mut maker);
    let mesh = maker.mesh(primitive);
    maker.node(json!({ "mesh": mesh }));
    let glb = maker.glb();
    let make = || written(&glb, &settings(64), |p, _| 0.3 + 0.5 * p.x * p.y).glb;
    assert!(make() == make());
}
