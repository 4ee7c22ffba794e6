//! What the search works with between two parts: their space, sight lines snapped to points of both, and occluders as
//! half-spaces.

use std::cmp::Ordering;
use std::collections::{BTreeMap, HashMap};

use dashu_int::IBig;
use glam::DVec3;

use crate::cone::Region;
use crate::frame::Source;
use crate::occluder::Occluders;
use crate::polygon::Polygon;
use crate::prism::{self, Pair};
use crate::proof::Step;
use crate::vector::{Id, Space, Through};

/// A step of a proof, and the regions that are left to be taken apart.
pub type Found = (Step, Vec<Region>);
/// An end of a sight line: a point of the space, and its rounded place in the world.
pub type Snapped = (u32, DVec3);

/// Weights of a snapped point add up to this.
const WEIGHTS: u64 = 1 << 50;

/// Most occluders that are joined to one for the sake of a region.
const MOST_MEMBERS: usize = 12;

/// Bits of the weights of a point that is snapped precisely.
const FINE: usize = 240;

/// An occluder as half-spaces of one pair's space.
pub struct Constraints {
    /// The occluders of the scene it is made of, each with whether it is turned round; ascending.
    pub members: Vec<(u32, bool)>,
    /// Whether all of it is between the polygons.
    pub between: bool,
    /// Line, whether it runs the other way, and the constraint's number in a proof.
    pub lines: Vec<(Id, bool, u16)>,
}

/// One line for all edges that run along it.
#[derive(Default)]
pub struct EdgeLines {
    /// By an edge's ends as bits: its line, and whether that runs the other way.
    edges: HashMap<[u32; 6], (Id, bool)>,
    /// By their fingerprints: what is the same line is in the same bucket, or the next.
    buckets: HashMap<i64, Vec<Id>>,
}

impl EdgeLines {
    /// The lines that may be the same as one with a fingerprint.
    fn near(&self, fingerprint: i64) -> Vec<Id> {
        (fingerprint - 1..=fingerprint + 1).filter_map(|b| self.buckets.get(&b)).flatten().copied().collect()
    }
}

/// What belongs to one pair of parts.
pub struct Local<'a> {
    pub space: Space,
    pub pair: Pair,
    pub known: Vec<Constraints>,
    /// Where in `known` a set of occluders is.
    pub places: BTreeMap<Vec<(u32, bool)>, usize>,
    /// Lines made for occluders' edges.
    pub lines: EdgeLines,
    /// Both polygons, with their vertices rounded.
    pub ends: [(&'a Polygon, &'a [DVec3]); 2],
}

impl Local<'_> {
    /// A real line near `line`, between points strictly inside both polygons: points of the space and rounded ones.
    pub fn snap(&mut self, line: &[f64; 6]) -> Option<(Snapped, Snapped)> {
        let p = self.snap_end(line, 0)?;
        let q = self.snap_end(line, 1)?;
        Some((p, q))
    }

    fn snap_end(&mut self, line: &[f64; 6], end: usize) -> Option<Snapped> {
        let ids = if end == 0 { &self.pair.a } else { &self.pair.b };
        let at = prism::crossing_point(&self.space, line, ids);
        if !at.is_finite() {
            return None;
        }
        let corner = |i: usize| DVec3::from(self.space.point_at(ids[i]).at);
        let o = corner(0);
        // The triangle of the fan that the point is in, or nearest to being in.
        let mut best: Option<(f64, usize, [f64; 3])> = None;
        for i in 1..ids.len() - 1 {
            let (x, y, d) = (corner(i) - o, corner(i + 1) - o, at - o);
            let n = x.cross(y);
            let area = n.length_squared();
            let (s, t) = (d.cross(y).dot(n) / area, x.cross(d).dot(n) / area);
            let w = [1.0 - s - t, s, t];
            let least = w[0].min(w[1]).min(w[2]);
            if least.is_finite() && best.is_none_or(|(l, _, _)| least > l) {
                best = Some((least, i, w));
            }
        }
        let (_, i, w) = best?;
        let total = WEIGHTS as f64;
        // A corner's weight is at least one unit, so that the point is inside.
        let s = ((w[1] * total) as i64).clamp(1, WEIGHTS as i64 - 2) as u64;
        let t = ((w[2] * total) as i64).clamp(1, (WEIGHTS - 1 - s) as i64) as u64;
        let weights = [WEIGHTS - s - t, s, t];
        Some(self.mixed(end, i, weights.map(IBig::from), weights.map(|w| w as f64 / total)))
    }

    /// A point of the `i`-th triangle of a polygon's fan.
    fn mixed(&mut self, end: usize, i: usize, weights: [IBig; 3], shares: [f64; 3]) -> Snapped {
        let ids = if end == 0 { &self.pair.a } else { &self.pair.b };
        let of = [ids[0], ids[i], ids[i + 1]];
        let near = self.ends[end].1;
        let near = near[0] * shares[0] + near[i] * shares[1] + near[i + 1] * shares[2];
        (self.space.mixed(of, weights, shares), near)
    }

    /// As [`Local::snap`], for a line in integers, to [`FINE`] bits.
    pub fn snap_precisely(&mut self, line: &[IBig; 6]) -> Option<(Snapped, Snapped)> {
        let p = self.snap_end_precisely(line, 0)?;
        let q = self.snap_end_precisely(line, 1)?;
        Some((p, q))
    }

    fn snap_end_precisely(&mut self, line: &[IBig; 6], end: usize) -> Option<Snapped> {
        let ids = if end == 0 { self.pair.a.clone() } else { self.pair.b.clone() };
        let corners: Vec<[IBig; 4]> = ids.iter().map(|i| self.space.point_exact(*i).clone()).collect();
        let plane = crate::predicates::plane([&corners[0], &corners[1], &corners[2]]);
        // x = (n × m + k d) / (n · d).
        let (d, m) = (&line[..3], &line[3..]);
        let cross = |i: usize, j: usize| &plane[i] * &m[j] - &plane[j] * &m[i];
        let w: IBig = (0..3).map(|i| &plane[i] * &d[i]).sum();
        let mut at = [cross(1, 2), cross(2, 0), cross(0, 1), w];
        (0..3).for_each(|i| at[i] += &plane[3] * &d[i]);
        if crate::predicates::sign(&at[3]) == Ordering::Less {
            at.iter_mut().for_each(|c| *c = -std::mem::take(c));
        }
        if at[3].is_zero() {
            return None;
        }
        // Against a point off the plane, the determinants of (x, b, c, off), … are x's weights, times w.
        let off: [IBig; 4] = std::array::from_fn(|k| {
            if k < 3 { &corners[0][k] + &plane[k] * &corners[0][3] } else { corners[0][3].clone() }
        });
        for i in 1..corners.len() - 1 {
            let of = [&corners[0], &corners[i], &corners[i + 1]];
            let parts: [IBig; 3] = std::array::from_fn(|k| {
                let mut with = of;
                with[k] = &at;
                crate::predicates::determinant([with[0], with[1], with[2], &off]) * &of[k][3]
            });
            let total: IBig = parts.iter().sum();
            if total.is_zero()
                || parts.iter().any(|p| crate::predicates::sign(p) != crate::predicates::sign(&total))
            {
                continue;
            }
            let weights = parts.map(|p| ((p << FINE) / &total).max(IBig::ONE));
            let sum: IBig = weights.iter().sum();
            let shares = [0, 1, 2].map(|k| crate::frame::ratio(&weights[k], &sum));
            return Some(self.mixed(end, i, weights, shares));
        }
        None
    }

    /// A snapped point in world space, exactly.
    pub fn source(&self, point: u32, end: usize) -> Source {
        let crate::frame::Place::Mix(of, weights) = &self.space.point_at(point).place else {
            unreachable!("witness ends are snapped points")
        };
        let (polygon, ids) = (self.ends[end].0, if end == 0 { &self.pair.a } else { &self.pair.b });
        let corners = of.map(|o| {
            let i = ids.iter().position(|x| *x == o).unwrap_or(0);
            crate::predicates::integers(&polygon.points()[i])
        });
        let mut x = crate::vector::mix([&corners[0], &corners[1], &corners[2]], weights);
        crate::number::primitive(&mut x);
        Source::Exact(Box::new(x))
    }

    /// The half-spaces of an occluder, where it is between A and B; an index into `known`.
    pub fn constraints(&mut self, scene: &Occluders, id: u32) -> Option<usize> {
        if let Some(at) = self.places.get(&[(id, false)][..]) {
            return Some(*at);
        }
        let occluder = scene.occluder(id);
        let before = self.space.size();
        let planes = [(self.pair.a.clone(), self.pair.ahead), (self.pair.b.clone(), self.pair.behind)];
        let mut beyond = [false; 2];
        for (k, (plane, good)) in planes.iter().enumerate() {
            let mut within = false;
            for e in &occluder.border {
                let point = self.space.frame().given(e[0].as_dvec3());
                let point = self.space.point(point);
                let side = self.space.orient(plane[0], plane[1], plane[2], point);
                within |= side == *good;
                beyond[k] |= side == good.reverse();
            }
            if !within {
                self.space.truncate(before);
                return None;
            }
        }
        self.space.truncate(before);
        let mut lines = Vec::with_capacity(occluder.lines.len() + 2);
        for e in &occluder.lines {
            let (line, flipped) = self.edge(occluder.border[*e as usize]);
            lines.push((line, flipped, *e as u16));
        }
        if beyond.contains(&true) {
            let (t, turned) = occluder.triangles[0];
            let points = scene.triangle(t).map(|v| {
                let point = self.space.frame().given(v.as_dvec3());
                self.space.point(point)
            });
            let own = Through { points, turned };
            for (k, (plane, good)) in planes.iter().enumerate() {
                if !beyond[k] {
                    continue;
                }
                let toward =
                    Through { points: [plane[0], plane[1], plane[2]], turned: *good == Ordering::Less };
                // The part of the occluder on the good side is to the left of n_plane × n_own, seen from n_own's side.
                let line = self.space.meet(toward, own);
                lines.push((line, false, (occluder.border.len() + k) as u16));
            }
        }
        let between = !beyond.contains(&true);
        Some(self.keep(Constraints { members: vec![(id, false)], between, lines }))
    }

    /// The side on which a rounded ray passes a constraint.
    fn side(&self, (line, flipped, _): &(Id, bool, u16), ray: &[f64; 6]) -> f64 {
        let s = crate::vector::klein(ray, self.space.rounded(*line));
        if *flipped { -s } else { s }
    }

    pub fn sum_of_sides(&self, known: usize, ray: &[f64; 6]) -> f64 {
        self.known[known].lines.iter().map(|c| self.side(c, ray)).sum()
    }

    /// How many rays of a region an occluder blocks, rounded.
    pub fn held(&self, region: &Region, known: usize, negative: bool) -> usize {
        let inside = |v: &[f64; 6]| {
            self.known[known]
                .lines
                .iter()
                .all(|c| if negative { self.side(c, v) <= 0.0 } else { self.side(c, v) >= 0.0 })
        };
        region.rays.iter().filter(|(r, _)| inside(self.space.rounded(*r))).count()
    }

    /// Adds neighbours to an occluder for as long as that makes it block more of a region: what lines pass in the same
    /// direction has one silhouette (thesis §2.4). None if there is nothing to add.
    pub fn grow(
        &mut self,
        scene: &Occluders,
        region: &Region,
        (known, negative, held): (usize, bool, usize),
    ) -> Option<usize> {
        let all = region.rays.len();
        if !self.known[known].between || held == all {
            return None;
        }
        let (mut best, mut most) = (known, held);
        loop {
            let members = self.known[best].members.clone();
            if members.len() == MOST_MEMBERS {
                break;
            }
            // Only over edges that part of the region passes outside of.
            let (rim, _) = scene.border(&triangles(scene, &members));
            let mut next: Option<(usize, usize)> = None;
            let outer: Vec<u16> = self.known[best]
                .lines
                .iter()
                .filter(|c| {
                    region.rays.iter().any(|(r, _)| (self.side(c, self.space.rounded(*r)) < 0.0) != negative)
                })
                .map(|c| c.2)
                .collect();
            for edge in outer {
                let [a, b] = rim[usize::from(edge)];
                let neighbours: Vec<(u32, bool)> = scene.at_edge([a, b]).collect();
                for (o, same_way) in neighbours {
                    // Its border must run the other way along the edge, so turned round where it runs the same way.
                    if members.iter().any(|m| m.0 == o) {
                        continue;
                    }
                    let Some(_) = self.constraints(scene, o).filter(|k| self.known[*k].between) else {
                        continue;
                    };
                    let mut with = members.clone();
                    with.push((o, same_way));
                    with.sort_unstable();
                    // Two sides of one sheet leave no border, and block nothing together.
                    let Some(patch) = self.patch(scene, with) else { continue };
                    let count = self.held(region, patch, negative);
                    if count > most && next.is_none_or(|(c, _)| count > c) {
                        next = Some((count, patch));
                    }
                }
            }
            let Some((count, patch)) = next else { break };
            (best, most) = (patch, count);
            if most == all {
                break;
            }
        }
        (best != known).then_some(best)
    }

    /// Several occluders that are all between the polygons, as one; an index into `known`. None if they have no border.
    fn patch(&mut self, scene: &Occluders, members: Vec<(u32, bool)>) -> Option<usize> {
        if let Some(at) = self.places.get(&members) {
            return Some(*at);
        }
        let (_, border) = scene.border(&triangles(scene, &members));
        if border.is_empty() {
            return None;
        }
        let mut lines: Vec<(Id, bool, u16)> = Vec::with_capacity(border.len());
        for (number, edge) in border.iter().enumerate() {
            let (line, flipped) = self.edge(*edge);
            if !lines.iter().any(|l| l.0 == line && l.1 == flipped) {
                lines.push((line, flipped, number as u16));
            }
        }
        Some(self.keep(Constraints { members, between: true, lines }))
    }

    fn keep(&mut self, of: Constraints) -> usize {
        self.places.insert(of.members.clone(), self.known.len());
        self.known.push(of);
        self.known.len() - 1
    }

    /// The line of an edge, one for all edges that run along it.
    fn edge(&mut self, [p, q]: [glam::Vec3; 2]) -> (Id, bool) {
        // −0 is 0.
        let bits = |v: glam::Vec3| (v + glam::Vec3::ZERO).to_array().map(f32::to_bits);
        let key = |a: [u32; 3], b: [u32; 3]| [a[0], a[1], a[2], b[0], b[1], b[2]];
        let (there, back) = (key(bits(p), bits(q)), key(bits(q), bits(p)));
        if let Some(known) = self.lines.edges.get(&there) {
            return *known;
        }
        if let Some((id, flipped)) = self.lines.edges.get(&back) {
            return (*id, !*flipped);
        }
        let [a, b] = [p, q].map(|v| {
            let point = self.space.frame().given(v.as_dvec3());
            self.space.point(point)
        });
        let line = self.space.join(a, b);
        // Along a line that is there already?
        let fingerprint = self.space.fingerprint(line);
        let near = self.lines.near(fingerprint);
        let same = near.into_iter().find_map(|l| self.space.same_line(line, l).map(|same| (l, !same)));
        if same.is_none() {
            self.lines.buckets.entry(fingerprint).or_default().push(line);
        }
        let (id, flipped) = same.unwrap_or((line, false));
        self.lines.edges.insert(there, (id, flipped));
        (id, flipped)
    }

    /// Splits a region by the hyperplane polar to a vector of the frame, or rather to that vector rounded in the world.
    pub fn split(&mut self, region: &Region, polar: &[f64; 6]) -> Option<Found> {
        let polar = self.space.frame().line_to_world(polar);
        if !polar.iter().all(|c| c.is_finite()) || polar.iter().all(|c| *c == 0.0) {
            return None;
        }
        let exact = self.space.frame().line_integers(polar);
        let line = self.space.fixed(exact);
        let mut sides = Vec::new();
        region.sides(&mut self.space, line, &mut sides);
        if !sides.contains(&Ordering::Less) || !sides.contains(&Ordering::Greater) {
            return None;
        }
        let parts = region.split(&mut self.space, line, &sides).ok()?;
        Some((Step::Split { polar }, parts.into()))
    }

    /// Takes away from a region what an occluder blocks of it: the cuts made and the parts left outside each. Nothing when
    /// the occluder takes nothing away.
    pub fn subtract(
        &mut self,
        region: &Region,
        known: usize,
        negative: bool,
    ) -> Option<(Vec<u16>, Vec<Region>)> {
        let mut cuts = Vec::new();
        let mut outside = Vec::new();
        let mut rest = region.clone();
        let mut sides = Vec::new();
        for k in 0..self.known[known].lines.len() {
            let (line, flipped, number) = self.known[known].lines[k];
            rest.sides(&mut self.space, line, &mut sides);
            let inner = if flipped != negative { Ordering::Less } else { Ordering::Greater };
            if !sides.contains(&inner) {
                return None;
            }
            if !sides.contains(&inner.reverse()) {
                continue;
            }
            let [less, greater] = rest.split(&mut self.space, line, &sides).ok()?;
            let (inside, out) = if inner == Ordering::Less { (less, greater) } else { (greater, less) };
            rest = inside;
            cuts.push(number);
            outside.push(out);
        }
        Some((cuts, outside))
    }
}

/// The triangles of some occluders, in order.
pub fn triangles(scene: &Occluders, members: &[(u32, bool)]) -> Vec<(u32, bool)> {
    members
        .iter()
        .flat_map(|(o, turned)| {
            scene.occluder(*o).triangles.iter().map(move |(t, flip)| (*t, flip != turned))
        })
        .collect()
}
