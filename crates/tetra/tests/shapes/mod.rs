//! Shapes that are hard to divide into tetrahedra.

/// A triangle.
pub type T = [[f32; 3]; 3];

/// Returns Schönhardt's polyhedron, which cannot be divided into tetrahedra without another point.
pub fn schonhardt() -> Vec<T> {
    let ring = |z: f32, turn: f32| {
        [0.0f32, 1.0, 2.0].map(|k| {
            let angle = (k * 120.0 + turn).to_radians();
            [angle.cos(), angle.sin(), z]
        })
    };
    let (a, b) = (ring(0.0, 0.0), ring(1.0, 30.0));
    let mut triangles = vec![a, b];
    for i in 0..3 {
        let j = (i + 1) % 3;
        triangles.push([a[i], a[j], b[j]]);
        triangles.push([a[i], b[j], b[i]]);
    }
    triangles
}

/// Returns triangles at the edges of two rulings of a saddle, close to each other, after Chazelle.
pub fn saddle() -> Vec<T> {
    let mut triangles = Vec::new();
    for i in -2..=2 {
        let s = i as f32;
        let (p, q) = ([-3.0, s, -3.0 * s + 0.01], [3.0, s, 3.0 * s + 0.01]);
        triangles.push([p, q, [0.0, s, 20.0]]);
        let (p, q) = ([s, -3.0, -3.0 * s - 0.01], [s, 3.0, 3.0 * s - 0.01]);
        triangles.push([p, q, [s, 0.0, -20.0]]);
    }
    triangles
}

/// Returns four cubes on a lattice, moved and scaled.
pub fn lattice_of_cubes(scale: f32, shift: f32) -> Vec<T> {
    let mut triangles = Vec::new();
    for k in 0..4 {
        let at = [(k & 1) as f32 * 2.0, (k >> 1) as f32 * 2.0, 0.0];
        for axis in 0..3 {
            for side in [0.0f32, 1.0] {
                let p = |u: f32, v: f32| {
                    let mut p = at;
                    p[axis] += side;
                    p[(axis + 1) % 3] += u;
                    p[(axis + 2) % 3] += v;
                    p.map(|x| x * scale + shift)
                };
                triangles.push([p(0.0, 0.0), p(1.0, 0.0), p(1.0, 1.0)]);
                triangles.push([p(0.0, 0.0), p(1.0, 1.0), p(0.0, 1.0)]);
            }
        }
    }
    triangles
}
