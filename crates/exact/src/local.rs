//! What the search works with between two parts: their space, sight lines snapped to points of both, and occluders as
//! half-spaces.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use crate::cone::Region;
use crate::edges::EdgeLines;
use crate::forms::Forms;
use crate::frame::Source;
use crate::grow::Limit;
use crate::occluder::Occluders;
use crate::polygon::Polygon;
use crate::prism::{self, Pair};
use crate::proof::Step;
use crate::rows::Rows;
use crate::vector::{Id, Space, Through};

/// A step of a proof, and the regions that are left to be taken apart.
pub type Found = (Step, Vec<Region>);
/// An end of a sight line: a point of the space, and its rounded place in the world.
pub type Snapped = (u32, DVec3);

/// Weights of a snapped point add up to this.
const WEIGHTS: u64 = 1 << 50;

/// Bits of the weights of a point that is snapped precisely.
const FINE: usize = 240;

/// An occluder as half-spaces of one pair's space.
pub struct Constraints {
    /// The occluders of the scene it is made of, each with whether it is turned round; ascending.
    pub members: Vec<(u32, bool)>,
    /// All that bounds what it blocks.
    pub lines: Vec<Constraint>,
}

/// One half-space of an occluder.
#[derive(Clone, Copy)]
pub struct Constraint {
    /// Its line.
    pub line: Id,
    /// Whether the border runs the other way.
    pub flipped: bool,
    /// Its number in a proof.
    pub number: u16,
    /// The rounded line of [`Rows`], and whether the border runs the other way than that; none where a plane cuts the occluder.
    pub row: Option<(u32, bool)>,
}

/// Where an occluder is: whether part of it is on the other polygon's side of A's plane and of B's, and whether part of it is on the
/// side that is away from it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Extent {
    within: [bool; 2],
    beyond: [bool; 2],
}

/// An edge of an occluder's border.
#[derive(Clone, Copy)]
pub struct Edge {
    /// Its line.
    pub line: Id,
    /// Whether the line runs the other way.
    pub flipped: bool,
}

/// The lines of a border, one constraint for each.
pub fn lines_of(edges: &[Edge], rim: &[[u32; 2]], rows: &Rows) -> Vec<Constraint> {
    let mut lines: Vec<Constraint> = Vec::with_capacity(edges.len() + 2);
    for (number, (e, corners)) in edges.iter().zip(rim).enumerate() {
        if !lines.iter().any(|l| l.line == e.line && l.flipped == e.flipped) {
            let row = rows.line(*corners).map(|row| (row, corners[0] > corners[1]));
            lines.push(Constraint { line: e.line, flipped: e.flipped, number: number as u16, row });
        }
    }
    lines
}

/// What belongs to one pair of parts.
pub struct Local<'a> {
    pub space: Space,
    pub pair: Pair,
    pub known: Vec<Constraints>,
    /// Corners of the scene as points of the space, by number, and their sides of A's plane and of B's, if asked for.
    pub corners: FxHashMap<u32, (u32, Option<[Ordering; 2]>)>,
    /// Where occluders are that were asked about.
    pub extents: FxHashMap<u32, Extent>,
    /// Where in `known` an occluder is; none where it is not between the polygons.
    pub places: FxHashMap<u32, Option<usize>>,
    /// Where in `known` several occluders are that were joined.
    pub patches: FxHashMap<Vec<(u32, bool)>, Option<usize>>,
    /// Lines made for occluders' edges.
    pub lines: EdgeLines,
    /// On which sides of them the rays of the region at hand are.
    pub rows: Rows,
    /// The Klein form on the rays of the region at hand.
    pub forms: Forms,
    /// Sides of rays, kept for their memory.
    pub sides: Vec<Ordering>,
    /// The border of what grows, kept for its memory.
    pub border: Vec<Limit>,
    /// Triangles a line may meet, kept for their memory.
    pub candidates: Vec<u32>,
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
            let shares = [0, 1, 2].map(|k| sightline_numbers::integer::ratio(&weights[k], &sum));
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
        if let Some(at) = self.places.get(&id) {
            return *at;
        }
        let at = self.make_constraints(scene, id);
        self.places.insert(id, at);
        at
    }

    /// A corner of the scene as a point of the space.
    pub fn corner(&mut self, number: u32, at: Vec3) -> u32 {
        if let Some((point, _)) = self.corners.get(&number) {
            return *point;
        }
        let point = self.space.frame().given(at.as_dvec3());
        let point = self.space.point(point);
        self.corners.insert(number, (point, None));
        point
    }

    /// A triangle's corners as points of the space.
    pub fn corner_points(&mut self, scene: &Occluders, triangle: u32) -> [u32; 3] {
        let (numbers, at) = (scene.corners(triangle), scene.triangle(triangle));
        std::array::from_fn(|k| self.corner(numbers[k], at[k]))
    }

    /// On which sides of A's plane and of B's a corner is.
    fn corner_sides(&mut self, number: u32, at: Vec3) -> [Ordering; 2] {
        let point = self.corner(number, at);
        if let Some((_, Some(sides))) = self.corners.get(&number) {
            return *sides;
        }
        let planes = [&self.pair.a, &self.pair.b].map(|p| [p[0], p[1], p[2]]);
        let sides = planes.map(|[a, b, c]| self.space.orient(a, b, c, point));
        self.corners.insert(number, (point, Some(sides)));
        sides
    }

    /// Where an occluder is.
    fn extent(&mut self, scene: &Occluders, id: u32) -> Extent {
        if let Some(known) = self.extents.get(&id) {
            return *known;
        }
        let good = [self.pair.ahead, self.pair.behind];
        let mut extent = Extent::default();
        let occluder = scene.occluder(id);
        for (number, at) in occluder.rim.iter().zip(&occluder.border) {
            let sides = self.corner_sides(number[0], at[0]);
            for k in 0..2 {
                extent.within[k] |= sides[k] == good[k];
                extent.beyond[k] |= sides[k] == good[k].reverse();
            }
        }
        self.extents.insert(id, extent);
        extent
    }

    /// Whether all of an occluder is between the polygons.
    pub fn is_between(&mut self, scene: &Occluders, id: u32) -> bool {
        let extent = self.extent(scene, id);
        extent.within == [true; 2] && extent.beyond == [false; 2]
    }

    fn make_constraints(&mut self, scene: &Occluders, id: u32) -> Option<usize> {
        let Extent { within, beyond } = self.extent(scene, id);
        if within.contains(&false) {
            return None;
        }
        let occluder = scene.occluder(id);
        let planes = [(self.pair.a.clone(), self.pair.ahead), (self.pair.b.clone(), self.pair.behind)];
        let edges = self.edges(&occluder.rim, &occluder.border);
        let mut lines = lines_of(&edges, &occluder.rim, &self.rows);
        if beyond.contains(&true) {
            let (t, turned) = occluder.triangles[0];
            let points = self.corner_points(scene, t);
            let own = Through { points, turned };
            for (k, (plane, good)) in planes.iter().enumerate() {
                if !beyond[k] {
                    continue;
                }
                let toward =
                    Through { points: [plane[0], plane[1], plane[2]], turned: *good == Ordering::Less };
                // The part of the occluder on the good side is to the left of n_plane × n_own, seen from n_own's side.
                let line = self.space.meet(toward, own);
                let number = (occluder.border.len() + k) as u16;
                lines.push(Constraint { line, flipped: false, number, row: None });
            }
        }
        self.known.push(Constraints { members: vec![(id, false)], lines });
        Some(self.known.len() - 1)
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
        let mut sides = std::mem::take(&mut self.sides);
        let mut inside: Option<Region> = None;
        for k in self.order(known, negative) {
            let Constraint { line, flipped, number, .. } = self.known[known].lines[k];
            let rest = inside.as_ref().unwrap_or(region);
            rest.sides(&mut self.space, line, &mut sides);
            let inner = if flipped != negative { Ordering::Less } else { Ordering::Greater };
            if !sides.contains(&inner) {
                return None;
            }
            if !sides.contains(&inner.reverse()) {
                continue;
            }
            let [less, greater] = rest.split(&mut self.space, line, &sides).ok()?;
            let (inner, out) = if inner == Ordering::Less { (less, greater) } else { (greater, less) };
            inside = Some(inner);
            cuts.push(number);
            outside.push(out);
        }
        self.sides = sides;
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
