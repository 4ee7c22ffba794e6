//! The checker: whether a proof shows that one polygon is hidden from another, and whether a witness shows that it is
//! not. Integers only; nothing here is shared with the search but the number type, the scene, and what evidence says: its types,
//! the order of a box's faces, and how many odd edges a surface may have. None of these can make a false claim true.
//!
//! What a proof claims, and what is checked:
//!
//! 1. *Parts.* Each polygon is cut along the plane of the other. Lines run between parts alone, each of which is on one
//!    side of the other's plane. A polygon in the other's plane leaves no open set of lines.
//! 2. *The start.* All lines from A to B are positive combinations of the lines through their vertex pairs, because
//!    (Σλᵢaᵢ) ∧ (Σμⱼbⱼ) = Σλᵢμⱼ aᵢ∧bⱼ. So the cone of these holds them all. If the line k of both planes is among them in
//!    both directions the cone holds a whole line; the hyperplane of the line through the first vertex of A and the first of
//!    B off the other's plane, which does not meet k, then divides it in two.
//! 3. *Blocked.* A cone is blocked when each of its rays, and so each line in it, passes every border edge of an occluder
//!    on the same side (see the module on occluders for why that means crossing it; there must be a border, or it means nothing), and the crossing is between A and B: all of
//!    the occluder is on B's side of A's plane and on A's side of B's, or it lies in one plane and the cone is on the right
//!    side of the line in which that plane meets A's or B's. Triangles in A's or B's plane block nothing.
//! 4. *Unreal.* If the Klein form has one sign on all pairs of rays it has that sign on the cone, 0 at most on its border: no
//!    open set of real lines.
//! 5. *Split.* A hyperplane divides a cone into two, and what is proved of both is proved of the cone.

mod cell;
mod cone;
mod line;
mod near;
mod surfaces;
mod vector;
mod witness;

use std::cmp::Ordering;
use std::collections::BTreeMap;

use dashu_int::IBig;
use glam::{DVec3, Vec3};

use crate::proof::{Proof, Step, Which};
pub use cell::{CellClaims, CellRefusal, Claim, check_cell};
use cone::Cone;
use line::{Line, Plane, Point, height, join, meet, plane, point, reduced, sign};
pub use near::Triangles;
use vector::Vector;
pub use witness::check_witness;

/// Why a proof or a witness is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The proof ends before everything is shown, or goes on after it.
    #[error("it has {0} steps")]
    Length(&'static str),
    /// An occluder of the proof names a triangle that is not there, or has no border, or an edge without length.
    #[error("occluder {0} is none: a triangle is not in the scene or has no area, or no border is left")]
    Occluder(usize),
    /// A polygon of the query is not convex, not flat, or has no area.
    #[error("a polygon of the query is not convex and flat, or a corner of it is no point")]
    Polygon,
    /// The lines between two polygons do not span line space; of convex flat polygons they do.
    #[error("the lines between two polygons are no region of line space")]
    Start,
    /// A step names something that is not there.
    #[error("step {step} names {what}, which is not there")]
    Unknown {
        /// Which step.
        step: usize,
        /// What it names.
        what: &'static str,
    },
    /// A step claims what is not so.
    #[error("step {step}: {what}")]
    False {
        /// Which step.
        step: usize,
        /// What is not so.
        what: &'static str,
    },
    /// The witness does not begin inside A or end inside B, or meets a triangle.
    #[error("{0}")]
    Witness(String),
}

/// A polygon given by its corners, convex and flat.
pub type Corners = Vec<[IBig; 4]>;

/// Corners in doubles as exact points.
pub fn corners(of: &[DVec3]) -> Corners {
    of.iter().map(|p| point(p.to_array())).collect()
}

/// Accepts a proof that `b` is hidden from `a` in the scene, or says what is wrong with it.
///
/// `a` and `b` are lists of convex flat polygons (a polygon that is flat up to rounding is the triangles of its fan).
///
/// # Errors
/// [`Refusal`].
pub fn check_hidden(scene: &[[Vec3; 3]], a: &[Corners], b: &[Corners], proof: &Proof) -> Result<(), Refusal> {
    check_polygons(a)?;
    check_polygons(b)?;
    let mut occluders = Vec::with_capacity(proof.occluders.len());
    for triangles in &proof.occluders {
        occluders.push(Blocker::new(scene, triangles).ok_or(Refusal::Occluder(occluders.len()))?);
    }
    let mut check = Check { steps: &proof.steps, at: 0, occluders };
    for x in a {
        for y in b {
            for (x, y) in parts(x, y) {
                check.pair(&x, &y)?;
            }
        }
    }
    if check.at < proof.steps.len() { Err(Refusal::Length("too many")) } else { Ok(()) }
}

/// Refuses what is no list of convex flat polygons, none of whose corners lies on the line of two others that follow each other.
fn check_polygons(of: &[Corners]) -> Result<(), Refusal> {
    let sound = |c: &Corners| {
        let n = c.len();
        if n < 3 || c.iter().any(|p| sign(&p[3]) != Ordering::Greater) {
            return false;
        }
        let flat = plane([&c[0], &c[1], &c[2]]);
        let off: Point =
            std::array::from_fn(|i| if i < 3 { &c[0][i] + &flat[i] * &c[0][3] } else { c[0][3].clone() });
        let left = |i: usize, k: usize| sign(&height(&plane([&c[i], &c[(i + 1) % n], &off]), &c[k]));
        let inner = left(0, 2);
        inner != Ordering::Equal
            && c.iter().all(|p| height(&flat, p).is_zero())
            && (0..n).all(|i| (0..n).filter(|k| *k != i && *k != (i + 1) % n).all(|k| left(i, k) == inner))
    };
    if of.iter().all(sound) { Ok(()) } else { Err(Refusal::Polygon) }
}

/// An occluder, from nothing but its triangles.
struct Blocker {
    corners: Vec<[Point; 3]>,
    border: Vec<Constraint>,
    /// Its plane, if all triangles lie in one and face one way.
    plane: Option<Plane>,
}

impl Blocker {
    fn new(scene: &[[Vec3; 3]], triangles: &[(u32, bool)]) -> Option<Self> {
        let mut corners = Vec::with_capacity(triangles.len());
        for (t, turned) in triangles {
            let [a, b, c] = *scene.get(*t as usize)?;
            let turned = if *turned { [a, c, b] } else { [a, b, c] };
            corners.push(turned.map(|v| point(v.as_dvec3().to_array())));
        }
        let mut left: Vec<(&Point, &Point)> = Vec::new();
        for (k, (_, turned)) in triangles.iter().enumerate() {
            let [x, y, z] = &corners[k];
            // Edges in the triangle's own order: 01, 12, 20.
            let edges = if *turned { [(z, x), (y, z), (x, y)] } else { [(x, y), (y, z), (z, x)] };
            for (p, q) in edges {
                match left.iter().rposition(|(r, s)| *r == q && *s == p) {
                    Some(at) => {
                        left.remove(at);
                    }
                    None => left.push((p, q)),
                }
            }
        }
        // An edge of no length turns no line round, and where nothing is left there is nothing to wind around.
        let border: Vec<Line> = left.iter().map(|(p, q)| join(p, q)).collect();
        if border.is_empty() || border.iter().any(|l| l.iter().all(IBig::is_zero)) {
            return None;
        }
        let numbered = border.into_iter().enumerate();
        let border = numbered.map(|(i, l)| Constraint { number: i, line: Vector::new(l) }).collect();
        // A plane only where all triangles lie in one and face one way: on which side of it a line crosses is then the same
        // for all of them, and the same as the border says.
        let planes: Vec<Plane> = corners.iter().map(|[a, b, c]| plane([a, b, c])).collect();
        let flat = planes.first()?;
        let ahead = |p: &Plane| sign(&(0..3).map(|i| &p[i] * &flat[i]).sum()) == Ordering::Greater;
        let one = planes.iter().all(ahead) && corners.iter().flatten().all(|p| height(flat, p).is_zero());
        let flat = one.then(|| flat.clone());
        Some(Self { plane: flat, border, corners })
    }
}

/// A polygon of a pair, and the plane it lies in.
struct Side {
    corners: Vec<Point>,
    plane: Plane,
    /// Which side of the plane the other polygon is on.
    other: Ordering,
}

struct Check<'a> {
    steps: &'a [Step],
    at: usize,
    occluders: Vec<Blocker>,
}

impl<'a> Check<'a> {
    fn next(&mut self) -> Result<&'a Step, Refusal> {
        let step = self.steps.get(self.at).ok_or(Refusal::Length("too few"))?;
        self.at += 1;
        Ok(step)
    }

    fn pair(&mut self, a: &[Point], b: &[Point]) -> Result<(), Refusal> {
        // Divisions can be nested; each adds a step, so the stack is no longer than the proof.
        let mut open = vec![(a.to_vec(), b.to_vec())];
        while let Some((a, b)) = open.pop() {
            if let Some(Step::Divide { of, from, to }) = self.steps.get(self.at) {
                let unknown = Refusal::Unknown { step: self.at, what: "a point of a polygon" };
                self.at += 1;
                let whole = if *of == Which::A { &a } else { &b };
                let [first, second] = divide(whole, *from, *to).ok_or(unknown)?;
                let with = |half| if *of == Which::A { (half, b.clone()) } else { (a.clone(), half) };
                open.extend([with(second), with(first)]);
                continue;
            }
            let (pa, pb) = (plane([&a[0], &a[1], &a[2]]), plane([&b[0], &b[1], &b[2]]));
            let other = |p: &Plane, c: &[Point]| {
                c.iter()
                    .map(|x| sign(&height(p, x)))
                    .find(|s| *s != Ordering::Equal)
                    .unwrap_or(Ordering::Equal)
            };
            let (ahead, behind) = (other(&pa, &b), other(&pb, &a));
            let a = Side { corners: a, plane: pa, other: ahead };
            let b = Side { corners: b, plane: pb, other: behind };
            let mut known = Known::new();
            for cone in start(&a, &b) {
                self.region((&a, &b), &mut known, cone.ok_or(Refusal::Start)?)?;
            }
        }
        Ok(())
    }

    /// Checks the steps about one cone; where A and B cut an occluder is `known` once one was asked about.
    fn region(&mut self, (a, b): (&Side, &Side), known: &mut Known, cone: Cone) -> Result<(), Refusal> {
        let mut open = vec![Some(cone)];
        while let Some(cone) = open.pop() {
            let at = self.at;
            match self.next()? {
                Step::Unreal => {
                    if cone.is_some_and(|c| !c.unreal()) {
                        return Err(Refusal::False { step: at, what: "there are real lines left" });
                    }
                }
                Step::Block { occluder, negative, cuts } => {
                    let number = *occluder as usize;
                    let occluder = self
                        .occluders
                        .get(number)
                        .ok_or(Refusal::Unknown { step: at, what: "an occluder" })?;
                    let planes = known.entry(number).or_insert_with(|| occluder.planes(a, b));
                    let planes = planes.as_ref().map_err(|what| Refusal::False { step: at, what })?;
                    let constraints = || occluder.border.iter().chain(planes);
                    let inner = if *negative { Ordering::Less } else { Ordering::Greater };
                    let mut rest = cone;
                    let mut outside = Vec::with_capacity(cuts.len());
                    for cut in cuts {
                        let line = &constraints()
                            .find(|c| c.number == usize::from(*cut))
                            .ok_or(Refusal::Unknown { step: at, what: "a constraint" })?
                            .line;
                        let (positive, beyond) = rest.map_or((None, None), |c| c.split(line));
                        let (inside, out) = if *negative { (beyond, positive) } else { (positive, beyond) };
                        outside.push(out);
                        rest = inside;
                    }
                    // What is left is within those it was cut by.
                    let mut others =
                        constraints().filter(|c| !cuts.iter().any(|cut| usize::from(*cut) == c.number));
                    if rest.is_some_and(|c| !others.all(|other| c.within(&other.line, inner))) {
                        return Err(Refusal::False {
                            step: at,
                            what: "the occluder does not block all of it",
                        });
                    }
                    open.extend(outside.into_iter().rev());
                }
                Step::Split { polar } => {
                    let polar = Vector::new((**polar).clone());
                    let (positive, negative) = cone.map_or((None, None), |c| c.split(&polar));
                    open.extend([positive, negative]);
                }
                Step::Divide { .. } => {
                    return Err(Refusal::False { step: at, what: "a polygon cannot be halved here" });
                }
            }
        }
        Ok(())
    }
}

/// A half-space that lines which an occluder blocks are all in, or all in the opposite of.
#[derive(Clone)]
struct Constraint {
    number: usize,
    line: Vector,
}

/// By occluder, where the polygons' planes cut it, or why it blocks nothing between them.
type Known = BTreeMap<usize, Result<Vec<Constraint>, &'static str>>;

impl Blocker {
    /// The half-spaces besides those of the border that must hold for lines from A to B to be blocked.
    fn planes(&self, a: &Side, b: &Side) -> Result<Vec<Constraint>, &'static str> {
        let mut out = Vec::new();
        for (k, side) in [a, b].into_iter().enumerate() {
            let places: Vec<[Ordering; 3]> =
                self.corners.iter().map(|t| t.each_ref().map(|p| sign(&height(&side.plane, p)))).collect();
            if places.contains(&[Ordering::Equal; 3]) {
                return Err("a triangle in the plane of a polygon of the query blocks nothing");
            }
            if places.iter().flatten().all(|place| *place != side.other.reverse()) {
                continue;
            }
            let own =
                self.plane.as_ref().ok_or("an occluder that is not flat must be between the polygons")?;
            let toward = if side.other == Ordering::Less {
                side.plane.clone().map(|c| -c)
            } else {
                side.plane.clone()
            };
            let number = self.border.len() + k;
            out.push(Constraint { number, line: Vector::new(meet(&toward, own)) });
        }
        Ok(out)
    }
}

/// The cones that hold all lines from A to B.
fn start(a: &Side, b: &Side) -> Vec<Option<Cone>> {
    let mut lines = Vec::new();
    let mut along = Vec::new();
    let mut across = None;
    for p in &a.corners {
        for q in &b.corners {
            let line = join(p, q);
            let on = [height(&b.plane, p).is_zero(), height(&a.plane, q).is_zero()];
            if line.iter().all(IBig::is_zero) {
                continue;
            }
            if on == [true, true] {
                along.push(line.clone());
            } else if on == [false, false] && across.is_none() {
                across = Some(line.clone());
            }
            lines.push(line);
        }
    }
    let k = meet(&a.plane, &b.plane);
    // Multiples of k both of them, so the sign of any component that is not 0 tells.
    let way = |l: &Line| l.iter().zip(&k).map(|(x, y)| sign(&(x * y))).find(|s| *s != Ordering::Equal);
    let both = along.iter().any(|l| way(l) == Some(Ordering::Greater))
        && along.iter().any(|l| way(l) == Some(Ordering::Less));
    match (both, across) {
        (true, Some(across)) => {
            let at_k = line::klein(&k, &across);
            // v·f(k) − f(v)·k lies on the hyperplane; turned so that v counts positively.
            let base: Vec<Line> = lines
                .iter()
                .map(|v| {
                    let at_v = line::klein(v, &across);
                    let flip = sign(&at_k) == Ordering::Less;
                    std::array::from_fn(|i| {
                        let x = &v[i] * &at_k - &k[i] * &at_v;
                        if flip { -x } else { x }
                    })
                })
                .filter(|v: &Line| !v.iter().all(IBig::is_zero))
                .collect();
            [k.clone(), k.map(|c| -c)]
                .into_iter()
                .map(|end| {
                    let mut rays = base.clone();
                    rays.push(end);
                    Cone::of(rays)
                })
                .collect()
        }
        _ => vec![Cone::of(lines)],
    }
}

/// The parts of two polygons, each on one side of the other's plane.
fn parts(a: &[Point], b: &[Point]) -> Vec<(Vec<Point>, Vec<Point>)> {
    let (pa, pb) = (plane([&a[0], &a[1], &a[2]]), plane([&b[0], &b[1], &b[2]]));
    let mut out = Vec::new();
    for keep_a in [Ordering::Greater, Ordering::Less] {
        for keep_b in [Ordering::Greater, Ordering::Less] {
            if let (Some(x), Some(y)) = (clip(a, &pb, keep_a), clip(b, &pa, keep_b)) {
                out.push((x, y));
            }
        }
    }
    out
}

/// What of a polygon is on one side of a plane; none if nothing but perhaps its border is.
fn clip(corners: &[Point], plane: &Plane, keep: Ordering) -> Option<Vec<Point>> {
    let heights: Vec<IBig> = corners.iter().map(|p| height(plane, p)).collect();
    if !heights.iter().any(|h| sign(h) == keep) {
        return None;
    }
    let n = corners.len();
    let mut out = Vec::new();
    for i in 0..n {
        let j = (i + 1) % n;
        if sign(&heights[i]) != keep.reverse() {
            out.push(corners[i].clone());
        }
        if sign(&(&heights[i] * &heights[j])) == Ordering::Less {
            // |h(i)| of j and |h(j)| of i: where the edge meets the plane.
            let weight = |h: &IBig| if sign(h) == Ordering::Less { -h.clone() } else { h.clone() };
            let (s, t) = (weight(&heights[i]), weight(&heights[j]));
            out.push(reduced(std::array::from_fn(|k| &corners[j][k] * &s + &corners[i][k] * &t)));
        }
    }
    Some(out)
}

/// The parts of a polygon on both sides of the line through two of its points, as [`Step::Divide`] numbers them.
fn divide(corners: &[Point], from: u16, to: u16) -> Option<[Vec<Point>; 2]> {
    let n = 2 * corners.len();
    let (from, to) = (usize::from(from), usize::from(to));
    if from >= n || to >= n {
        return None;
    }
    // The two points must not be on one edge, or a part would have no area.
    let apart = (to + n - from) % n;
    let edge_apart = |d: usize, at: usize| d > if at.is_multiple_of(2) { 2 } else { 1 };
    if !edge_apart(apart, from) || !edge_apart((n - apart) % n, to) {
        return None;
    }
    let place = |number: usize| {
        let (p, q) = (&corners[number / 2], &corners[(number / 2 + 1) % corners.len()]);
        if number.is_multiple_of(2) {
            return p.clone();
        }
        let mut middle: Point = std::array::from_fn(|k| &p[k] * &q[3] + &q[k] * &p[3]);
        middle[3] = &p[3] * &q[3] * 2;
        // Or the numbers would double in length with every halving of what was halved.
        reduced(middle)
    };
    let round = |from: usize, to: usize| {
        let mut out = vec![place(from)];
        let mut at = (from + 1) % n;
        while at != to {
            if at.is_multiple_of(2) {
                out.push(place(at));
            }
            at = (at + 1) % n;
        }
        out.push(place(to));
        out
    };
    Some([round(from, to), round(to, from)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two squares that face each other, 10 apart, and triangles.
    fn squares() -> [Vec<Corners>; 2] {
        [0.0, 10.0].map(|z| {
            vec![corners(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| DVec3::new(x, y, z)))]
        })
    }

    fn refused(scene: &[[Vec3; 3]], occluder: Vec<(u32, bool)>) -> Option<Refusal> {
        let [a, b] = squares();
        let block = |negative| Step::Block { occluder: 0, negative, cuts: Vec::new() };
        let proofs =
            [false, true].map(|n| Proof { occluders: vec![occluder.clone()], steps: vec![block(n)] });
        let [x, y] = proofs.map(|p| check_hidden(scene, &a, &b, &p));
        x.err().and(y.err())
    }

    #[test]
    fn a_large_triangle_blocks_and_one_that_is_aside_does_not() {
        let v = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        let wall = [v(-9.0, -9.0, 5.0), v(30.0, -9.0, 5.0), v(-9.0, 30.0, 5.0)];
        assert_eq!(refused(&[wall], vec![(0, false)]), None);
        let aside = wall.map(|p| p + Vec3::X * 50.0);
        assert!(matches!(refused(&[aside], vec![(0, false)]), Some(Refusal::False { .. })));
        let behind = wall.map(|p| p + Vec3::Z * 50.0);
        assert!(matches!(refused(&[behind], vec![(0, false)]), Some(Refusal::False { .. })));
        // In B's plane it blocks nothing.
        let in_plane = wall.map(|p| p + Vec3::Z * 5.0);
        assert!(matches!(refused(&[in_plane], vec![(0, false)]), Some(Refusal::False { .. })));
        assert_eq!(refused(&[wall], vec![(1, false)]), Some(Refusal::Occluder(0)));
    }

    #[test]
    fn what_has_no_border_or_no_area_is_no_occluder() {
        let v = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        let aside = [v(50.0, 0.0, 5.0), v(60.0, 0.0, 5.0), v(50.0, 9.0, 5.0)];
        // Both sides of a sheet: every edge is struck out.
        assert_eq!(refused(&[aside, aside], vec![(0, false), (1, true)]), Some(Refusal::Occluder(0)));
        assert_eq!(refused(&[aside], vec![]), Some(Refusal::Occluder(0)));
        let point = [v(0.5, 0.5, 5.0); 3];
        assert_eq!(refused(&[point], vec![(0, false)]), Some(Refusal::Occluder(0)));
        let twice = [v(0.5, 0.5, 5.0), v(0.5, 0.5, 5.0), v(2.0, 0.5, 5.0)];
        assert_eq!(refused(&[twice], vec![(0, false)]), Some(Refusal::Occluder(0)));
        // On a line, and through B's plane, where a plane of its own would be asked for.
        let needle = [v(0.5, 0.5, 5.0), v(0.5, 0.5, 15.0), v(0.5, 0.5, 25.0)];
        assert!(refused(&[needle], vec![(0, false)]).is_some());
    }

    #[test]
    fn a_plane_is_no_help_to_triangles_that_do_not_face_one_way() {
        let v = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        // Behind B, and in its plane's way if the first of three copies, which is struck out, might turn the plane round.
        let behind = [v(-9.0, -9.0, 12.0), v(30.0, -9.0, 12.0), v(-9.0, 30.0, 12.0)];
        for first in [false, true] {
            let occluder = vec![(0, first), (0, !first), (0, !first)];
            assert!(matches!(refused(&[behind], occluder), Some(Refusal::False { .. })));
        }
        // One that goes through B's plane and is wholly beside the lines on this side of it.
        let leaning = [v(-9.0, -9.0, 10.5), v(30.0, -9.0, 10.5), v(0.5, 90.0, 9.5)];
        for first in [false, true] {
            let occluder = vec![(0, first), (0, !first), (0, !first)];
            assert!(matches!(refused(&[leaning], occluder), Some(Refusal::False { .. })));
        }
    }

    #[test]
    fn what_is_no_polygon_is_refused() {
        let [a, b] = squares();
        let in_line = [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let bad = [
            corners(&in_line.map(|[x, y]| DVec3::new(x, y, 0.0))),
            a[0][..2].to_vec(),
            a[0].iter().map(|p| p.clone().map(|c| -c)).collect(),
            vec![a[0][0].clone(), a[0][2].clone(), a[0][1].clone(), a[0][3].clone()],
        ];
        for bad in bad {
            assert_eq!(
                check_hidden(&[], std::slice::from_ref(&bad), &b, &Proof::default()),
                Err(Refusal::Polygon)
            );
            let [p, q] = [[0.5, 0.5, 0.0], [0.5, 0.5, 10.0]].map(point);
            assert_eq!(check_witness(&[], &[bad], &b, &p, &q), Err(Refusal::Polygon));
        }
    }

    #[test]
    fn an_end_with_a_negative_weight_is_no_point() {
        let [a, b] = squares();
        let wall = [[-9.0, -9.0, 5.0], [30.0, -9.0, 5.0], [-9.0, 30.0, 5.0]].map(Vec3::from);
        let [p, q] = [[0.5, 0.5, 0.0], [0.5, 0.5, 10.0]].map(point);
        assert_eq!(check_witness(&[], &a, &b, &p, &q), Ok(()));
        assert!(check_witness(&[wall], &a, &b, &p, &q).is_err());
        assert!(check_witness(&[wall], &a, &b, &p, &q.map(|c| -c)).is_err());
    }

    #[test]
    fn a_polygon_is_divided_where_it_can_be() {
        let [a, b] = squares();
        for (from, to) in [(65535, 0), (0, 65535), (0, 1), (0, 2), (1, 1), (1, 2), (7, 0)] {
            let steps = vec![Step::Divide { of: Which::A, from, to }];
            let claim = Proof { occluders: Vec::new(), steps };
            assert!(matches!(check_hidden(&[], &a, &b, &claim), Err(Refusal::Unknown { .. })), "{from} {to}");
        }
        // Halved again and again, the numbers stay short and the proof too short.
        let steps = vec![Step::Divide { of: Which::A, from: 1, to: 5 }; 200];
        let claim = Proof { occluders: Vec::new(), steps };
        assert_eq!(check_hidden(&[], &a, &b, &claim), Err(Refusal::Length("too few")));
    }

    #[test]
    fn the_length_of_a_proof_is_checked() {
        let [a, b] = squares();
        assert_eq!(check_hidden(&[], &a, &b, &Proof::default()), Err(Refusal::Length("too few")));
        let steps = vec![Step::Unreal];
        let claim = Proof { occluders: Vec::new(), steps };
        assert!(matches!(check_hidden(&[], &a, &b, &claim), Err(Refusal::False { step: 0, .. })));
    }
}
