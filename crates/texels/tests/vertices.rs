//! Values at vertices against functions of the position that they must follow.

#![allow(clippy::unwrap_used, reason = "tests")]

mod support;

use serde_json::json;
use sightline_texels::{Plan, Settings, Target, Value};
use support::{Maker, Read, cube_primitive, scene, written};

const VERTICES: Settings = Settings {
    target: Target::Vertices,
    size: sightline_texels::Size::Resolution(16),
    coordinates: sightline_texels::Coordinates::Any,
    bits: sightline_texels::Bits::Sixteen,
};

/// A grid of squares of different sizes in the plane z = 0.
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
fn a_linear_function_is_found_exactly() {
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
fn what_is_inside_does_not_count() {
    let glb = grid(6).glb();
    let scene = scene(&glb);
    let plan = Plan::new("test.glb", &glb, None, &scene, &VERTICES).unwrap();
    let values: Vec<Value> = plan
        .receivers()
        .iter()
        .map(|r| Value {
            open: if r.point.x < 2.0 { 0.0 } else { 0.5 },
            inside: r.point.x < 2.0,
        })
        .collect();
    let read = Read::new(&plan.write(&values).unwrap().glb);
    let values = read.attribute(0, 0, "_OCCLUSION");
    assert!(values.iter().all(|v| (v - 0.5).abs() < 0.01), "{values:?}");
    // All inside: nothing is known, and nothing is dark.
    let none = vec![
        Value {
            open: 0.0,
            inside: true
        };
        plan.receivers().len()
    ];
    let read = Read::new(&plan.write(&none).unwrap().glb);
    assert!(read.attribute(0, 0, "_OCCLUSION").iter().all(|v| *v == 1.0));
}

#[test]
fn shared_vertices_of_a_cube_have_one_value_each() {
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
    // Vertices 4 to 7 are on top: between the two.
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
fn vertices_that_a_seam_splits_have_the_same_value() {
    let mut maker = Maker::new();
    // Two triangles of a square with vertices of their own, whose coordinates differ.
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
fn colours_of_the_user_stay() {
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
