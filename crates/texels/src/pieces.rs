//! The pieces of triangles in texels: the receivers of a texture.
//!
//! The receiver of a piece is the centre of its area, its weight the area of its part of the surface. So
//! the mean of the receivers of a texel is exact for a value that is linear on each piece.

use rayon::prelude::*;
use sightline_scene::{Scene, Triangle};

use crate::atlas::Atlas;
use crate::error::MOST_RECEIVERS;
use crate::kept::area;
use crate::overlap::Flat;
use crate::parts::Parts;
use crate::receivers::Receiver;
use crate::welds::cross;

/// A receiver, its texel and its area.
#[derive(Clone, Copy, Debug)]
struct Piece {
    receiver: Receiver,
    texel: u32,
    weight: f64,
}

/// Receivers, and for each the texel and the area.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pieces {
    /// The receivers.
    pub receivers: Vec<Receiver>,
    /// The texel of each, row by row from the upper left corner.
    pub texels: Vec<u32>,
    /// The area of each, in units of the scene.
    pub weights: Vec<f64>,
}

/// Pieces with less area in the image, in texels, count for nothing.
const SMALLEST: f64 = 1e-9;
/// Triangles whose pieces are made at a time.
const AT_ONCE: usize = 4096;

/// The pieces of all parts, in the order of triangles; none if there are too many.
pub(crate) fn pieces(scene: &Scene, parts: &Parts, atlas: &Atlas) -> Option<Pieces> {
    let mut all = Pieces::default();
    for part in &parts.all {
        let triangles = &scene.triangles()[part.first as usize..][..part.corners.len()];
        for (chunk, first) in triangles
            .chunks(AT_ONCE)
            .zip((part.first..).step_by(AT_ONCE))
        {
            let made: Vec<Vec<Piece>> = chunk
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

/// The pieces of a triangle of the scene, at `flat` in the image.
fn of_triangle(
    triangle: &Triangle,
    id: u32,
    front: f64,
    flat: &Flat,
    size: [u32; 2],
) -> Vec<Piece> {
    let (whole, across) = (area(flat), cross(triangle));
    let surface = 0.5 * across.length();
    if triangle.is_degenerate() || whole == 0.0 || surface == 0.0 {
        return Vec::new();
    }
    let normal = across.normalize() * front;
    let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
    let mut all = Vec::new();
    let outline = Outline::of(flat);
    for y in cells(&outline, 1, size[1]) {
        let row = outline.between(1, y);
        for x in cells(&row, 0, size[0]) {
            let Some((piece, centre)) = row.between(0, x).measure().filter(|m| m.0 > SMALLEST)
            else {
                continue;
            };
            // Where the centre is in the triangle, by the areas that it divides the triangle into.
            let at =
                |k: usize, l: usize| (area(&[flat[k], flat[l], centre]) / whole).clamp(0.0, 1.0);
            let (second, third) = (at(2, 0), at(0, 1));
            let rest = (1.0 - second - third).max(0.0);
            let point = (a * rest + b * second + c * third) / (rest + second + third);
            let receiver = Receiver {
                point,
                normal,
                triangle: id,
            };
            let weight = surface * piece / (0.5 * whole.abs());
            all.push(Piece {
                receiver,
                texel: y * size[0] + x,
                weight,
            });
        }
    }
    all
}

/// The numbers of the texels that an outline touches along an axis.
fn cells(outline: &Outline, axis: usize, size: u32) -> std::ops::Range<u32> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for p in outline.points() {
        (low, high) = (low.min(p[axis]), high.max(p[axis]));
    }
    // An empty outline has an empty range.
    low.floor().max(0.0) as u32..(high.ceil().max(0.0) as u32).min(size)
}

/// A convex polygon: a triangle, cut by four lines at the most.
#[derive(Clone, Copy)]
struct Outline {
    corners: [[f64; 2]; 8],
    count: usize,
}

impl Outline {
    fn of(flat: &Flat) -> Self {
        let mut corners = [[0.0; 2]; 8];
        corners[..3].copy_from_slice(flat);
        Self { corners, count: 3 }
    }

    fn points(&self) -> &[[f64; 2]] {
        &self.corners[..self.count]
    }

    /// The part whose coordinate is between `cell` and the next number.
    fn between(&self, axis: usize, cell: u32) -> Self {
        let low = f64::from(cell);
        self.cut(axis, low, 1.0).cut(axis, low + 1.0, -1.0)
    }

    /// The part on one side of a line.
    fn cut(&self, axis: usize, at: f64, side: f64) -> Self {
        let mut out = Self {
            corners: [[0.0; 2]; 8],
            count: 0,
        };
        let mut push = |p: [f64; 2]| {
            // A convex polygon gains one corner by a cut; rounding may make it seem to gain more.
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

    /// The area and its centre; none without an area.
    fn measure(&self) -> Option<(f64, [f64; 2])> {
        let points = self.points();
        let first = points.first()?;
        let (mut total, mut sum) = (0.0, [0.0; 2]);
        for pair in points[1..].windows(2) {
            let part = area(&[*first, pair[0], pair[1]]);
            total += part;
            for k in 0..2 {
                // From the first corner on, so that little is lost far from the origin.
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
    fn pieces_have_the_area_and_the_centre_of_the_triangle() {
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
