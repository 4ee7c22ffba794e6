//! A small house as OBJ: two rooms of 2×2×2 in a row, and what stands between and in them.

use std::fmt::Write as _;

/// A rectangle by its corners in order.
pub type Quad = [[f32; 3]; 4];

/// The shell of the house from 0,0,0 to 4,2,2, in six objects of two triangles each (floor, ceiling, north,
/// south, west, east), and then an object of two triangles for each named rectangle.
pub fn house(inside: &[(&str, Quad)]) -> String {
    let level = |y: f32| [[0.0, y, 0.0], [4.0, y, 0.0], [4.0, y, 2.0], [0.0, y, 2.0]];
    let long = |z: f32| [[0.0, 0.0, z], [4.0, 0.0, z], [4.0, 2.0, z], [0.0, 2.0, z]];
    let shell = [
        ("floor", level(0.0)),
        ("ceiling", level(2.0)),
        ("north", long(0.0)),
        ("south", long(2.0)),
        ("west", across(0.0, [0.0, 2.0], [0.0, 2.0])),
        ("east", across(4.0, [0.0, 2.0], [0.0, 2.0])),
    ];
    let mut out = String::new();
    for (number, (name, corners)) in shell.iter().chain(inside).enumerate() {
        writeln!(out, "o {name}").unwrap();
        corners
            .iter()
            .for_each(|[x, y, z]| writeln!(out, "v {x} {y} {z}").unwrap());
        let [a, b, c, d] = [1, 2, 3, 4].map(|k| 4 * number + k);
        writeln!(out, "f {a} {b} {c}\nf {a} {c} {d}").unwrap();
    }
    out
}

/// A rectangle across x, from the least to the greatest y and z.
pub fn across(x: f32, y: [f32; 2], z: [f32; 2]) -> Quad {
    [
        [x, y[0], z[0]],
        [x, y[1], z[0]],
        [x, y[1], z[1]],
        [x, y[0], z[1]],
    ]
}
