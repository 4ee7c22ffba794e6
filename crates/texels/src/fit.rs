//! Values at vertices whose interpolation is closest to the values inside faces (Kavan, Bargteil and Sloan,
//! "Least Squares Vertex Baking", 2011).
//!
//! The fit minimises the squared differences at the receivers, weighted by area, plus a small cost for
//! changes of the values' gradient at edges. The cost is 0 for a linear function on a plane. If all receivers
//! of a triangle are ignored, a cost on the differences between the triangle's vertices gives them the values
//! of their neighbours.

use glam::DVec3;
use sightline_scene::{Scene, Triangle};

use crate::solver::solve;
use crate::vertices::{Unknowns, samples};
use crate::welds::{Edge, cross, pairs};

/// The weight of the squared change of the gradient across an edge, relative to the weight 1 of the squared
/// errors at the receivers of a triangle of mean area. Edges of two triangles that together are smaller than
/// a mean triangle have a weight in proportion to their area.
const BEND: f64 = 1e-3;
/// The weight of the squared difference of the values at the ends of an edge, for a triangle whose receivers
/// are all ignored. The weight is relative to the weight 1 of the squared errors at the receivers of a
/// triangle of mean area.
const DRAWN: f64 = 1e-3;

/// A penalty of the fit: the square of a weighted sum of the unknown values at the four corners of two
/// triangles that share an edge.
struct Hinge {
    unknowns: [u32; 4],
    weights: [f64; 4],
}

/// Computes the value of each unknown, from 0 to 1.
///
/// `values` contains the value of each receiver in the order of [`Unknowns::receivers`], or `None` for an
/// ignored receiver.
pub(crate) fn fit(scene: &Scene, unknowns: &Unknowns, values: &[Option<f64>]) -> Vec<f64> {
    let triangles = scene.triangles();
    let areas: Vec<f64> = triangles.iter().map(|t| 0.5 * cross(t).length()).collect();
    let mean_area = areas.iter().sum::<f64>() / areas.len().max(1) as f64;
    let mut b = vec![0.0; unknowns.count];
    let mut diagonal = vec![0.0; unknowns.count];
    // The distinct entries of each triangle's symmetric 3 × 3 matrix, by row and column: 00 11 22 01 12 20.
    let mut matrices = vec![[0.0f64; 6]; triangles.len()];
    // The solver computes differences from the mean. An unknown without any receiver stays at the mean.
    let known = values.iter().flatten().count();
    let mean = if known == 0 {
        1.0
    } else {
        values.iter().flatten().sum::<f64>() / known as f64
    };
    let mut next = 0;
    let mut drawn = Vec::new();
    for (t, corners) in unknowns.corners.iter().enumerate() {
        let k = unknowns.divisions[t];
        // Areas are multiples of the mean area, so that small scenes do not lose precision.
        let weight = areas[t] / mean_area / f64::from(k).powi(2);
        let mut any = false;
        for w in samples(k) {
            let value = values.get(next).copied().flatten();
            next += 1;
            let Some(value) = value else { continue };
            any = true;
            for i in 0..3 {
                matrices[t][i] += weight * w[i] * w[i];
                matrices[t][3 + i] += weight * w[i] * w[(i + 1) % 3];
                b[corners[i] as usize] += weight * w[i] * (value - mean);
            }
        }
        for i in 0..3 {
            diagonal[corners[i] as usize] += matrices[t][i];
            let next = corners[(i + 1) % 3];
            if !any && corners[i] != next {
                drawn.push([corners[i], next]);
            }
            // If two corners have one unknown, the entry of both corners is on the diagonal.
            if corners[i] == next {
                diagonal[next as usize] += 2.0 * matrices[t][3 + i];
            }
        }
    }
    let hinges: Vec<Hinge> = pairs(&unknowns.corners)
        .iter()
        .filter_map(|pair| hinge(triangles, unknowns, pair, mean_area))
        .collect();
    for h in &hinges {
        for i in 0..4 {
            diagonal[h.unknowns[i] as usize] += h.weights[i] * h.weights[i];
        }
    }
    for i in drawn.iter().flatten() {
        diagonal[*i as usize] += DRAWN;
    }
    let apply = |v: &[f64], out: &mut [f64]| {
        out.fill(0.0);
        for (corners, m) in unknowns.corners.iter().zip(&matrices) {
            let [x, y, z] = corners.map(|c| v[c as usize]);
            out[corners[0] as usize] += m[0] * x + m[3] * y + m[5] * z;
            out[corners[1] as usize] += m[3] * x + m[1] * y + m[4] * z;
            out[corners[2] as usize] += m[5] * x + m[4] * y + m[2] * z;
        }
        for h in &hinges {
            let sum: f64 = (0..4)
                .map(|i| h.weights[i] * v[h.unknowns[i] as usize])
                .sum();
            (0..4).for_each(|i| out[h.unknowns[i] as usize] += h.weights[i] * sum);
        }
        for [i, j] in &drawn {
            let difference = DRAWN * (v[*i as usize] - v[*j as usize]);
            out[*i as usize] += difference;
            out[*j as usize] -= difference;
        }
    };
    let mut x = vec![0.0; unknowns.count];
    solve(apply, &diagonal, &b, &mut x, 1e-9, 2000);
    x.iter_mut().for_each(|v| *v += mean);
    x.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    x
}

/// Computes the penalty on the change of the values' gradient across an edge, as if its two triangles lay in
/// one plane. Returns `None` if the edge has no length, or a triangle no area.
fn hinge(
    triangles: &[Triangle],
    unknowns: &Unknowns,
    pair: &[Edge; 2],
    mean_area: f64,
) -> Option<Hinge> {
    let point = |e: &Edge, corner: u8| -> DVec3 {
        triangles[e.triangle.at()].v[usize::from(corner)].as_dvec3()
    };
    let (start, end) = (point(&pair[0], pair[0].from), point(&pair[0], pair[0].to));
    let along = end - start;
    let length = along.length();
    // The third corner of each triangle: its distance from the edge, and its position along the edge.
    let third = |e: &Edge| {
        let corner = 3 - e.from - e.to;
        let to = point(e, corner) - start;
        let at = to.dot(along) / (length * length);
        let unknown = unknowns.corners[e.triangle.at()][usize::from(corner)];
        ((to - along * at).length(), at, unknown)
    };
    let [(h, s, c), (k, t, d)] = [third(&pair[0]), third(&pair[1])];
    let low = h.min(k);
    if !(low > 0.0 && length > 0.0) {
        return None;
    }
    let (p, q) = (low / h, low / k);
    let mut weights = [-p * (1.0 - s) - q * (1.0 - t), -p * s - q * t, p, q];
    let largest = weights.iter().fold(1.0f64, |m, w| m.max(w.abs()));
    let area = 0.5 * length * (h + k) / mean_area;
    let factor = (BEND * area.min(1.0)).sqrt() / largest;
    weights.iter_mut().for_each(|w| *w *= factor);
    let ends = pair[0].ends;
    Some(Hinge {
        unknowns: [ends[0], ends[1], c, d],
        weights,
    })
    .filter(|h| h.weights.iter().all(|w| w.is_finite()))
}
