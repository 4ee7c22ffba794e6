//! A small house as OBJ: two rooms of 2×2×2 in a row, with given rectangles.

use std::fmt::Write as _;

/// A rectangle, as its corners in order.
pub type Quad = [[f32; 3]; 4];

/// Returns the shell of a house from 0,0,0 to 4,2,2, followed by the named rectangles. The shell has six
/// objects of two triangles each (floor, ceiling, north, south, west, east). Each rectangle is an object of
/// two triangles.
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

/// Returns a rectangle across the x axis, from the minimum to the maximum y and z.
pub fn across(x: f32, y: [f32; 2], z: [f32; 2]) -> Quad {
    [
        [x, y[0], z[0]],
        [x, y[1], z[0]],
        [x, y[1], z[1]],
        [x, y[0], z[1]],
    ]
}
