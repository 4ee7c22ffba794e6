//! The stabbing polyhedron of two polygons: the lines from A to B as a region of line space (Nirenstein 2003,
//! section 5.2).
//!
//! Every edge of A and of B bounds the polyhedron. The line k in which the two planes meet lies on the
//! hyperplanes of all edges, so the polyhedron is a cone extruded along ±k (Nirenstein 2003, theorem 5.1). In
//! the quotient by k, the extreme rays are the vertex pairs, except that a vertex on the other polygon's
//! plane makes one ray with all of that polygon's vertices. The quotient is {(P, Q) ∈ cone A × cone B : g(P)
//! = h(Q)}, with g and h the heights over the other's plane. So the tight half-spaces of each ray are known
//! without a computation, also if the polygons touch each other's planes (Nirenstein 2003, section 5.2.6).
//!
//! Two caps make the polyhedron bounded (Nirenstein 2003, section 5.2.5): hyperplanes with all vertex-pair
//! lines on one side and k, or −k, on the other. Any such hyperplanes are correct; the caps in this module
//! are fitted to the pair. No vertex-pair line lies on or beyond a cap. So a proof for the capped region also
//! holds for the hull of the vertex-pair lines, the region that certificates refer to.
//!
//! If a vertex of A and a vertex of B lie on k, then k or −k is itself a vertex-pair line, and an apex
//! replaces the cap on its side. If both occur (the polygons overlap along k), a hyperplane across k cuts the
//! region in two.

use std::cmp::Ordering;

use glam::DVec3;
use rustc_hash::FxHashMap;
use sightline_geometry::rounding::UNIT as U;

use crate::geometry::polygon::Polygon;
use crate::line_space::cone::{MOST_HALVES, Region};
use crate::line_space::space::{Space, Through, VectorId};

/// Two polygons, each on one side of the other's plane, and the lines between them.
pub struct Pair {
    /// The vertices of A, as indices of points of the space.
    pub a: Vec<u32>,
    /// The vertices of B, as indices of points of the space.
    pub b: Vec<u32>,
    /// The side of A's plane that contains B, as [`Space::orient`] returns it for the first three vertices of
    /// A.
    pub ahead: Ordering,
    /// The side of B's plane that contains A.
    pub behind: Ordering,
    /// The lines from A to B, as one or two regions of line space.
    pub regions: Vec<Region>,
    /// The largest magnitude of a coordinate of A or B in world space.
    pub size: f64,
    /// For each triangle tested so far, two flags: true if the triangle lies in A's plane, and true if it
    /// lies in B's plane.
    pub flat: FxHashMap<u32, [bool; 2]>,
}

/// The error that no stabbing polyhedron was constructed.
///
/// The polygons are too thin, or too near to each other's planes, for doubles to fit a cap, or they have more
/// edges than a region may have half-spaces. A query for halves of the polygons can succeed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoCaps;

/// Adds the vertices and edges of both polygons to the space, and constructs the regions of lines from `a` to
/// `b`.
///
/// Neither polygon may lie in the other's plane or have vertices on both sides of it. `a_sides` contains the
/// sides of B's plane on which A's vertices lie, and `b_sides` the sides of A's plane on which B's vertices
/// lie.
///
/// # Errors
/// [`NoCaps`] if the function cannot construct a stabbing polyhedron. Halve one of the polygons and try
/// again.
pub fn stabbing(
    space: &mut Space,
    a: &Polygon,
    a_sides: &[Ordering],
    b: &Polygon,
    b_sides: &[Ordering],
) -> Result<Pair, NoCaps> {
    if a.points().len() + b.points().len() + 2 > MOST_HALVES {
        return Err(NoCaps);
    }
    let add = |space: &mut Space, p: &Polygon| -> Vec<u32> {
        let points: Vec<_> = p
            .points()
            .iter()
            .map(|s| match s {
                crate::geometry::frame::PointOrigin::Given(p) => space.frame().given(*p),
                crate::geometry::frame::PointOrigin::Exact(p) => space.frame().exact((**p).clone()),
            })
            .collect();
        points.into_iter().map(|p| space.point(p)).collect()
    };
    let (pa, pb) = (add(space, a), add(space, b));
    let corners = a
        .points()
        .iter()
        .chain(b.points())
        .map(crate::geometry::polygon::rounded);
    let size = corners.fold(0.0f64, |m, p| m.max(p.abs().max_element()));
    let off = |sides: &[Ordering]| {
        sides
            .iter()
            .copied()
            .find(|s| *s != Ordering::Equal)
            .unwrap_or(Ordering::Equal)
    };
    let (ahead, behind) = (off(b_sides), off(a_sides));
    let edges = |space: &mut Space, p: &[u32]| -> Vec<VectorId> {
        (0..p.len())
            .map(|i| space.join(p[i], p[(i + 1) % p.len()]))
            .collect()
    };
    let mut halves = edges(space, &pa);
    halves.extend(edges(space, &pb));
    let (n, m) = (pa.len(), pb.len());
    // `at` returns the bits of the two edges at a vertex, and `all` the bits of all edges of a polygon.
    let at = |i: usize, n: usize, first: usize| {
        1u128 << (first + i) | 1u128 << (first + (i + n - 1) % n)
    };
    let all = |n: usize, first: usize| ((1u128 << n) - 1) << first;
    // One line for each ray of the quotient, and the edges tight there.
    let mut quotient: Vec<(VectorId, u128)> = Vec::with_capacity(n * m);
    // All vertex-pair lines except lines along k. Both caps must have these lines on their inner side.
    let mut lines: Vec<VectorId> = Vec::with_capacity(n * m);
    let mut along: Vec<VectorId> = Vec::new();
    let mut across = None;
    for i in 0..n {
        let mut on_plane = false;
        for j in 0..m {
            let (gi, hj) = (a_sides[i], b_sides[j]);
            if gi == Ordering::Equal && hj == Ordering::Equal {
                if !same_point(space, pa[i], pb[j]) {
                    along.push(space.join(pa[i], pb[j]));
                }
                continue;
            }
            let tight_a = if hj == Ordering::Equal {
                all(n, 0)
            } else {
                at(i, n, 0)
            };
            let tight_b = if gi == Ordering::Equal {
                all(m, n)
            } else {
                at(j, m, n)
            };
            // A vertex on the other polygon's plane makes one ray, with the first partner off the vertex's
            // own plane.
            let seen = if gi == Ordering::Equal {
                std::mem::replace(&mut on_plane, true)
            } else {
                hj == Ordering::Equal && quotient.iter().any(|(_, t)| *t == tight_a | tight_b)
            };
            let line = space.join(pa[i], pb[j]);
            lines.push(line);
            if !seen {
                quotient.push((line, tight_a | tight_b));
                if gi != Ordering::Equal && hj != Ordering::Equal && across.is_none() {
                    across = Some(line);
                }
            }
        }
    }
    let plane = |p: &[u32]| Through {
        points: [p[0], p[1], p[2]],
        turned: false,
    };
    let k = space.meet(plane(&pa), plane(&pb));
    let same: Vec<bool> = along
        .iter()
        .map(|l| space.same_line(k, *l) == Some(true))
        .collect();
    let (ends_up, ends_down) = (same.contains(&true), same.contains(&false));
    let minus = space.opposite(k);
    let mut regions = Vec::with_capacity(2);
    let apex = all(n + m, 0);
    if let (true, true, Some(middle)) = (ends_up, ends_down, across) {
        // `middle` joins two vertices, each off the other polygon's plane, so it does not meet k. The
        // hyperplane of `middle` separates the part with k from the part with −k.
        let mut base: Vec<(VectorId, u128)> = Vec::with_capacity(quotient.len());
        for (line, tight) in &quotient {
            base.push((onto(space, *line, [k, minus], middle), tight | 1 << (n + m)));
        }
        for end in [k, minus] {
            let mut rays = base.clone();
            rays.push((end, apex));
            regions.push(Region {
                rays,
                halves: [&halves[..], &[middle]].concat().into(),
            });
        }
    } else {
        let (top, bottom) = caps(space, &halves, n, &lines, k)?;
        let mut rays: Vec<(VectorId, u128)> = Vec::with_capacity(2 * quotient.len());
        let mut halves = halves;
        for (cap, apex_there, sign) in [(top, ends_up, true), (bottom, ends_down, false)] {
            if apex_there {
                rays.push((if sign { k } else { minus }, apex));
                continue;
            }
            let bit = 1u128 << halves.len();
            halves.push(cap);
            for (line, tight) in &quotient {
                rays.push((onto(space, *line, [k, minus], cap), tight | bit));
            }
        }
        regions.push(Region {
            rays,
            halves: halves.into(),
        });
    }
    Ok(Pair {
        a: pa,
        b: pb,
        ahead,
        behind,
        regions,
        size,
        flat: FxHashMap::default(),
    })
}

/// Returns the ray of the family `line` + t·k that is on the hyperplane `cap`. The pair contains k and −k.
fn onto(space: &mut Space, line: VectorId, [k, minus]: [VectorId; 2], cap: VectorId) -> VectorId {
    let side = space.side(line, cap);
    if side == Ordering::Equal {
        return line;
    }
    // The direction that changes the side is k if k is on the other side, and −k otherwise.
    let way = if space.side(k, cap) == side { minus } else { k };
    space.cut([line, way], cap, Vec::new)
}

fn same_point(space: &mut Space, p: u32, q: u32) -> bool {
    let x = space.point_exact(p).clone();
    x == *space.point_exact(q)
}

/// Fits two caps: the first separates all of `lines` from k, and the second separates them from −k. The first
/// `a_count` edges belong to A.
///
/// The functional σ of [`Caps`] is the sum of the lines if this sum is positive on all lines, as for most
/// pairs. Otherwise σ is the sum of the edges' functionals. The latter is always positive, but nearly 0 on
/// polygons that nearly lie in one plane.
fn caps(
    space: &mut Space,
    edges: &[VectorId],
    a_count: usize,
    lines: &[VectorId],
    k: VectorId,
) -> Result<(VectorId, VectorId), NoCaps> {
    let both = |space: &mut Space, sigma: [f64; 6]| {
        let caps = Caps::fit(space, lines, k, sigma)?;
        Ok((caps.cap(space, lines, 1.0)?, caps.cap(space, lines, -1.0)?))
    };
    let mean = mean(space, lines, k);
    both(space, mean).or_else(|NoCaps| {
        let sum = edge_sum(space, edges, a_count, lines);
        both(space, sum)
    })
}

/// Computes the sum of the lines minus its component along k: a functional that is 0 at k.
fn mean(space: &Space, lines: &[VectorId], k: VectorId) -> [f64; 6] {
    let k_at = space.rounded(k);
    let mean: [f64; 6] =
        std::array::from_fn(|i| lines.iter().map(|l| space.rounded(*l)[i]).sum::<f64>());
    let along = dot(&mean, k_at) / dot(k_at, k_at);
    std::array::from_fn(|i| mean[i] - along * k_at[i])
}

/// Computes the sum of the functionals of all edges.
///
/// The function negates the functionals of a polygon if needed, so that no line is on their negative side.
///
/// Every functional is 0 at the line k. The first `a_count` edges belong to A.
fn edge_sum(space: &mut Space, edges: &[VectorId], a_count: usize, lines: &[VectorId]) -> [f64; 6] {
    let mut sum = [0.0; 6];
    for polygon in [&edges[..a_count], &edges[a_count..]] {
        // A line passes all edges of a convex polygon on the same side, so the first line that is off an edge
        // determines the side.
        let side = polygon
            .iter()
            .flat_map(|e| lines.iter().map(move |l| (*e, *l)))
            .map(|(e, l)| space.side(l, e))
            .find(|s| *s != Ordering::Equal);
        let turn = if side == Some(Ordering::Less) {
            -1.0
        } else {
            1.0
        };
        for e in polygon {
            let x = space.rounded(*e);
            // The functional expresses the Klein form as a scalar product.
            (0..6).for_each(|i| sum[i] += turn * x[(i + 3) % 6]);
        }
    }
    sum
}

fn dot(f: &[f64; 6], v: &[f64; 6]) -> f64 {
    f.iter().zip(v).map(|(a, b)| a * b).sum()
}

/// The functionals whose level sets cap the extrusion.
///
/// φ has φ(k) = 1 and is as small as possible on the vertex-pair lines. σ has σ(k) = 0 and is positive on all
/// of these lines. Caps are exactly the hyperplanes of the stored doubles, so rounding errors of φ and σ are
/// harmless; [`Caps::cap`] checks each cap with exact signs.
struct Caps {
    phi: [f64; 6],
    sigma: [f64; 6],
    highest: f64,
    lowest: f64,
    k: VectorId,
}

impl Caps {
    fn fit(
        space: &Space,
        through: &[VectorId],
        k: VectorId,
        sigma: [f64; 6],
    ) -> Result<Self, NoCaps> {
        let at: Vec<[f64; 6]> = through.iter().map(|l| *space.rounded(*l)).collect();
        let k_at = *space.rounded(k);
        // φ minimises Σ φ(v)² subject to φ(k) = 1: φ = G⁻¹k / (k·G⁻¹k) with the regularised matrix G = Σ v
        // vᵀ.
        let mut g = [[0.0; 6]; 6];
        for v in &at {
            for (i, row) in g.iter_mut().enumerate() {
                for (j, c) in row.iter_mut().enumerate() {
                    *c += v[i] * v[j];
                }
            }
        }
        let ridge = 1e-9 * (0..6).map(|i| g[i][i]).sum::<f64>();
        (0..6).for_each(|i| g[i][i] += ridge);
        let solved = solve(g, k_at).ok_or(NoCaps)?;
        let at_k = dot(&solved, &k_at);
        if at_k.is_nan() || at_k <= 0.0 {
            return Err(NoCaps);
        }
        let phi = solved.map(|c| c / at_k);
        let size = sigma.iter().fold(0.0f64, |m, c| m.max(c.abs()));
        if size.is_nan() || size <= 0.0 {
            return Err(NoCaps);
        }
        let sigma = sigma.map(|c| c / size);
        let (mut highest, mut lowest) = (f64::NEG_INFINITY, f64::INFINITY);
        for v in &at {
            let (p, s) = (dot(&phi, v), dot(&sigma, v));
            if s > 1e-12 {
                highest = highest.max(p / s);
                lowest = lowest.min(p / s);
            }
        }
        Ok(Self {
            phi,
            sigma,
            highest,
            lowest,
            k,
        })
    }

    /// Adds the hyperplane of the functional `f`. The function swaps the first and last three components,
    /// because the Klein form multiplies the first three of one vector by the last three of the other.
    fn plane(space: &mut Space, f: [f64; 6]) -> VectorId {
        space.given([f[3], f[4], f[5], f[0], f[1], f[2]])
    }

    /// Computes the cap t·σ − φ, which cuts off k, if `way` is 1, or φ − t·σ, which cuts off −k, if `way` is
    /// −1.
    ///
    /// The function raises t (lowers t for −1) until all lines are on the cap's positive side and k (or −k)
    /// is on its negative side. It gives up with [`NoCaps`] after 60 steps.
    fn cap(&self, space: &mut Space, through: &[VectorId], way: f64) -> Result<VectorId, NoCaps> {
        let (mut t, other) = if way > 0.0 {
            (self.highest, self.lowest)
        } else {
            (self.lowest, self.highest)
        };
        let mut step = (t - other).abs().max(1e-6 * t.abs()).max(64.0 * U) * 0.02;
        if !t.is_finite() || !step.is_finite() {
            return Err(NoCaps);
        }
        let wanted_at_k = if way > 0.0 {
            Ordering::Less
        } else {
            Ordering::Greater
        };
        for _ in 0..60 {
            t += way * step;
            step *= 2.0;
            let cap = Self::plane(
                space,
                std::array::from_fn(|i| way * (t * self.sigma[i] - self.phi[i])),
            );
            let fits = space.side(self.k, cap) == wanted_at_k
                && through
                    .iter()
                    .all(|l| space.side(*l, cap) == Ordering::Greater);
            if fits {
                return Ok(cap);
            }
        }
        Err(NoCaps)
    }
}

/// Solves a symmetric positive definite system by Cholesky's method.
fn solve(mut a: [[f64; 6]; 6], b: [f64; 6]) -> Option<[f64; 6]> {
    for j in 0..6 {
        for i in j..6 {
            let sum: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            let d = a[i][j] - sum;
            if i == j {
                if d.is_nan() || d <= 0.0 {
                    return None;
                }
                a[j][j] = d.sqrt();
            } else {
                a[i][j] = d / a[j][j];
            }
        }
    }
    let mut y = b;
    for i in 0..6 {
        let sum: f64 = (0..i).map(|k| a[i][k] * y[k]).sum();
        y[i] = (y[i] - sum) / a[i][i];
    }
    for i in (0..6).rev() {
        let sum: f64 = (i + 1..6).map(|k| a[k][i] * y[k]).sum();
        y[i] = (y[i] - sum) / a[i][i];
    }
    Some(y)
}

/// Computes the point at which a line meets the plane of a polygon's first three points.
///
/// The line is rounded. The line and the returned point are in the frame of the space.
pub fn crossing_point(space: &Space, line: &[f64; 6], polygon: &[u32]) -> DVec3 {
    let [a, b, c] = [0, 1, 2].map(|i| DVec3::from(space.point_at(polygon[i]).at));
    let normal = (b - a).cross(c - a);
    let (d, m) = (
        DVec3::new(line[0], line[1], line[2]),
        DVec3::new(line[3], line[4], line[5]),
    );
    (normal.cross(m) + d * normal.dot(a)) / normal.dot(d)
}
