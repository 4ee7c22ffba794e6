//! The occluders of a masked triangle: the convex polygons of the triangle under opaque texels of its mask.

use glam::DVec3;
use sightline_scene::masks::{Coordinates, Mask};

/// Maximum number of texels under all masked triangles of a scene. A texture with more repetitions is not a
/// mask of leaves or wires.
const MOST_TEXELS: f64 = 16_777_216.0;

/// A corner of a masked triangle: its position, and its texture coordinates in texels.
#[derive(Clone, Copy)]
struct MaskedCorner {
    at: DVec3,
    texel: [f64; 2],
}

/// Computes the polygons of a triangle, with the corners `v`, under blocking texels. Each polygon is under a
/// rectangle of texels: neighbouring texels of a row are joined, and then rows of equal extent.
///
/// Adds the number of texels in the rectangle around the triangle to `texels`. Returns `None` if the sum
/// exceeds [`MOST_TEXELS`].
pub fn polygons(
    v: [DVec3; 3],
    mask: &Mask,
    coordinates: &Coordinates,
    texels: &mut f64,
) -> Option<Vec<Vec<DVec3>>> {
    let size = mask.size().map(f64::from);
    let corners: [MaskedCorner; 3] = std::array::from_fn(|k| {
        let texel = std::array::from_fn(|a| f64::from(coordinates[k][a]) * size[a]);
        MaskedCorner { at: v[k], texel }
    });
    let range = |a: usize| {
        let (min, max) = corners
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), c| {
                (l.min(c.texel[a]), m.max(c.texel[a]))
            });
        (min.floor(), (max.floor() + 1.0 - min.floor()).max(1.0))
    };
    let ((x0, width), (y0, height)) = (range(0), range(1));
    *texels += width * height;
    let few = *texels <= MOST_TEXELS;
    if !few {
        return None;
    }
    let blocks = |x: f64, y: f64| mask.blocks([(x + 0.5) / size[0], (y + 0.5) / size[1]]);
    let mut found = Vec::new();
    // The runs of blocking texels in the previous row: first column, last column plus 1, and the row in which
    // the rectangle of the run begins.
    let mut open: Vec<([f64; 2], f64)> = Vec::new();
    for row in 0..=height as u32 {
        let y = y0 + f64::from(row);
        let mut runs: Vec<[f64; 2]> = Vec::new();
        for column in 0..(if f64::from(row) < height {
            width as u32
        } else {
            0
        }) {
            let x = x0 + f64::from(column);
            match runs.last_mut() {
                _ if !blocks(x, y) => {}
                Some(run) if run[1] == x => run[1] = x + 1.0,
                _ => runs.push([x, x + 1.0]),
            }
        }
        let (goes_on, ends): (Vec<_>, Vec<_>) =
            open.into_iter().partition(|(run, _)| runs.contains(run));
        found.extend(
            ends.into_iter()
                .filter_map(|(run, begun)| cut(&corners, run, [begun, y])),
        );
        open = goes_on;
        for run in runs {
            if !open.iter().any(|(other, _)| *other == run) {
                open.push((run, y));
            }
        }
    }
    Some(found)
}

/// Computes the part of a triangle under the texels from `x[0]` to `x[1]` and from `y[0]` to `y[1]`. Returns
/// `None` if the part has no area.
fn cut(triangle: &[MaskedCorner; 3], x: [f64; 2], y: [f64; 2]) -> Option<Vec<DVec3>> {
    let mut polygon = triangle.to_vec();
    for (axis, [from, to]) in [(0, x), (1, y)] {
        for (sign, bound) in [(1.0, from), (-1.0, to)] {
            let over = |c: &MaskedCorner| sign * (c.texel[axis] - bound);
            let mut left = Vec::with_capacity(polygon.len() + 1);
            for (k, c) in polygon.iter().enumerate() {
                let d = polygon[if k + 1 == polygon.len() { 0 } else { k + 1 }];
                let (p, q) = (over(c), over(&d));
                if p >= 0.0 {
                    left.push(*c);
                }
                if (p > 0.0 && q < 0.0) || (p < 0.0 && q > 0.0) {
                    let t = p / (p - q);
                    let mut texel = [0, 1].map(|a| c.texel[a] + (d.texel[a] - c.texel[a]) * t);
                    texel[axis] = bound;
                    left.push(MaskedCorner {
                        at: c.at + (d.at - c.at) * t,
                        texel,
                    });
                }
            }
            polygon = left;
        }
    }
    let at: Vec<DVec3> = polygon.into_iter().map(|c| c.at).collect();
    let area: DVec3 = at
        .get(1..)?
        .windows(2)
        .map(|w| (w[0] - at[0]).cross(w[1] - at[0]))
        .sum();
    (at.len() > 2 && area != DVec3::ZERO).then_some(at)
}
