//! The surface of a swath, and the test whether the swath bounds the lit space (Teller 1992, sections 7.2.4,
//! 7.2.5 and 7.3).

use std::cmp::Ordering;
use std::collections::BTreeSet;

use dashu_int::IBig;
use glam::DVec3;

use crate::geometry::PointOrigin;
use crate::geometry::polygon::Polygon;
use crate::geometry::predicates::{self, integers, orient};

/// An edge of a polygon of the sequence: the index of the polygon, and the index of the corner at which the
/// edge starts.
pub type EdgeOf = [usize; 2];

/// The surface of a swath.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// The plane of a vertex and an edge (VE), as coefficients a, b, c, d of ax + by + cz + d = 0.
    Plane([f64; 4]),
    /// The quadric of three edges (EEE), as coefficients A to J.
    ///
    /// The equation is Ax² + 2Bxy + 2Cxz + 2Dx + Ey² + 2Fyz + 2Gy + Hz² + 2Iz + J = 0.
    ///
    /// Equation 7.3 of Teller 1992 contains a misprint: 2Cxy in place of 2Cxz.
    Quadric([f64; 10]),
}

/// Returns the corner of one polygon and the edge of another polygon that a swath touches. The corner is
/// given by the index of its polygon and its own index.
///
/// The result is `None` unless two of the swath's edges share a corner and a third edge is of another
/// polygon.
pub fn vertex_and_edge(portals: &[Polygon], touched: &[EdgeOf]) -> Option<(EdgeOf, EdgeOf)> {
    let pairs = touched
        .iter()
        .enumerate()
        .flat_map(|(k, a)| touched[k + 1..].iter().map(move |b| (*a, *b)));
    for ([p, i], [q, j]) in pairs.filter(|(a, b)| a[0] == b[0]) {
        let n = portals[p].points().len();
        // Edge k goes from corner k to corner k + 1.
        let corner = match ((i + 1) % n == j, (j + 1) % n == i) {
            (true, _) => j,
            (_, true) => i,
            _ => continue,
        };
        debug_assert_eq!(p, q, "both edges are of one polygon");
        if let Some(edge) = touched.iter().find(|[k, _]| *k != p) {
            return Some(([p, corner], *edge));
        }
    }
    None
}

/// Computes the plane of a swath of a corner and an edge.
///
/// The function also returns true if the swath bounds the lit space.
///
/// The swath bounds the lit space exactly if its plane separates the polygons of the corner and the edge.
pub fn plane_of(portals: &[Polygon], [p, corner]: EdgeOf, [q, edge]: EdgeOf) -> (bool, Surface) {
    let (first, other) = (portals[p].points(), portals[q].points());
    let ends = [&other[edge], &other[(edge + 1) % other.len()]];
    let v = &first[corner];
    let sides = |points: &[PointOrigin]| -> BTreeSet<Ordering> {
        points
            .iter()
            .map(|x| orient([ends[0], ends[1], v, x]))
            .filter(|o| *o != Ordering::Equal)
            .collect()
    };
    let (a, b) = (sides(first), sides(other));
    let is_boundary = a.len() == 1 && b.len() == 1 && a != b;
    let exact = [ends[0], ends[1], v].map(integers);
    let [x, y, z, k] = predicates::plane([&exact[0], &exact[1], &exact[2]]);
    let plane = [x, y, z, -k].map(|c| c.to_f64().value());
    let most = plane.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    // A corner on the line of the edge does not span a plane with the edge.
    (
        is_boundary,
        Surface::Plane(if most > 0.0 {
            plane.map(|c| c / most)
        } else {
            plane
        }),
    )
}

/// Returns true if a direction perpendicular to a line points into all polygons at the edges that the line
/// touches.
///
/// Then stabbing lines exist on both sides of the swath (Teller 1992, section 7.2.4). `line` is in world
/// space.
pub fn are_contained(portals: &[Polygon], touched: &[EdgeOf], line: &[f64; 6]) -> bool {
    let along = DVec3::new(line[0], line[1], line[2]).normalize_or_zero();
    let normals: Vec<DVec3> = touched
        .iter()
        .map(|[p, i]| {
            let at = portals[*p].rounded();
            let (a, b) = (at[*i], at[(*i + 1) % at.len()]);
            let middle = at.iter().sum::<DVec3>() / at.len() as f64;
            let normal = along.cross(b - a);
            if normal.dot(middle - a) < 0.0 {
                -normal
            } else {
                normal
            }
        })
        .collect();
    let right = along.any_orthonormal_vector();
    let up = along.cross(right);
    let mut angles: Vec<f64> = normals
        .iter()
        .map(|n| n.dot(up).atan2(n.dot(right)))
        .collect();
    angles.sort_by(f64::total_cmp);
    let n = angles.len();
    let turn = std::f64::consts::TAU;
    let gaps = (0..n).map(|k| {
        if k + 1 < n {
            angles[k + 1] - angles[k]
        } else {
            angles[0] + turn - angles[k]
        }
    });
    gaps.fold(0.0, f64::max) > std::f64::consts::PI
}

/// Computes the quadric of the lines that meet three edges, xᵀ L₃* L₂ L₁* x = 0, as the coefficients of
/// [`Surface::Quadric`].
///
/// For each of the three lines, L* maps a point to the plane through the point and the line, and L maps a
/// plane to its intersection with the line.
pub fn quadric_of(portals: &[Polygon], touched: &[EdgeOf]) -> [f64; 10] {
    let ends = |[p, i]: EdgeOf| {
        let points = portals[p].points();
        [
            integers(&points[i]),
            integers(&points[(i + 1) % points.len()]),
        ]
    };
    // These are the first three edges, of three different polygons if possible.
    let mut ordered_edges: Vec<EdgeOf> = Vec::new();
    for edge in touched {
        if ordered_edges.iter().all(|known| known[0] != edge[0]) {
            ordered_edges.push(*edge);
        }
    }
    ordered_edges.extend(
        touched
            .iter()
            .filter(|e| !ordered_edges.contains(e))
            .copied()
            .collect::<Vec<_>>(),
    );
    let lines: Vec<[[IBig; 4]; 2]> = ordered_edges.into_iter().take(3).map(ends).collect();
    let through = |[a, b]: &[[IBig; 4]; 2]| -> [[IBig; 4]; 4] {
        std::array::from_fn(|i| std::array::from_fn(|j| &a[i] * &b[j] - &a[j] * &b[i]))
    };
    // The dual matrix has the complementary minors.
    let dual = |m: &[[IBig; 4]; 4]| -> [[IBig; 4]; 4] {
        let mut out: [[IBig; 4]; 4] = Default::default();
        for (i, j, k, l) in [
            (0, 1, 2, 3),
            (0, 2, 3, 1),
            (0, 3, 1, 2),
            (1, 2, 0, 3),
            (3, 1, 0, 2),
            (2, 3, 0, 1),
        ] {
            out[i][j] = m[k][l].clone();
            out[j][i] = -m[k][l].clone();
        }
        out
    };
    let times = |a: &[[IBig; 4]; 4], b: &[[IBig; 4]; 4]| -> [[IBig; 4]; 4] {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| &a[i][k] * &b[k][j]).sum()))
    };
    let [l1, l2, l3] = [0, 1, 2].map(|k| through(&lines[k]));
    let m = times(&dual(&l3), &times(&l2, &dual(&l1)));
    let entry = |i: usize, j: usize| &m[i][j] + &m[j][i];
    let pairs = [
        (0, 0),
        (0, 1),
        (0, 2),
        (0, 3),
        (1, 1),
        (1, 2),
        (1, 3),
        (2, 2),
        (2, 3),
        (3, 3),
    ];
    let exact = pairs.map(|(i, j)| entry(i, j));
    let values = exact.map(|c| c.to_f64().value());
    let most = values.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if most > 0.0 {
        values.map(|c| c / most)
    } else {
        values
    }
}
