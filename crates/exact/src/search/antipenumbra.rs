//! The antipenumbra of a sequence of polygons: the surfaces that bound and divide the space that light from
//! the first polygon reaches through the others (Teller 1992, sections 7.2 and 7.3).
//!
//! The lines that stab all polygons are the part of a cone in line space that lies on the Klein quadric. An
//! edge of the cone's polytope meets the quadric in an extremal line. A 2-face meets the quadric in the trace
//! of a swath: the lines that slide along three edges. If stabbing lines exist on both sides of a swath, the
//! swath is internal. The other swaths bound the lit space. The extremal lines at which these swaths meet
//! link them into loops.
//!
//! The edges of two polygons, and the edges of polygons in parallel planes, all meet one line l: the line in
//! which the planes meet. The cone then contains l in both directions, and for every x in the cone, one
//! vector x + tl is on the quadric. So every vertex of the polytope of the quotient by l is an extremal line,
//! and every edge of this polytope is a swath.
//!
//! The signs that decide which faces meet the quadric are exact.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use dashu_int::IBig;
use sightline_numbers::union_find::UnionFind;

use crate::geometry::frame::Frame;
use crate::geometry::polygon::Polygon;
use crate::geometry::predicates::sign;
use crate::line_space::cone::{MOST_HALVES, Region};
use crate::line_space::space::{Space, Tight, VectorId, klein, klein_exact};
use crate::search::stab::{directions, edges};
use crate::search::swath::{EdgeOf, Surface, are_contained, plane_of, quadric_of, vertex_and_edge};
use crate::search::verdict::QueryLimits;

/// A one-parameter family of lines that touch three edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Swath {
    /// The surface of the swath: a plane for a vertex and an edge, a quadric for three edges.
    pub surface: Surface,
    /// True if the swath bounds the lit space.
    pub is_boundary: bool,
    /// The number of the boundary loop that contains the swath, starting at 0; `None` for an internal swath.
    pub in_loop: Option<usize>,
    /// The edges that the swath's lines touch, each as the index of its polygon in the sequence and the index
    /// of the corner at which it starts.
    pub edges: Vec<EdgeOf>,
}

/// The antipenumbra of a sequence of polygons.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Antipenumbra {
    /// The numbers of vertices, edges and 2-faces of the polytope of stabbing lines in line space.
    pub polytope: [usize; 3],
    /// The number of extremal lines.
    pub lines: usize,
    /// The swaths.
    pub swaths: Vec<Swath>,
}

/// The reason why a sequence has no antipenumbra.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoAntipenumbra {
    /// The sequence has fewer than two polygons.
    #[error("the sequence has fewer than two polygons; give at least two")]
    Single,
    /// The lines of the edges span fewer than five dimensions, so they do not bound a cone of line space.
    #[error(
        "the edges of the polygons do not bound a cone of lines; give polygons in at least two planes"
    )]
    Unbounded,
    /// The polygons have more edges in total than a cone may have half-spaces.
    #[error("the polygons have too many edges; give at most 127 edges in total")]
    TooComplex,
    /// No combination or several combinations of directions exist in which a line can cross the polygons, or
    /// the search for them reached a limit.
    #[error(
        "the polygons do not determine one direction of crossing for each polygon; split the polygons"
    )]
    Directions,
}

/// Computes the antipenumbra of a sequence of at least two polygons that some line stabs. `limits` bounds the
/// search for the directions in which lines cross the polygons.
///
/// # Errors
/// [`NoAntipenumbra`] with the reason.
pub fn antipenumbra(
    portals: &[Polygon],
    limits: &QueryLimits,
) -> Result<Antipenumbra, NoAntipenumbra> {
    if portals.len() < 2 {
        return Err(NoAntipenumbra::Single);
    }
    let towards = directions(portals, limits).ok_or(NoAntipenumbra::Directions)?;
    // Use the identity frame, because later steps compare lines with polygons in world space.
    let mut space = Space::new(Frame::world());
    let directed: Vec<(&Polygon, Ordering)> = portals.iter().zip(towards).collect();
    let lines = edges(&mut space, &directed);
    let portal_edges: Vec<EdgeOf> = portals
        .iter()
        .enumerate()
        .flat_map(|(k, p)| (0..p.points().len()).map(move |i| [k, i]))
        .collect();
    let cone = Cone::new(&mut space, &lines)?;
    let faces = ConeFaces::from_region(&cone.region);
    let search = ExtremalLineSearch::new(&mut space, &cone);
    let mut found = Antipenumbra {
        polytope: [cone.region.rays.len(), faces.edges.len(), faces.faces.len()],
        ..Antipenumbra::default()
    };
    // For each swath, the rays of the face that contains its trace, and the extremal lines at the ends of the
    // trace.
    let mut traces: Vec<(Vec<usize>, [ExtremalLine; 2])> = Vec::new();
    if cone.shared.is_some() {
        let lines: Vec<Option<ExtremalLine>> = (0..cone.region.rays.len())
            .map(|ray| search.of_ray(ray, &mut found.lines))
            .collect();
        for [i, j] in &faces.edges {
            if let (Some(a), Some(b)) = (lines[*i], lines[*j]) {
                traces.push((vec![*i, *j], [a, b]));
            }
        }
    } else {
        let mut crossings: BTreeMap<[usize; 2], Vec<ExtremalLine>> = BTreeMap::new();
        for edge in &faces.edges {
            let on = search.crossings(*edge, found.lines);
            found.lines += on.len();
            crossings.insert(*edge, on);
        }
        for face in &faces.faces {
            let around = faces.around(face);
            let n = around.len();
            let mut points: Vec<ExtremalLine> = Vec::new();
            // True if the form is positive on the border after the first crossing.
            let mut is_up_after = None;
            for k in 0..n {
                let (i, j) = (around[k], around[(k + 1) % n]);
                let on = crossings
                    .get(&[i.min(j), i.max(j)])
                    .map_or(&[][..], Vec::as_slice);
                // One crossing changes the sign to the sign of the next ray; two crossings change it and
                // back.
                if !on.is_empty() {
                    is_up_after.get_or_insert(search.is_up(j) != (on.len() == 2));
                }
                // The crossings are appended in the direction of the walk.
                if i < j {
                    points.extend(on)
                } else {
                    points.extend(on.iter().rev())
                }
            }
            let arcs = arcs(&points, is_up_after.unwrap_or(true));
            traces.extend(arcs.into_iter().map(|ends| (face.clone(), ends)));
        }
    }
    let mut loops = UnionFind::new(found.lines);
    for (face, [a, b]) in &traces {
        let tight: Tight = face
            .iter()
            .fold(Tight::MAX, |all, ray| all & cone.region.rays[*ray].1);
        let is_tight = |k: usize| tight >> k & 1 == 1;
        let touched: Vec<EdgeOf> = cone
            .halves
            .iter()
            .enumerate()
            .filter_map(|(k, edge)| edge.filter(|_| is_tight(k)).map(|edge| portal_edges[edge]))
            .collect();
        let (is_boundary, surface) = search.swath(portals, &touched, face, [*a, *b]);
        if is_boundary {
            loops.join(a.number as u32, b.number as u32);
        }
        found.swaths.push(Swath {
            surface,
            is_boundary,
            in_loop: None,
            edges: touched,
        });
    }
    let mut numbers: BTreeMap<u32, usize> = BTreeMap::new();
    for (swath, (_, [line, _])) in found
        .swaths
        .iter_mut()
        .zip(&traces)
        .filter(|(swath, _)| swath.is_boundary)
    {
        let next = numbers.len();
        swath.in_loop = Some(
            *numbers
                .entry(loops.root(line.number as u32))
                .or_insert(next),
        );
    }
    Ok(found)
}

/// The cone of all six-vectors whose Klein form with the line of each edge has the required sign.
///
/// If one line meets all edges, the cone is the quotient by this line.
struct Cone {
    region: Region,
    /// For each half-space of the region, the index of its edge in the list of all edges.
    ///
    /// The value is `None` for the half-space that selects one vector of each x + tl.
    halves: Vec<Option<usize>>,
    /// The line l that meets all edges.
    shared: Option<[IBig; 6]>,
}

impl Cone {
    fn new(space: &mut Space, lines: &[(VectorId, Ordering)]) -> Result<Self, NoAntipenumbra> {
        let mut basis = independent(space, lines);
        let shared = match basis.len() {
            6 => None,
            5 => Some(space.orthogonal(std::array::from_fn(|k| lines[basis[k]].0))),
            _ => return Err(NoAntipenumbra::Unbounded),
        };
        let mut first: Vec<(VectorId, Ordering)> = basis.iter().map(|k| lines[*k]).collect();
        let mut halves: Vec<Option<usize>> = basis.iter().map(|k| Some(*k)).collect();
        if let Some(shared) = &shared {
            // K(w, l) is a component of l for a unit vector w; the component is not 0.
            let Some(at) = shared.iter().position(|c| !c.is_zero()) else {
                return Err(NoAntipenumbra::Unbounded);
            };
            let across = std::array::from_fn(|k| {
                if k == (at + 3) % 6 {
                    IBig::ONE
                } else {
                    IBig::ZERO
                }
            });
            first.push((space.fixed(across), Ordering::Greater));
            halves.push(None);
        }
        let first: [(VectorId, Ordering); 6] =
            first.try_into().map_err(|_| NoAntipenumbra::Unbounded)?;
        let mut region = Region {
            rays: space.dual_simplex(first),
            halves: first.map(|(line, _)| line).into(),
        };
        basis.sort_unstable();
        let mut sides = Vec::new();
        for (k, (line, keep)) in lines
            .iter()
            .enumerate()
            .filter(|(k, _)| basis.binary_search(k).is_err())
        {
            if region.halves.len() >= MOST_HALVES {
                return Err(NoAntipenumbra::TooComplex);
            }
            region.sides(space, *line, &mut sides);
            if sides.contains(&keep.reverse()) {
                let parts = region
                    .split(space, *line, &sides)
                    .map_err(|_| NoAntipenumbra::TooComplex)?;
                let [less, greater] = parts;
                region = if *keep == Ordering::Less {
                    less
                } else {
                    greater
                };
            } else {
                region = region.within(*line, &sides);
            }
            halves.push(Some(k));
        }
        // The ray along l is not a vertex of the quotient.
        if shared.is_some() {
            region.rays.retain(|(_, tight)| tight >> 5 & 1 == 1);
        }
        Ok(Self {
            region,
            halves,
            shared,
        })
    }
}

/// Returns the indices of the lines that are not in the span of the lines before them; there are at most six.
fn independent(space: &mut Space, lines: &[(VectorId, Ordering)]) -> Vec<usize> {
    let (mut basis, mut rows): (Vec<usize>, Vec<[IBig; 6]>) = (Vec::new(), Vec::new());
    for (k, (line, _)) in lines.iter().enumerate() {
        let mut row = space.exact(*line).clone();
        for known in &rows {
            let Some(at) = known.iter().position(|c| !c.is_zero()) else {
                continue;
            };
            let (a, b) = (known[at].clone(), row[at].clone());
            row.iter_mut()
                .zip(known)
                .for_each(|(x, y)| *x = &*x * &a - y * &b);
        }
        if row.iter().any(|c| !c.is_zero()) {
            crate::arithmetic::number::primitive(&mut row);
            rows.push(row);
            basis.push(k);
        }
    }
    basis
}

/// The edges and 2-faces of a cone's polytope.
struct ConeFaces {
    /// The pairs of ray indices that share an edge, in ascending order.
    edges: BTreeSet<[usize; 2]>,
    /// The ray indices of each 2-face, in ascending order.
    faces: BTreeSet<Vec<usize>>,
}

impl ConeFaces {
    fn from_region(region: &Region) -> Self {
        let rays = &region.rays;
        let on = |tight: Tight| -> Vec<usize> {
            (0..rays.len())
                .filter(|k| rays[*k].1 & tight == tight)
                .collect()
        };
        let (mut edges, mut faces) = (BTreeSet::new(), BTreeSet::new());
        for i in 0..rays.len() {
            for j in i + 1..rays.len() {
                let common = rays[i].1 & rays[j].1;
                if common.count_ones() < 4 || on(common) != [i, j] {
                    continue;
                }
                edges.insert([i, j]);
                // The 2-faces that contain this edge have the largest sets of half-spaces that are tight at
                // the edge and at a third ray.
                let with: BTreeSet<Tight> = (0..rays.len())
                    .filter(|k| *k != i && *k != j)
                    .map(|k| common & rays[k].1)
                    .collect();
                let is_largest = |t: &Tight| !with.iter().any(|o| o != t && o & t == *t);
                faces.extend(with.iter().filter(|t| is_largest(t)).map(|t| on(*t)));
            }
        }
        Self { edges, faces }
    }

    /// Returns the ray indices of a 2-face in order around the face.
    fn around(&self, face: &[usize]) -> Vec<usize> {
        let mut order = vec![face[0]];
        while let Some(last) = order.last().copied() {
            let is_next = |k: &&usize| {
                !order.contains(k) && self.edges.contains(&[last.min(**k), last.max(**k)])
            };
            match face.iter().find(is_next) {
                Some(next) => order.push(*next),
                None => break,
            }
        }
        order
    }
}

/// A point of the quadric on an edge of the polytope: an extremal line.
#[derive(Clone, Copy, Debug)]
struct ExtremalLine {
    /// The index of the line among all extremal lines.
    number: usize,
    line: [f64; 6],
}

/// Returns the pairs of crossings around a 2-face that the conic of the face joins.
///
/// `is_up_after` is true if the form is positive on the border between the first two crossings.
fn arcs(around: &[ExtremalLine], is_up_after: bool) -> Vec<[ExtremalLine; 2]> {
    let n = around.len();
    // The conic does not cross itself, so it joins neighbouring crossings: the first with the second, or the
    // first with the last. On the chord from the first to the third crossing, the form has one sign. If this
    // sign equals the sign on the border after the first crossing, the part of the face with this sign is in
    // one piece, and the conic cuts off the pieces with the other sign.
    let is_one_piece = n > 2 && {
        let across = std::array::from_fn(|k| around[0].line[k] + around[2].line[k]);
        (klein(&across, &across) > 0.0) == is_up_after
    };
    let shift = usize::from(is_one_piece);
    (0..n / 2)
        .map(|k| [around[(2 * k + shift) % n], around[(2 * k + 1 + shift) % n]])
        .collect()
}

/// The rays of a cone, and the computation of extremal lines from them.
struct ExtremalLineSearch {
    /// The exact rays of the cone.
    rays: Vec<[IBig; 6]>,
    /// The rounded rays.
    near: Vec<[f64; 6]>,
    /// The line that all edges meet, exact and rounded; `None` if no line meets all edges.
    shared: Option<([IBig; 6], [f64; 6])>,
}

impl ExtremalLineSearch {
    fn new(space: &mut Space, cone: &Cone) -> Self {
        let ids: Vec<VectorId> = cone.region.rays.iter().map(|(ray, _)| *ray).collect();
        let rays: Vec<[IBig; 6]> = ids.iter().map(|ray| space.exact(*ray).clone()).collect();
        let near = rays.iter().map(rounded).collect();
        Self {
            rays,
            near,
            shared: cone
                .shared
                .as_ref()
                .map(|line| (line.clone(), rounded(line))),
        }
    }

    /// Computes the extremal line of a ray of the quotient, and increments `lines`, the number of extremal
    /// lines so far. The result is `None` if the line is at infinity.
    fn of_ray(&self, ray: usize, lines: &mut usize) -> Option<ExtremalLine> {
        let (shared, _) = self.shared.as_ref()?;
        if klein_exact(&self.rays[ray], shared).is_zero() {
            return None;
        }
        *lines += 1;
        Some(ExtremalLine {
            number: *lines - 1,
            line: self.on_quadric(&self.near[ray]),
        })
    }

    /// Computes the vector x + tl on the quadric for the shared line l, or returns x if no line is shared.
    fn on_quadric(&self, x: &[f64; 6]) -> [f64; 6] {
        let Some((_, shared)) = &self.shared else {
            return *x;
        };
        let t = -klein(x, x) / (2.0 * klein(x, shared));
        scaled(&std::array::from_fn(|k| x[k] + shared[k] * t))
    }

    /// Returns true if the form of a ray with itself is not negative.
    fn is_up(&self, ray: usize) -> bool {
        sign(&klein_exact(&self.rays[ray], &self.rays[ray])) != Ordering::Less
    }

    /// Computes the points of the quadric on an edge, in order from its first ray to its second.
    ///
    /// The numbers of the extremal lines start at `number`. A ray on the quadric counts as above the quadric.
    fn crossings(&self, [i, j]: [usize; 2], number: usize) -> Vec<ExtremalLine> {
        let (u, v) = (&self.rays[i], &self.rays[j]);
        let [uu, uv, vv] = [klein_exact(u, u), klein_exact(u, v), klein_exact(v, v)];
        let is_up = |x: &IBig| sign(x) != Ordering::Less;
        debug_assert_eq!(
            (is_up(&uu), is_up(&vv)),
            (self.is_up(i), self.is_up(j)),
            "the ends of an edge have the signs of their rays"
        );
        let count = if is_up(&uu) != is_up(&vv) {
            1
        } else if is_up(&uv) != is_up(&uu) && sign(&(&uv * &uv - &uu * &vv)) == Ordering::Greater {
            2
        } else {
            return Vec::new();
        };
        // The form along the edge is q(s) = (1 − s)² K(u, u) + 2 s (1 − s) K(u, v) + s² K(v, v), rounded.
        let (a, b) = (&self.near[i], &self.near[j]);
        let [uu, uv, vv] = [klein(a, a), klein(a, b), klein(b, b)];
        let (p, q, r) = (uu - 2.0 * uv + vv, uv - uu, uu);
        let root = (q * q - p * r).max(0.0).sqrt();
        // These are both roots of p s² + 2 q s + r, computed without cancellation.
        let t = -(q + root.copysign(q));
        let mut roots = [t / p, r / t];
        roots.sort_by(f64::total_cmp);
        let line =
            |s: f64| -> [f64; 6] { scaled(&std::array::from_fn(|k| a[k] * (1.0 - s) + b[k] * s)) };
        let within = |s: f64| (s - 0.5).abs();
        if count == 1 {
            let s = if within(roots[0]) < within(roots[1]) || roots[1].is_nan() {
                roots[0]
            } else {
                roots[1]
            };
            return vec![ExtremalLine {
                number,
                line: line(s.clamp(0.0, 1.0)),
            }];
        }
        let both = roots.map(|s| s.clamp(0.0, 1.0));
        vec![
            ExtremalLine {
                number,
                line: line(both[0]),
            },
            ExtremalLine {
                number: number + 1,
                line: line(both[1]),
            },
        ]
    }

    /// Returns true if a swath bounds the lit space, and the surface of the swath.
    fn swath(
        &self,
        portals: &[Polygon],
        touched: &[EdgeOf],
        face: &[usize],
        [a, b]: [ExtremalLine; 2],
    ) -> (bool, Surface) {
        if let Some((vertex, edge)) = vertex_and_edge(portals, touched) {
            return plane_of(portals, vertex, edge);
        }
        // A line in the middle of the arc: from the middle of the chord towards the middle of the face.
        let middle: [f64; 6] = std::array::from_fn(|k| a.line[k] + b.line[k]);
        let line = if self.shared.is_some() {
            self.on_quadric(&middle)
        } else {
            let inner: [f64; 6] =
                std::array::from_fn(|k| face.iter().map(|ray| self.near[*ray][k]).sum());
            let (c, m, e) = (
                klein(&middle, &middle),
                klein(&middle, &inner),
                klein(&inner, &inner),
            );
            let root = (m * m - c * e).max(0.0).sqrt();
            let t = -(m + root.copysign(m));
            let steps = [t / e, c / t];
            let step = if steps[0].abs() < steps[1].abs() || steps[1].is_nan() {
                steps[0]
            } else {
                steps[1]
            };
            let step = if step.is_finite() { step } else { 0.0 };
            std::array::from_fn(|k| middle[k] + inner[k] * step)
        };
        (
            !are_contained(portals, touched, &line),
            Surface::Quadric(quadric_of(portals, touched)),
        )
    }
}

fn rounded(vector: &[IBig; 6]) -> [f64; 6] {
    use dashu_int::ops::BitTest as _;
    // The shift removes bits that doubles cannot represent, so that no component becomes infinite.
    let most = vector.iter().map(|c| c.bit_len()).max().unwrap_or(0);
    let down = most.saturating_sub(900);
    scaled(&vector.each_ref().map(|c| (c >> down).to_f64().value()))
}

fn scaled(vector: &[f64; 6]) -> [f64; 6] {
    let most = vector.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if most > 0.0 {
        vector.map(|c| c / most)
    } else {
        *vector
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arcs_join_circle_around_corners_of_square() {
        // The form is x² + y² − 1.44 z² on vectors of three dimensions; the square has its corners at ±1, z =
        // 1.
        let vector = |x: f64, y: f64| [x, y, 1.2, x / 2.0, y / 2.0, -0.6];
        let at = 0.44f64.sqrt();
        // From the corner (1, 1) on, each side has two crossings.
        let all = [
            (at, 1.0),
            (-at, 1.0),
            (-1.0, at),
            (-1.0, -at),
            (-at, -1.0),
            (at, -1.0),
            (1.0, -at),
            (1.0, at),
        ];
        let crossings: Vec<ExtremalLine> = (0..8)
            .map(|number| ExtremalLine {
                number,
                line: vector(all[number].0, all[number].1),
            })
            .collect();
        let around_corners = [[1, 2], [3, 4], [5, 6], [7, 0]];
        for first in 0..8 {
            let mut turned = crossings.clone();
            turned.rotate_left(first);
            // Between the two crossings of a side, the border is inside the circle.
            let mut found: Vec<[usize; 2]> = arcs(&turned, first % 2 == 1)
                .iter()
                .map(|[a, b]| [a.number, b.number])
                .collect();
            found.sort_unstable();
            assert_eq!(found, around_corners, "from {first} on");
        }
        assert!(arcs(&crossings[..1], true).is_empty());
    }
}
