//! UV seams: edges that two triangles share on the surface and not in the image.
//!
//! Bilinear filtering reads different texels on the two sides of a seam. If the surface is smooth across a
//! seam, this module changes texels near the seam as little as possible, so that filtered values on both
//! sides agree at points along the seam. Conjugate gradients minimise the squares of the differences and of
//! the changes (Iwanicki, "Lighting technology of The Last of Us", 2013). The two faces at a crease have
//! different hemispheres, so this module does not change texels there.

use sightline_scene::{Scene, Triangle};

use crate::atlas::Atlas;
use crate::image::{TexelImage, TexelState};
use crate::parts::PrimitiveInstances;
use crate::solver::solve;
use crate::welds::{Edge, cross, pairs, places};

/// Minimum cosine of the angle between the normals of two faces that count as smooth at their common edge:
/// 45 degrees.
const SMOOTH: f64 = 0.707;
/// The weight of the squared change of a texel with receivers, relative to the weight 1 of a squared
/// difference across a seam.
const OWN: f64 = 1e-2;
/// The weight of the squared change of a filled texel, relative to the weight 1 of a squared difference
/// across a seam.
const FILLED: f64 = 1e-3;
/// The number of compared points per texel along a seam.
const PER_TEXEL: f64 = 2.0;
/// Maximum distance on each axis between edge ends that count as equal in the image, in texels.
const SAME: f64 = 1e-3;

/// An edge of two triangles whose positions in the image differ between the triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Seam {
    /// For each of the two triangles: the positions of the edge's first and second end in the image, in
    /// texels.
    pub sides: [[[f64; 2]; 2]; 2],
}

/// Finds the UV seams across which the surface is smooth.
pub(crate) fn seams(scene: &Scene, parts: &PrimitiveInstances, atlas: &Atlas) -> Vec<Seam> {
    let mut fronts = vec![1.0; scene.len() as usize];
    for part in &parts.all {
        fronts[part.first as usize..][..part.corners.len()].fill(part.front);
    }
    let triangle = |e: &Edge| -> &Triangle { &scene.triangles()[e.triangle.at()] };
    let normal = |e: &Edge| cross(triangle(e)).normalize_or_zero() * fronts[e.triangle.at()];
    let side = |e: &Edge| {
        let flat = &atlas.triangles[e.triangle.at()];
        [flat[usize::from(e.from)], flat[usize::from(e.to)]]
    };
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs()) > SAME;
    let in_image =
        |e: &Edge| crate::kept_coordinates::area(&atlas.triangles[e.triangle.at()]) != 0.0;
    pairs(&places(scene.triangles()))
        .iter()
        .filter(|[a, b]| in_image(a) && in_image(b) && normal(a).dot(normal(b)) > SMOOTH)
        .map(|[a, b]| Seam {
            sides: [side(a), side(b)],
        })
        .filter(|s| apart(s.sides[0][0], s.sides[1][0]) || apart(s.sides[0][1], s.sides[1][1]))
        .collect()
}

/// Returns points along a UV seam. Each point is a pair of positions in the image, in texels: one in each of
/// the two triangles.
pub(crate) fn points(seam: &Seam) -> impl Iterator<Item = [[f64; 2]; 2]> {
    let length = |s: &[[f64; 2]; 2]| (s[1][0] - s[0][0]).abs().max((s[1][1] - s[0][1]).abs());
    let longest = seam.sides.iter().map(length).fold(0.0, f64::max);
    let count = (longest * PER_TEXEL).ceil().max(1.0);
    let sides = seam.sides;
    (0..count as u32).map(move |k| {
        let t = (f64::from(k) + 0.5) / count;
        sides.map(|s| [0, 1].map(|c| s[0][c] + (s[1][c] - s[0][c]) * t))
    })
}

/// Changes texels so that bilinear filtering returns nearly equal values on both sides of each UV seam.
pub(crate) fn close(image: &mut TexelImage, seams: &[Seam]) {
    let row = |[a, b]: [[f64; 2]; 2], image: &TexelImage| {
        let (a, b) = (image.around(a), image.around(b).map(|(i, w)| (i, -w)));
        [a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]
    };
    let mut rows: Vec<[(u32, f64); 8]> = seams
        .iter()
        .flat_map(points)
        .map(|point| row(point, image))
        .collect();
    let mut texels: Vec<u32> = rows.iter().flatten().map(|(i, _)| *i).collect();
    texels.sort_unstable();
    texels.dedup();
    for (i, _) in rows.iter_mut().flatten() {
        // `texels` contains every texel of `rows`, so the search succeeds.
        *i = texels.binary_search(i).unwrap_or(0) as u32;
    }
    let before: Vec<f64> = texels.iter().map(|i| image.values[*i as usize]).collect();
    let cost = |i: &u32| {
        if image.states[*i as usize] == TexelState::Own {
            OWN
        } else {
            FILLED
        }
    };
    let costs: Vec<f64> = texels.iter().map(cost).collect();
    let mut diagonal = costs.clone();
    for (i, w) in rows.iter().flatten() {
        diagonal[*i as usize] += w * w;
    }
    let apply = |v: &[f64], out: &mut [f64]| {
        out.iter_mut()
            .zip(v.iter().zip(&costs))
            .for_each(|(out, (v, c))| *out = v * c);
        for row in &rows {
            let difference: f64 = row.iter().map(|(i, w)| w * v[*i as usize]).sum();
            row.iter()
                .for_each(|(i, w)| out[*i as usize] += w * difference);
        }
    };
    let b: Vec<f64> = before.iter().zip(&costs).map(|(v, c)| v * c).collect();
    let mut after = before;
    solve(apply, &diagonal, &b, &mut after, 1e-7, 500);
    for (i, v) in texels.iter().zip(after) {
        image.values[*i as usize] = v.clamp(0.0, 1.0);
    }
}
