//! Occluders: sets of triangles that block together, known by the edges around them.
//!
//! Take triangles, each turned one way or the other, and strike out every edge that two of them run along in opposite
//! directions. The signed number of times a line crosses the triangles depends on what is left alone, since two
//! surfaces with the same border differ by a closed one. A line that has every remaining edge on the same side winds
//! around at least once, if any edge remains at all, and so crosses at least one of the triangles. So the remaining edges' half-spaces are the
//! region of line space the set blocks, or part of it (thesis §2.4, silhouettes), whatever its shape: nothing here needs
//! to be convex, flat or even connected to be right. Convex flat sets block most for their number of edges, and
//! those are what [`Occluders`] looks for.

use std::cmp::Ordering;
use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::exact::{orient2d_sign, orient3d_sign};
use sightline_scene::topology::corner_vertices;
use sightline_scene::{Scene, SceneError};

use crate::bvh::Bvh;
use crate::rims::Rims;
use crate::surface::Surfaces;

/// A set of triangles in one plane that block together.
#[derive(Clone, Debug)]
pub struct Occluder {
    /// The triangles, each with whether it is turned round so that all face the same way.
    pub triangles: Vec<(u32, bool)>,
    /// What is left of their edges, directed, in the order of the triangles and their edges.
    pub border: Vec<[Vec3; 2]>,
    /// The same by numbers of corners, equal where positions are.
    pub rim: Vec<[u32; 2]>,
}

impl Occluder {
    /// The corners of the convex polygon it is, in order, those on the line of their neighbours among them.
    pub fn outline(&self) -> Vec<Vec3> {
        let mut at = 0;
        (0..self.border.len())
            .map(|_| {
                let corner = self.border[at][0];
                // Merged faces have one loop, which goes on where an edge ends.
                at = self.rim.iter().position(|e| e[0] == self.rim[at][1]).unwrap_or(at);
                corner
            })
            .collect()
    }
}

/// Everything that blocks in a scene.
pub struct Occluders {
    triangles: Vec<[Vec3; 3]>,
    occluders: Vec<Occluder>,
    /// The occluder of each triangle; none for those without area.
    of: Vec<Option<u32>>,
    /// Whether each triangle is turned round in its occluder.
    turned: Vec<bool>,
    rims: Rims,
    /// Three corner numbers a triangle.
    corners: Vec<u32>,
    bvh: Bvh,
    reach: f64,
    surfaces: OnceLock<Surfaces>,
}

/// Longest border of a merged occluder.
const MOST_EDGES: usize = 24;

impl Occluders {
    /// Joins the coplanar neighbours of a scene into convex occluders and prepares for tracing, on all of rayon's threads.
    ///
    /// # Errors
    /// As [`corner_vertices`]: when the scene has more corners than can be numbered.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        let corners = corner_vertices(scene)?;
        let triangles: Vec<[Vec3; 3]> = scene.triangles().iter().map(|t| t.v).collect();
        let solid: Vec<bool> = scene.triangles().par_iter().map(|t| !t.is_degenerate()).collect();
        let joined = || {
            let mut faces = Faces::new(&triangles, &corners, &solid);
            faces.merge();
            let (occluders, of) = faces.finish();
            let rims = Rims::new(&occluders);
            let mut turned = vec![false; triangles.len()];
            occluders.iter().flat_map(|o| &o.triangles).for_each(|(t, turn)| turned[*t as usize] = *turn);
            (occluders, of, turned, rims)
        };
        let hierarchy = || {
            let boxes = scene.triangles().iter().map(|t| [t.bounds().min, t.bounds().max]).collect();
            let items = (0..triangles.len() as u32).filter(|i| solid[*i as usize]).collect();
            Bvh::new(boxes, items)
        };
        let ((occluders, of, turned, rims), bvh) = rayon::join(joined, hierarchy);
        let b = scene.bounds();
        let reach = f64::from(b.min.abs().max(b.max.abs()).max_element());
        Ok(Self { triangles, occluders, of, turned, rims, corners, bvh, reach, surfaces: OnceLock::new() })
    }

    /// A triangle's vertices.
    pub fn triangle(&self, id: u32) -> &[Vec3; 3] {
        &self.triangles[id as usize]
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether there is no triangle; a scene has at least one.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The occluder a triangle is part of.
    pub fn of(&self, triangle: u32) -> Option<u32> {
        self.of[triangle as usize]
    }

    /// The occluder of a triangle that a line goes through, and whether the line passes the occluder's edges on their negative side.
    /// `front` says whether it comes from the side the triangle's corners are seen counter-clockwise from.
    pub fn passed(&self, triangle: u32, front: bool) -> Option<(u32, bool)> {
        // Down the z axis, (0, 0, −1; 0, 0, 0), with an edge around it from x to y, (−1, 1, 0; 0, 0, 1): K = −1.
        self.of(triangle).map(|id| (id, front != self.turned[triangle as usize]))
    }

    /// An occluder.
    pub fn occluder(&self, id: u32) -> &Occluder {
        &self.occluders[id as usize]
    }

    /// The edges of all occluders' borders.
    pub fn rims(&self) -> &Rims {
        &self.rims
    }

    /// The numbers of a triangle's corners, equal where positions are.
    pub fn corners(&self, id: u32) -> [u32; 3] {
        let at = 3 * id as usize;
        [self.corners[at], self.corners[at + 1], self.corners[at + 2]]
    }

    /// The surfaces that enclose something, found when first asked for. That uses rayon, so ask for them before any of rayon's threads
    /// does: one that waits inside could come back to the same lock.
    pub fn surfaces(&self) -> &Surfaces {
        self.surfaces.get_or_init(|| Surfaces::new(self))
    }

    /// What is left of the edges of some triangles, each perhaps turned round, when opposite ones are struck out.
    pub fn border(&self, members: &[(u32, bool)]) -> (Vec<[u32; 2]>, Vec<[Vec3; 2]>) {
        border(members, &self.triangles, &self.corners)
    }

    /// Number of occluders.
    pub fn count(&self) -> usize {
        self.occluders.len()
    }

    /// The hierarchy over the triangles that have an area.
    pub fn hierarchy(&self) -> &Bvh {
        &self.bvh
    }

    /// The triangles the segment may meet. Its ends are combinations of points no coordinate of which exceeds `size`, rounded
    /// a few times.
    pub fn along(&self, p: glam::DVec3, q: glam::DVec3, size: f64, out: &mut Vec<u32>) {
        self.bvh.along(p, q, self.slack(size), out);
    }

    /// How far a coordinate of such a point may be off.
    pub fn slack(&self, size: f64) -> f64 {
        self.reach.max(size) * 1e-14
    }
}

/// Faces being merged: loops of vertices, counter-clockwise seen from where the first triangle's corners turn so.
struct Faces<'a> {
    triangles: &'a [[Vec3; 3]],
    corners: &'a [u32],
    /// Of each triangle its face, by union-find.
    parent: Vec<u32>,
    /// Of each face (a root): its triangles and border, by corner numbers and positions.
    faces: Vec<Option<Face>>,
    /// Neighbours in one plane, over an edge.
    pairs: Vec<(u32, u32)>,
}

#[derive(Clone)]
struct Face {
    triangles: Vec<(u32, bool)>,
    /// Directed edges by corner numbers and positions.
    border: Vec<Edge>,
    /// The axis to look along, and whether that sees the face turn clockwise.
    axis: usize,
    mirrored: bool,
}

#[derive(Clone, Copy)]
struct Edge {
    from: u32,
    to: u32,
    ends: [Vec3; 2],
}

impl<'a> Faces<'a> {
    fn new(triangles: &'a [[Vec3; 3]], corners: &'a [u32], solid: &[bool]) -> Self {
        let n = triangles.len();
        let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * n);
        for (id, c) in corners.chunks_exact(3).enumerate().filter(|(id, _)| solid[*id]) {
            for k in 0..3 {
                let (a, b) = (c[k], c[(k + 1) % 3]);
                edges.push((a.min(b), a.max(b), id as u32));
            }
        }
        edges.par_sort_unstable();
        let flat = |(s, t): &(u32, u32)| {
            let v = triangles[*s as usize];
            triangles[*t as usize].iter().all(|p| orient3d_sign(v[0], v[1], v[2], *p) == Ordering::Equal)
        };
        let pairs = edges
            .par_windows(2)
            .filter(|pair| (pair[0].0, pair[0].1) == (pair[1].0, pair[1].1))
            .map(|pair| (pair[0].2, pair[1].2))
            .filter(flat)
            .collect();
        let faces = (0..n)
            .into_par_iter()
            .map(|id| solid[id].then(|| Face::of(id as u32, &triangles[id], &corners[3 * id..3 * id + 3])))
            .collect();
        Self { triangles, corners, parent: (0..n as u32).collect(), faces, pairs }
    }

    fn root(&mut self, mut id: u32) -> u32 {
        while self.parent[id as usize] != id {
            self.parent[id as usize] = self.parent[self.parent[id as usize] as usize];
            id = self.parent[id as usize];
        }
        id
    }

    /// Joins neighbours as long as that leaves them convex.
    fn merge(&mut self) {
        let mut pairs = std::mem::take(&mut self.pairs);
        loop {
            let before = pairs.len();
            let mut joined = false;
            pairs.retain(|(s, t)| {
                let (a, b) = (self.root(*s), self.root(*t));
                if a == b {
                    return false;
                }
                let (lo, hi) = (a.min(b), a.max(b));
                let (Some(x), Some(y)) = (&self.faces[lo as usize], &self.faces[hi as usize]) else {
                    return false;
                };
                match x.joined(y, self.triangles) {
                    Some(face) => {
                        self.faces[lo as usize] = Some(face);
                        self.faces[hi as usize] = None;
                        self.parent[hi as usize] = lo;
                        joined = true;
                        false
                    }
                    None => true,
                }
            });
            if !joined || pairs.len() == before {
                return;
            }
        }
    }

    fn finish(mut self) -> (Vec<Occluder>, Vec<Option<u32>>) {
        let n = self.triangles.len();
        let roots: Vec<u32> = (0..n as u32).map(|i| self.root(i)).collect();
        let mut number = vec![None; n];
        let mut kept = Vec::new();
        for (id, face) in self.faces.iter().enumerate() {
            if let Some(face) = face {
                number[id] = Some(kept.len() as u32);
                kept.push(face);
            }
        }
        let occluders = kept.par_iter().map(|face| face.occluder(self.triangles, self.corners)).collect();
        let of = roots.iter().map(|r| number[*r as usize]).collect();
        (occluders, of)
    }
}

impl Face {
    fn of(id: u32, v: &[Vec3; 3], c: &[u32]) -> Self {
        let border =
            (0..3).map(|k| Edge { from: c[k], to: c[(k + 1) % 3], ends: [v[k], v[(k + 1) % 3]] }).collect();
        // Some axis sees the triangle with an area, since it has one; which is decided exactly.
        let turn = |axis: usize| orient2d_sign(flat(v[0], axis), flat(v[1], axis), flat(v[2], axis));
        let axis = (0..3).find(|k| turn(*k) != Ordering::Equal).unwrap_or(0);
        Self { triangles: vec![(id, false)], border, axis, mirrored: turn(axis) == Ordering::Less }
    }

    /// Both faces as one, if their union is convex.
    fn joined(&self, other: &Self, triangles: &[[Vec3; 3]]) -> Option<Self> {
        if self.border.len() + other.border.len() > MOST_EDGES + 2 {
            return None;
        }
        // Turned so that both face the same way: seen along the same axis.
        let v = &triangles[other.triangles[0].0 as usize];
        let turned = other.triangles[0].1;
        let clockwise = orient2d_sign(flat(v[0], self.axis), flat(v[1], self.axis), flat(v[2], self.axis))
            == Ordering::Less;
        let flip = (clockwise != turned) != self.mirrored;
        let mut border = self.border.clone();
        for e in &other.border {
            let e = if flip { Edge { from: e.to, to: e.from, ends: [e.ends[1], e.ends[0]] } } else { *e };
            match border.iter().position(|f| f.from == e.to && f.to == e.from) {
                Some(i) => {
                    border.remove(i);
                }
                None => border.push(e),
            }
        }
        if border.len() < 3 || border.len() == self.border.len() + other.border.len() {
            return None;
        }
        // One loop, every turn to the left or straight on.
        let mut at = 0;
        for step in 1..=border.len() {
            let mut next = border.iter().enumerate().filter(|(_, e)| e.from == border[at].to);
            let (Some((i, e)), None) = (next.next(), next.next()) else { return None };
            let ([a, b], c) = (border[at].ends, e.ends[1]);
            let turn = orient2d_sign(flat(a, self.axis), flat(b, self.axis), flat(c, self.axis));
            let right = if self.mirrored { Ordering::Greater } else { Ordering::Less };
            if turn == right {
                return None;
            }
            at = i;
            if (at == 0) != (step == border.len()) {
                return None;
            }
        }
        // Turning left all the way can also go round twice; no corner may be to the right of any edge.
        let right = if self.mirrored { Ordering::Greater } else { Ordering::Less };
        let outside = |e: &Edge, p: Vec3| {
            orient2d_sign(flat(e.ends[0], self.axis), flat(e.ends[1], self.axis), flat(p, self.axis)) == right
        };
        if border.iter().any(|e| border.iter().any(|f| outside(e, f.ends[0]))) {
            return None;
        }
        let mut all = self.triangles.clone();
        all.extend(other.triangles.iter().map(|(t, f)| (*t, *f != flip)));
        Some(Self { triangles: all, border, axis: self.axis, mirrored: self.mirrored })
    }

    /// As an occluder, its border in the order that its triangles give.
    fn occluder(&self, triangles: &[[Vec3; 3]], corners: &[u32]) -> Occluder {
        let mut members = self.triangles.clone();
        members.sort_unstable();
        let (rim, border) = border(&members, triangles, corners);
        Occluder { triangles: members, border, rim }
    }
}

/// The edges that remain when opposite ones are struck out, in the order of the triangles and of their edges.
fn border(
    members: &[(u32, bool)],
    triangles: &[[Vec3; 3]],
    corners: &[u32],
) -> (Vec<[u32; 2]>, Vec<[Vec3; 2]>) {
    let mut left: Vec<([u32; 2], [Vec3; 2])> = Vec::new();
    for (t, turned) in members {
        let (c, v) = (&corners[3 * *t as usize..], &triangles[*t as usize]);
        for k in 0..3 {
            let (i, j) = if *turned { ((k + 1) % 3, k) } else { (k, (k + 1) % 3) };
            match left.iter().rposition(|(e, _)| *e == [c[j], c[i]]) {
                Some(at) => {
                    left.remove(at);
                }
                None => left.push(([c[i], c[j]], [v[i], v[j]])),
            }
        }
    }
    left.into_iter().unzip()
}

fn flat(p: Vec3, axis: usize) -> [f32; 2] {
    [p[(axis + 1) % 3], p[(axis + 2) % 3]]
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;
    use sightline_scene::{Object, Triangle};

    use super::*;

    proptest! {
        /// Lines through the inside of one of two triangles that are one occluder, whichever way each is given.
        #[test]
        fn edges_are_passed_on_the_side_that_is_said(
            corners in prop::array::uniform3(prop::array::uniform2(-8i32..9)), turned in prop::array::uniform2(any::<bool>()),
            tilt in prop::array::uniform2(-3i32..4), along in prop::array::uniform3(-9i32..10), weights in prop::array::uniform3(1i32..5),
            second in any::<bool>(),
        ) {
            // In a plane that is no coordinate plane; a parallelogram of both triangles, so that all are integers.
            let at = |[x, y]: [i32; 2]| DVec3::new(f64::from(x), f64::from(y), f64::from(tilt[0] * x + tilt[1] * y));
            let [a, b, c] = corners.map(at);
            let d = b + c - a;
            let normal = (b - a).cross(c - a);
            let along = DVec3::from(along.map(f64::from));
            prop_assume!(normal.dot(along) != 0.0);
            let shapes: Vec<[DVec3; 3]> = [[a, b, c], [d, c, b]]
                .into_iter()
                .zip(turned)
                .map(|([p, q, r], turned)| if turned { [p, r, q] } else { [p, q, r] })
                .collect();
            let triangles = shapes.iter().map(|t| Triangle { v: t.map(|p| p.as_vec3()) }).collect();
            let object = Object { name: "all".to_owned(), first: 0, count: 2 };
            let scene = Occluders::new(&Scene::new("two", triangles, vec![object]).unwrap()).unwrap();
            prop_assert_eq!(scene.count(), 1);
            let [p, q, r] = shapes[usize::from(second)];
            // A point inside, times the sum of the weights, and the line through it.
            let w = weights.map(f64::from);
            let (x, total) = (p * w[0] + q * w[1] + r * w[2], w[0] + w[1] + w[2]);
            let (way, moment) = (along * total, x.cross(along));
            let front = (q - p).cross(r - p).dot(along) < 0.0;
            let (id, negative) = scene.passed(u32::from(second), front).unwrap();
            for [s, t] in &scene.occluder(id).border {
                let (s, t) = (s.as_dvec3(), t.as_dvec3());
                let form = way.dot(s.cross(t)) + moment.dot(t - s);
                prop_assert!(form != 0.0 && (form < 0.0) == negative, "{} {}", form, negative);
            }
        }
    }
}
