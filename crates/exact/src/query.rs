//! The exact query between two polygons: feedback-guided subtraction in line space (thesis ch. 5 and §6.1; the
//! feedback after Haumont et al. 2005).
//!
//! Take a real line inside what is left of the lines from A to B and follow it. If it meets nothing it is a witness. Else
//! subtract one of the occluders it met, the one that takes most of what is left, and go on with the pieces outside
//! of it. When nothing with real lines is left, B is hidden, and the steps taken are the proof.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::DVec3;

use crate::cone::Region;
use crate::frame::{Frame, Source};
use crate::klein::{self, Contents, contents};
use crate::occluder::Occluders;
use crate::polygon::Polygon;
use crate::prism::{self, Pair};
use crate::proof::{Proof, Step, Which};
use crate::trace::{Met, trace};
use crate::vector::{Decisions, Id, Space, Through};

/// When a query gives up.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Regions looked at, over all divisions.
    pub regions: u32,
    /// Vectors held at a time; about 400 bytes each.
    pub vectors: u32,
    /// How often the regions of a pair may be split for the sake of the Klein form alone.
    pub splits: u32,
    /// How often a polygon may be halved.
    pub divisions: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { regions: 20_000, vectors: 200_000, splits: 64, divisions: 12 }
    }
}

/// What is known of two polygons.
#[derive(Clone, Debug)]
pub enum Verdict {
    /// Seen, along the segment between these points: inside A, inside B, and clear of all triangles in between.
    Visible(Box<[Source; 2]>),
    /// Not seen, with the proof.
    Hidden(Proof),
    /// Neither, and why.
    Undecided(Reason),
}

/// Why a query ended without a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// More regions than [`Limits::regions`].
    #[error("more regions of line space than the limit")]
    Regions,
    /// More vectors than [`Limits::vectors`].
    #[error("more memory than the limit")]
    Memory,
    /// Polygons halved as often as [`Limits::divisions`] and still neither.
    #[error("halved to the limit and still undecided")]
    Divisions,
}

/// What a query cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// How signs were decided.
    pub decisions: Decisions,
    /// Regions looked at.
    pub regions: u64,
    /// Lines followed.
    pub lines: u64,
    /// Occluders subtracted.
    pub occluders: u64,
    /// Times a region was split for the sake of the Klein form alone.
    pub splits: u64,
    /// Times a polygon was halved.
    pub divisions: u64,
    /// Most vectors held.
    pub vectors: u64,
}

impl std::ops::AddAssign for Cost {
    fn add_assign(&mut self, o: Self) {
        self.decisions += o.decisions;
        self.regions += o.regions;
        self.lines += o.lines;
        self.occluders += o.occluders;
        self.splits += o.splits;
        self.divisions += o.divisions;
        self.vectors = self.vectors.max(o.vectors);
    }
}

/// Whether any part of `b` is seen from `a`, each a convex polygon or the parts of one.
pub fn sightlines(scene: &Occluders, a: &[Polygon], b: &[Polygon], limits: &Limits) -> (Verdict, Cost) {
    let mut search =
        Search { scene, limits, cost: Cost::default(), proof: Proof::default(), numbers: Vec::new() };
    let mut open: Option<Reason> = None;
    for x in a {
        for y in b {
            match search.polygons(x, y) {
                Ok(()) => {}
                Err(End::Seen(witness)) => return (Verdict::Visible(witness), search.cost),
                // Another part may still be seen.
                Err(End::Open(reason)) => open = Some(reason),
            }
        }
    }
    let verdict = match open {
        None => Verdict::Hidden(search.proof),
        Some(reason) => Verdict::Undecided(reason),
    };
    (verdict, search.cost)
}

/// The parts of two polygons between which lines run: each on one side of the other's plane. None when both lie in
/// one plane: the lines in it are no open set.
pub fn parts(a: &Polygon, b: &Polygon) -> Vec<[(Polygon, Vec<Ordering>); 2]> {
    let (of_a, of_b) = (b.sides(a), a.sides(b));
    let mut out = Vec::new();
    for side_a in [Ordering::Greater, Ordering::Less] {
        for side_b in [Ordering::Greater, Ordering::Less] {
            let cut = |p: &Polygon, other: &Polygon, sides: &[Ordering], keep: Ordering| {
                if sides.contains(&keep.reverse()) && sides.contains(&keep) {
                    let part = p.part(&other.plane(), sides, keep)?;
                    let sides = other.sides(&part);
                    Some((part, sides))
                } else {
                    sides.contains(&keep).then(|| (p.clone(), sides.to_vec()))
                }
            };
            if let (Some(x), Some(y)) = (cut(a, b, &of_a, side_a), cut(b, a, &of_b, side_b)) {
                out.push([x, y]);
            }
        }
    }
    out
}

/// How the search of a pair ends before it is proved hidden.
enum End {
    Seen(Box<[Source; 2]>),
    Open(Reason),
}

/// The end of a whole from those of its parts: what is seen ends the search, what is open does not.
fn worst(before: Result<(), Reason>, now: Result<(), End>) -> Result<Result<(), Reason>, End> {
    match now {
        Ok(()) => Ok(before),
        Err(End::Open(reason)) => Ok(Err(reason)),
        Err(End::Seen(witness)) => Err(End::Seen(witness)),
    }
}

/// A step of a proof, and the regions that are left to be taken apart.
type Found = (Step, Vec<Region>);
/// An end of a sight line: a point of the space, and its rounded place in the world.
type Snapped = (u32, DVec3);

/// A region the search can do nothing with as it is: the polygons are to be halved.
struct Stuck;

struct Search<'a> {
    scene: &'a Occluders,
    limits: &'a Limits,
    cost: Cost,
    proof: Proof,
    /// What each occluder of the proof is made of.
    numbers: Vec<Vec<(u32, bool)>>,
}

/// An occluder as half-spaces of one pair's space.
struct Constraints {
    /// The occluders of the scene it is made of, each with whether it is turned round; ascending.
    members: Vec<(u32, bool)>,
    /// Whether all of it is between the polygons.
    between: bool,
    /// Line, whether it runs the other way, and the constraint's number in a proof.
    lines: Vec<(Id, bool, u16)>,
}

impl Search<'_> {
    fn polygons(&mut self, a: &Polygon, b: &Polygon) -> Result<(), End> {
        let mut result = Ok(());
        for [x, y] in parts(a, b) {
            result = worst(result, self.pair(&x, &y, 0))?;
        }
        result.map_err(End::Open)
    }

    /// Proves that no line gets from one part to the other, halving them where that does not succeed at once.
    fn pair(
        &mut self,
        a: &(Polygon, Vec<Ordering>),
        b: &(Polygon, Vec<Ordering>),
        depth: u32,
    ) -> Result<(), End> {
        let steps = self.proof.steps.len();
        if self.try_pair(a, b)?.is_ok() {
            return Ok(());
        }
        self.proof.steps.truncate(steps);
        if depth == self.limits.divisions {
            return Err(End::Open(Reason::Divisions));
        }
        self.cost.divisions += 1;
        let (of, [from, to]) = widest(&a.0, &b.0);
        self.proof.steps.push(Step::Divide { of, from, to });
        let mut result = Ok(());
        let (whole, other) = if of == Which::A { (&a.0, &b.0) } else { (&b.0, &a.0) };
        for half in whole.divided(from, to) {
            let sides = other.sides(&half);
            // The other's sides of the half's plane are what they were: it is the same plane, perhaps turned.
            let half_plane = half.sides(other);
            let (half, rest) = ((half, sides), (other.clone(), half_plane));
            let found = if of == Which::A {
                self.pair(&half, &rest, depth + 1)
            } else {
                self.pair(&rest, &half, depth + 1)
            };
            result = worst(result, found)?;
        }
        result.map_err(End::Open)
    }

    fn try_pair(
        &mut self,
        a: &(Polygon, Vec<Ordering>),
        b: &(Polygon, Vec<Ordering>),
    ) -> Result<Result<(), Stuck>, End> {
        let (near_a, near_b) = (a.0.rounded(), b.0.rounded());
        let mut space = Space::new(Frame::around(&near_a, &near_b));
        let Ok(mut pair) = prism::stabbing(&mut space, (&a.0, &a.1), (&b.0, &b.1)) else {
            return Ok(Err(Stuck));
        };
        let regions = std::mem::take(&mut pair.regions);
        let ends = [(&a.0, &near_a[..]), (&b.0, &near_b[..])];
        let mut local = Local { space, pair, known: Vec::new(), lines: Vec::new(), ends };
        let mut result = Ok(());
        for region in regions {
            result = self.region(&mut local, region)?;
            if result.is_err() {
                break;
            }
        }
        self.cost.decisions += local.space.decisions;
        Ok(result)
    }

    /// Takes one region apart.
    fn region(&mut self, local: &mut Local<'_>, region: Region) -> Result<Result<(), Stuck>, End> {
        let mut open = vec![region];
        let mut splits = 0;
        while let Some(region) = open.pop() {
            self.cost.regions += 1;
            let vectors = local.space.size()[1] as u64;
            self.cost.vectors = self.cost.vectors.max(vectors);
            if self.cost.regions > u64::from(self.limits.regions) {
                self.cost.decisions += local.space.decisions;
                return Err(End::Open(Reason::Regions));
            }
            if vectors > u64::from(self.limits.vectors) {
                self.cost.decisions += local.space.decisions;
                return Err(End::Open(Reason::Memory));
            }
            let mut found = match contents(&mut local.space, &region, LINES) {
                Contents::Nothing => {
                    self.proof.steps.push(Step::Unreal);
                    continue;
                }
                Contents::Unsure => None,
                Contents::Lines(lines) => self.feed_back(local, &region, &lines)?,
            };
            if found.is_none() {
                found = self.feed_back_precisely(local, &region)?;
            }
            if found.is_none() && splits < self.limits.splits {
                splits += 1;
                self.cost.splits += 1;
                found = klein::polar(&local.space, &region).and_then(|p| local.split(&region, &p));
            }
            let Some((step, outside)) = found else { return Ok(Err(Stuck)) };
            self.proof.steps.push(step);
            // The first part is the next to be looked at.
            open.extend(outside.into_iter().rev());
        }
        Ok(Ok(()))
    }

    /// Follows lines of a region until one is free or an occluder is found that takes something away.
    fn feed_back(
        &mut self,
        local: &mut Local<'_>,
        region: &Region,
        lines: &[[f64; 6]],
    ) -> Result<Option<Found>, End> {
        for line in lines {
            let Some(ends) = local.snap(line) else { continue };
            if let Some(found) = self.follow(local, region, line, ends)? {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    /// The same with a line that is in a region too thin for doubles.
    fn feed_back_precisely(&mut self, local: &mut Local<'_>, region: &Region) -> Result<Option<Found>, End> {
        let Some(line) = klein::precise(&mut local.space, region) else { return Ok(None) };
        let Some(ends) = local.snap_precisely(&line) else { return Ok(None) };
        self.follow(local, region, &crate::number::rounded(&line), ends)
    }

    /// Follows one sight line.
    fn follow(
        &mut self,
        local: &mut Local<'_>,
        region: &Region,
        line: &[f64; 6],
        (p, q): (Snapped, Snapped),
    ) -> Result<Option<Found>, End> {
        self.cost.lines += 1;
        match trace(&mut local.space, self.scene, &mut local.pair, (p.0, q.0), (p.1, q.1)) {
            Met::Nothing => {
                self.cost.decisions += local.space.decisions;
                Err(End::Seen(Box::new([local.source(p.0, 0), local.source(q.0, 1)])))
            }
            Met::Grazing => Ok(None),
            Met::Blocked(triangles) => {
                let mut met: Vec<u32> = triangles.iter().filter_map(|t| self.scene.of(*t)).collect();
                met.sort_unstable();
                met.dedup();
                Ok(self.subtract_best(local, region, line, &met))
            }
        }
    }

    /// Subtracts the occluder that holds most rays of the region, or the next that takes anything away.
    fn subtract_best(
        &mut self,
        local: &mut Local<'_>,
        region: &Region,
        line: &[f64; 6],
        met: &[u32],
    ) -> Option<Found> {
        let mut ranked: Vec<(usize, bool, usize)> = Vec::with_capacity(met.len());
        for id in met {
            let Some(known) = local.constraints(self.scene, *id) else { continue };
            // Which way the line passes the occluder: all edges agree, but for rounding.
            let negative = local.sum_of_sides(known, line) < 0.0;
            ranked.push((known, negative, local.held(region, known, negative)));
        }
        ranked.sort_by(|x, y| {
            y.2.cmp(&x.2)
                .then(local.known[x.0].lines.len().cmp(&local.known[y.0].lines.len()))
                .then(x.0.cmp(&y.0))
        });
        for (known, negative, held) in ranked {
            let grown = local.grow(self.scene, region, (known, negative, held));
            for known in [grown, Some(known)].into_iter().flatten() {
                if let Some((cuts, outside)) = local.subtract(region, known, negative) {
                    self.cost.occluders += 1;
                    let occluder = self.number(&local.known[known].members);
                    return Some((Step::Block { occluder, negative, cuts }, outside));
                }
            }
        }
        None
    }

    /// An occluder's number in the proof.
    fn number(&mut self, members: &[(u32, bool)]) -> u32 {
        let at = self.numbers.iter().position(|m| m == members).unwrap_or_else(|| {
            self.numbers.push(members.to_vec());
            self.proof.occluders.push(triangles(self.scene, members));
            self.numbers.len() - 1
        });
        at as u32
    }
}

/// The triangles of some occluders, in order.
fn triangles(scene: &Occluders, members: &[(u32, bool)]) -> Vec<(u32, bool)> {
    members
        .iter()
        .flat_map(|(o, turned)| {
            scene.occluder(*o).triangles.iter().map(move |(t, flip)| (*t, flip != turned))
        })
        .collect()
}

/// Lines of a region that are tried before it is given up.
const LINES: usize = 6;
/// Weights of a snapped point add up to this.
const WEIGHTS: u64 = 1 << 50;

/// Most occluders that are joined to one for the sake of a region.
const MOST_MEMBERS: usize = 12;

/// Bits of the weights of a point that is snapped precisely.
const FINE: usize = 240;

/// What belongs to one pair of parts.
struct Local<'a> {
    space: Space,
    pair: Pair,
    known: Vec<Constraints>,
    /// Lines made for occluders' edges: ends as bits, the line, and whether it runs the other way.
    lines: Vec<([u32; 6], Id, bool)>,
    /// Both polygons, with their vertices rounded.
    ends: [(&'a Polygon, &'a [DVec3]); 2],
}

impl Local<'_> {
    /// A real line near `line`, between points strictly inside both polygons: points of the space and rounded ones.
    fn snap(&mut self, line: &[f64; 6]) -> Option<(Snapped, Snapped)> {
        let p = self.snap_end(line, 0)?;
        let q = self.snap_end(line, 1)?;
        Some((p, q))
    }

    fn snap_end(&mut self, line: &[f64; 6], end: usize) -> Option<Snapped> {
        let ids = if end == 0 { &self.pair.a } else { &self.pair.b };
        let at = prism::meets(&self.space, line, ids);
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
    fn snap_precisely(&mut self, line: &[IBig; 6]) -> Option<(Snapped, Snapped)> {
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
    fn source(&self, point: u32, end: usize) -> Source {
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
    fn constraints(&mut self, scene: &Occluders, id: u32) -> Option<usize> {
        if let Some(at) = self.known.iter().position(|c| c.members == [(id, false)]) {
            return Some(at);
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
        self.known.push(Constraints { members: vec![(id, false)], between, lines });
        Some(self.known.len() - 1)
    }

    /// The side on which a rounded ray passes a constraint.
    fn side(&self, (line, flipped, _): &(Id, bool, u16), ray: &[f64; 6]) -> f64 {
        let s = crate::vector::klein(ray, self.space.rounded(*line));
        if *flipped { -s } else { s }
    }

    fn sum_of_sides(&self, known: usize, ray: &[f64; 6]) -> f64 {
        self.known[known].lines.iter().map(|c| self.side(c, ray)).sum()
    }

    /// How many rays of a region an occluder blocks, rounded.
    fn held(&self, region: &Region, known: usize, negative: bool) -> usize {
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
    fn grow(
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
                    let Some(single) = self.constraints(scene, o).filter(|k| self.known[*k].between) else {
                        continue;
                    };
                    if self.in_a_plane(scene, single) {
                        continue;
                    }
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

    /// Whether an occluder lies in A's plane or in B's, where it blocks nothing.
    fn in_a_plane(&mut self, scene: &Occluders, known: usize) -> bool {
        let (o, _) = self.known[known].members[0];
        let before = self.space.size();
        let corners = scene.triangle(scene.occluder(o).triangles[0].0).map(|v| {
            let point = self.space.frame().given(v.as_dvec3());
            self.space.point(point)
        });
        let flat = [self.pair.a.clone(), self.pair.b.clone()]
            .iter()
            .any(|of| corners.iter().all(|t| self.space.orient(of[0], of[1], of[2], *t) == Ordering::Equal));
        self.space.truncate(before);
        flat
    }

    /// Several occluders that are all between the polygons, as one; an index into `known`. None if they have no border.
    fn patch(&mut self, scene: &Occluders, members: Vec<(u32, bool)>) -> Option<usize> {
        if let Some(at) = self.known.iter().position(|c| c.members == members) {
            return Some(at);
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
        self.known.push(Constraints { members, between: true, lines });
        Some(self.known.len() - 1)
    }

    /// The line of an edge, one for all edges that run along it.
    fn edge(&mut self, [p, q]: [glam::Vec3; 2]) -> (Id, bool) {
        // −0 is 0.
        let bits = |v: glam::Vec3| (v + glam::Vec3::ZERO).to_array().map(f32::to_bits);
        let key = |a: [u32; 3], b: [u32; 3]| [a[0], a[1], a[2], b[0], b[1], b[2]];
        let (there, back) = (key(bits(p), bits(q)), key(bits(q), bits(p)));
        for (k, id, flipped) in &self.lines {
            if *k == there {
                return (*id, *flipped);
            }
            if *k == back {
                return (*id, !*flipped);
            }
        }
        let [a, b] = [p, q].map(|v| {
            let point = self.space.frame().given(v.as_dvec3());
            self.space.point(point)
        });
        let line = self.space.join(a, b);
        // Along a line that is there already, or along an edge of A or B?
        let mut seen: Vec<Id> = self.lines.iter().map(|l| l.1).collect();
        seen.dedup();
        let same = seen.into_iter().find_map(|l| self.space.same_line(line, l).map(|same| (l, !same)));
        let (id, flipped) = same.unwrap_or((line, false));
        self.lines.push((there, id, flipped));
        (id, flipped)
    }

    /// Splits a region by the hyperplane polar to a vector of the frame, or rather to that vector rounded in the world.
    fn split(&mut self, region: &Region, polar: &[f64; 6]) -> Option<Found> {
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
    fn subtract(&mut self, region: &Region, known: usize, negative: bool) -> Option<(Vec<u16>, Vec<Region>)> {
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

/// The polygon that spreads farther, and where to halve it.
fn widest(a: &Polygon, b: &Polygon) -> (Which, [u16; 2]) {
    let (da, ca) = halving(a);
    let (db, cb) = halving(b);
    if da >= db { (Which::A, ca) } else { (Which::B, cb) }
}

/// A polygon's longest edge, and the points between which a line across it halves the polygon.
fn halving(p: &Polygon) -> (f64, [u16; 2]) {
    let v = p.rounded();
    let n = v.len();
    let length = |i: usize| (v[(i + 1) % n] - v[i]).length();
    let longest = (0..n).max_by(|i, j| length(*i).total_cmp(&length(*j)).then(j.cmp(i))).unwrap_or(0);
    // Opposite the middle of edge i: halfway round, a vertex or the middle of an edge.
    let from = 2 * longest + 1;
    (length(longest), [from as u16, ((from + n) % (2 * n)) as u16])
}
