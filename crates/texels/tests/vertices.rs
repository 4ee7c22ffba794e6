//! Values at vertices compared with functions of the position.

#![allow(clippy::unwrap_used, reason = "tests")]

mod support;

use serde_json::json;
use sightline_texels::{Plan, ReceiverValue, Settings, ValueTarget};
use support::{Maker, Read, cube_primitive, scene, written};

const VERTICES: Settings = Settings {
    target: ValueTarget::Vertices,
    size: sightline_texels::TextureSize::Resolution(16),
    coordinates: sightline_texels::TexCoordSource::Any,
    bits: sightline_texels::BitDepth::Sixteen,
};

/// Creates a grid of squares of different sizes in the plane z = 0.
fn grid(n: u16) -> Maker {
    let mut maker = Maker::new();
    let at = |i: u16| f32::from(i) * f32::from(i + 3) / 8.0;
    let positions: Vec<f32> = (0..=n)
        .flat_map(|j| (0..=n).flat_map(move |i| [at(i), at(j), 0.0]))
        .collect();
    let mut indices = Vec::new();
    for j in 0..n {
        for i in 0..n {
            let v = |i: u16, j: u16| j * (n + 1) + i;
            indices.extend([
                v(i, j),
                v(i + 1, j),
                v(i + 1, j + 1),
                v(i, j),
                v(i + 1, j + 1),
                v(i, j + 1),
            ]);
        }
    }
    let (positions, indices) = (maker.floats("VEC3", &positions), maker.indices(&indices));
    let mesh = maker.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    maker.node(json!({ "mesh": mesh }));
    maker
}

#[test]
fn linear_function_is_fitted_exactly() {
    let glb = grid(7).glb();
    let f = |x: f64, y: f64| 0.1 + 0.04 * x + 0.03 * y;
    let made = written(&glb, &VERTICES, |p, _| f(p.x, p.y));
    let read = Read::new(&made.glb);
    let (positions, values) = (
        read.attribute(0, 0, "POSITION"),
        read.attribute(0, 0, "_OCCLUSION"),
    );
    assert_eq!((values.len(), made.facts.vertices), (64, 64));
    for (at, value) in positions.chunks(3).zip(&values) {
        assert!((value - f(at[0], at[1])).abs() < 1e-6, "{at:?}: {value}");
    }
    let colors = read.attribute(0, 0, "COLOR_0");
    for (color, value) in colors.chunks(4).zip(&values) {
        assert!(
            color[..3]
                .iter()
                .all(|c| (c / 65535.0 - value).abs() < 1e-5)
                && color[3] == 65535.0
        );
    }
}

#[test]
fn inside_receivers_are_ignored() {
    let glb = grid(6).glb();
    let scene = scene(&glb);
    let plan = Plan::new("test.glb", &glb, None, &scene, &VERTICES).unwrap();
    let values: Vec<ReceiverValue> = plan
        .receivers()
        .iter()
        .map(|r| ReceiverValue {
            open: if r.point.x < 2.0 { 0.0 } else { 0.5 },
            inside: r.point.x < 2.0,
        })
        .collect();
    let read = Read::new(&plan.write(&values).unwrap().glb);
    let values = read.attribute(0, 0, "_OCCLUSION");
    assert!(values.iter().all(|v| (v - 0.5).abs() < 0.01), "{values:?}");
    // All receivers are inside: the values are unknown, and all vertices are bright.
    let none = vec![
        ReceiverValue {
            open: 0.0,
            inside: true
        };
        plan.receivers().len()
    ];
    let read = Read::new(&plan.write(&none).unwrap().glb);
    assert!(read.attribute(0, 0, "_OCCLUSION").iter().all(|v| *v == 1.0));
}

#[test]
fn shared_vertices_of_cube_have_one_value() {
    let mut maker = Maker::new();
    let primitive = cube_primitive(&mut maker);
    let mesh = maker.mesh(primitive);
    maker.node(json!({ "mesh": mesh }));
    let made = written(
        &maker.glb(),
        &VERTICES,
        |_, n| if n.z > 0.5 { 1.0 } else { 0.4 },
    );
    let values = Read::new(&made.glb).attribute(0, 0, "_OCCLUSION");
    assert_eq!(values.len(), 8);
    // Vertices 4 to 7 are on top: their values are between the two.
    assert!(
        values[..4].iter().all(|v| (v - 0.4).abs() < 0.2),
        "{values:?}"
    );
    assert!(
        values[4..].iter().all(|v| (0.5..0.95).contains(v)),
        "{values:?}"
    );
}

#[test]
fn vertices_split_by_seam_have_equal_values() {
    let mut maker = Maker::new();
    // Two triangles of a square with separate vertices, whose texture coordinates differ.
    let positions = maker.floats(
        "VEC3",
        &[
            0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 1., 0., 1., 0., 0., 1., 1., 0.,
        ],
    );
    let normals = maker.floats("VEC3", &[0., 0., 1.].repeat(6));
    let uv = maker.floats("VEC2", &[0., 0., 1., 0., 0., 1., 5., 5., 6., 5., 6., 6.]);
    let attributes = json!({ "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uv });
    let mesh = maker.mesh(json!({ "attributes": attributes }));
    maker.node(json!({ "mesh": mesh }));
    let made = written(&maker.glb(), &VERTICES, |p, _| p.x * p.x * p.y + 0.1);
    let values = Read::new(&made.glb).attribute(0, 0, "_OCCLUSION");
    assert_eq!((values[2], values[1]), (values[3], values[4]));
}

#[test]
fn user_colours_stay_unchanged() {
    let mut maker = Maker::new();
    let mut primitive = cube_primitive(&mut maker);
    let colors = maker.floats("VEC3", &[0.25; 24]);
    primitive["attributes"]["COLOR_0"] = json!(colors);
    let mesh = maker.mesh(primitive);
    maker.node(json!({ "mesh": mesh }));
    let made = written(&maker.glb(), &VERTICES, |_, _| 0.5);
    let read = Read::new(&made.glb);
    assert_eq!(read.attribute(0, 0, "COLOR_0"), [0.25; 24]);
    assert!(
        (made.facts.colors_kept, made.notes.len()) == (1, 1) && made.notes[0].contains("COLOR_0")
    );
    assert!(
        read.attribute(0, 0, "_OCCLUSION")
            .iter()
            .all(|v| (v - 0.5).abs() < 1e-6)
    );
}
