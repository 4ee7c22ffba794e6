//! The receivers of a texture: one for each piece, the part of a triangle within one texel.
//!
//! The receiver of a piece is the centroid of the piece, and its weight is the area of the piece on the
//! surface. So the weighted mean of a texel's receivers is exact for a value that is linear on each piece.

use rayon::prelude::*;
use sightline_scene::{Scene, Triangle, TriangleId};

use crate::atlas::Atlas;
use crate::error::MOST_RECEIVERS;
use crate::kept_coordinates::area;
use crate::overlap::FlatTriangle;
use crate::parts::PrimitiveInstances;
use crate::receivers::Receiver;
use crate::welds::cross;

/// The part of a triangle within one texel.
#[derive(Clone, Copy, Debug)]
struct TexelPiece {
    receiver: Receiver,
    /// The index of the texel, row by row from the upper left corner of the image.
    texel: u32,
    /// The area of the piece on the surface, in squared units of the scene.
    weight: f64,
}

/// The receivers of a texture, with the texel and the area of each.
#[derive(Clone, Debug, Default)]
pub(crate) struct TexelPieces {
    /// The receivers, one for each piece.
    pub receivers: Vec<Receiver>,
    /// The index of each receiver's texel, row by row from the upper left corner of the image.
    pub texels: Vec<u32>,
    /// The area of each receiver's piece on the surface, in squared units of the scene.
    pub weights: Vec<f64>,
}

/// Minimum area of a piece in the image, in squared texels. Smaller pieces are ignored.
const SMALLEST: f64 = 1e-9;
/// The number of triangles whose pieces are computed in one step.
const AT_ONCE: usize = 4096;

/// Computes the pieces of all primitives, in the order of the scene's triangles. Returns `None` if there are
/// more pieces than [`MOST_RECEIVERS`].
pub(crate) fn pieces(
    scene: &Scene,
    parts: &PrimitiveInstances,
    atlas: &Atlas,
) -> Option<TexelPieces> {
    let mut all = TexelPieces::default();
    for part in &parts.all {
        let triangles = &scene.triangles()[part.first as usize..][..part.corners.len()];
        for (chunk, first) in triangles
            .chunks(AT_ONCE)
            .zip((part.first..).step_by(AT_ONCE))
        {
            let made: Vec<Vec<TexelPiece>> = chunk
                .par_iter()
                .zip(first..first + chunk.len() as u32)
                .map(|(triangle, id)| {
                    of_triangle(
                        triangle,
                        id,
                        part.front,
                        &atlas.triangles[id as usize],
                        atlas.size,
                    )
                })
                .collect();
            if all.receivers.len() + made.iter().map(Vec::len).sum::<usize>() > MOST_RECEIVERS {
                return None;
            }
            for piece in made.into_iter().flatten() {
                all.receivers.push(piece.receiver);
                all.texels.push(piece.texel);
                all.weights.push(piece.weight);
            }
        }
    }
    Some(all)
}

/// Computes the pieces of triangle `id` of the scene.
///
/// `front` is 1, or -1 if the transform to world space mirrors. `flat` contains the triangle's corners in the
/// image, and `size` is the width and height of the image, both in texels.
fn of_triangle(
    triangle: &Triangle,
    id: u32,
    front: f64,
    flat: &FlatTriangle,
    size: [u32; 2],
) -> Vec<TexelPiece> {
    let (whole, across) = (area(flat), cross(triangle));
    let surface = 0.5 * across.length();
    if triangle.is_degenerate() || whole == 0.0 || surface == 0.0 {
        return Vec::new();
    }
    let normal = across.normalize() * front;
    let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
    let mut all = Vec::new();
    let outline = Outline::from_triangle(flat);
    for y in cells(&outline, 1, size[1]) {
        let row = outline.between(1, y);
        for x in cells(&row, 0, size[0]) {
            let Some((piece, centre)) = row.between(0, x).measure().filter(|m| m.0 > SMALLEST)
            else {
                continue;
            };
            // The barycentric coordinates of the centre, from the areas of the three triangles into which the
            // centre divides the triangle.
            let at =
                |k: usize, l: usize| (area(&[flat[k], flat[l], centre]) / whole).clamp(0.0, 1.0);
            let (second, third) = (at(2, 0), at(0, 1));
            let rest = (1.0 - second - third).max(0.0);
            let point = (a * rest + b * second + c * third) / (rest + second + third);
            let receiver = Receiver {
                point,
                normal,
                triangle: TriangleId(id),
            };
            let weight = surface * piece / (0.5 * whole.abs());
            all.push(TexelPiece {
                receiver,
                texel: y * size[0] + x,
                weight,
            });
        }
    }
    all
}

/// Returns the range of texel columns (axis 0) or texel rows (axis 1) that a polygon touches. `size` is the
/// number of columns or rows of the image.
fn cells(outline: &Outline, axis: usize, size: u32) -> std::ops::Range<u32> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for p in outline.points() {
        (low, high) = (low.min(p[axis]), high.max(p[axis]));
    }
    // A polygon without corners has an empty range.
    low.floor().max(0.0) as u32..(high.ceil().max(0.0) as u32).min(size)
}

/// A convex polygon in the image, in texels: a triangle, cut by at most four lines.
#[derive(Clone, Copy)]
struct Outline {
    corners: [[f64; 2]; 8],
    count: usize,
}

impl Outline {
    fn from_triangle(flat: &FlatTriangle) -> Self {
        let mut corners = [[0.0; 2]; 8];
        corners[..3].copy_from_slice(flat);
        Self { corners, count: 3 }
    }

    fn points(&self) -> &[[f64; 2]] {
        &self.corners[..self.count]
    }

    /// Returns the part of the polygon whose coordinate on `axis` is from `cell` to `cell` + 1.
    fn between(&self, axis: usize, cell: u32) -> Self {
        let low = f64::from(cell);
        self.cut(axis, low, 1.0).cut(axis, low + 1.0, -1.0)
    }

    /// Returns the part of the polygon on one side of the line on which the coordinate on `axis` is `at`: the
    /// side of larger coordinates if `side` is 1, or of smaller coordinates if `side` is -1.
    fn cut(&self, axis: usize, at: f64, side: f64) -> Self {
        let mut out = Self {
            corners: [[0.0; 2]; 8],
            count: 0,
        };
        let mut push = |p: [f64; 2]| {
            // A cut adds at most one corner to a convex polygon. If rounding adds more, drop them.
            if let Some(slot) = out.corners.get_mut(out.count) {
                *slot = p;
                out.count += 1;
            }
        };
        let points = self.points();
        for (i, p) in points.iter().enumerate() {
            let q = &points[(i + 1) % points.len()];
            let (dp, dq) = ((p[axis] - at) * side, (q[axis] - at) * side);
            if dp >= 0.0 {
                push(*p);
            }
            if (dp > 0.0 && dq < 0.0) || (dp < 0.0 && dq > 0.0) {
                let t = dp / (dp - dq);
                let mut cut = [0, 1].map(|k| p[k] + (q[k] - p[k]) * t);
                cut[axis] = at;
                push(cut);
            }
        }
        out
    }

    /// Computes the area and the centroid of the polygon. Returns `None` if the area is 0.
    fn measure(&self) -> Option<(f64, [f64; 2])> {
        let points = self.points();
        let first = points.first()?;
        let (mut total, mut sum) = (0.0, [0.0; 2]);
        for pair in points[1..].windows(2) {
            let part = area(&[*first, pair[0], pair[1]]);
            total += part;
            for k in 0..2 {
                // Coordinates relative to the first corner keep their precision far from the origin.
                sum[k] += part * (pair[0][k] + pair[1][k] - 2.0 * first[k]);
            }
        }
        (total != 0.0).then(|| {
            (
                0.5 * total.abs(),
                [0, 1].map(|k| first[k] + sum[k] / (3.0 * total)),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn pieces_have_area_and_centroid_of_triangle() {
        let flat = [[0.3, 7.9], [11.7, 2.2], [5.1, 0.4]];
        let triangle = Triangle {
            v: flat.map(|[x, y]| Vec3::new(x as f32, 3.0, -y as f32)),
        };
        let pieces = of_triangle(&triangle, 7, 1.0, &flat, [12, 8]);
        let total: f64 = pieces.iter().map(|p| p.weight).sum();
        assert!((total - 0.5 * cross(&triangle).length()).abs() < 1e-9);
        let centre = pieces
            .iter()
            .map(|p| p.receiver.point * p.weight)
            .sum::<glam::DVec3>()
            / total;
        let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
        assert!((centre - (a + b + c) / 3.0).length() < 1e-6);
        for p in &pieces {
            let (x, y) = (f64::from(p.texel % 12), f64::from(p.texel / 12));
            let at = p.receiver.point;
            assert!(
                (x - 1e-5..=x + 1.00001).contains(&at.x)
                    && (y - 1e-5..=y + 1.00001).contains(&-at.z)
            );
            assert!(p.weight <= 1.0 + 1e-6);
        }
    }
}
