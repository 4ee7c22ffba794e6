//! Lines that stab a sequence of convex polygons: strictly through the inside of each, in order (Teller 1992,
//! section 7.1).
//!
//! A line crosses each polygon in one of two directions. With the directions chosen, the polygons before one
//! lie on one side of its plane and those behind it on the other; parts on the wrong side are cut off, which
//! also fixes the order. Lines through the first and the last polygon are a convex region of line space, and
//! every edge in between removes a half-space. What is left is searched for real lines as in a query, with
//! nothing to trace: a line is checked against all edges, exactly. No tolerance is used.

use std::cmp::Ordering;

use dashu_int::IBig;
use sightline_certificate::proof::Which;

use crate::arithmetic::number::primitive;
use crate::geometry::frame::{Frame, Source};
use crate::geometry::polygon::Polygon;
use crate::geometry::predicates::integers;
use crate::line_space::cone::Region;
use crate::line_space::klein::{self, Contents, contents};
use crate::line_space::polar;
use crate::line_space::space::{Space, VectorId, mix};
use crate::line_space::stabbing_polyhedron;
use crate::search::halving::widest;
use crate::search::local::{Local, Snapped};
use crate::search::verdict::{Cost, Limits, Reason};

/// Normals that are compared with those of the next polygon; a line has one direction.
const MOST_NORMALS: usize = 12;
/// Lines in doubles that are tried for one region.
const LINES: usize = 2;

/// Whether a line stabs a sequence.
#[derive(Clone, Debug)]
pub enum Stabbed {
    /// The line through these points does: the first inside the first polygon, the second inside the last. Of
    /// a single polygon the second is off its plane.
    Line(Box<[Source; 2]>),
    /// No line does.
    Blocked,
    /// It is not known.
    Undecided(Reason),
}

/// Looks for a line strictly through the inside of each of the polygons, in order. There must be one.
/// `stop` is called before every region and every cut of one; the search ends undecided when it returns true.
pub fn stab(portals: &[Polygon], limits: &Limits, stop: &dyn Fn() -> bool) -> (Stabbed, Cost) {
    let mut search = Search {
        limits,
        stop,
        cost: Cost::default(),
    };
    let found = match portals {
        [] => Ok(()),
        [only] => return (Stabbed::Line(Box::new(across(only))), Cost::default()),
        _ => search.all(portals),
    };
    let found = match found {
        Ok(()) => Stabbed::Blocked,
        Err(End::Found(line)) => Stabbed::Line(line),
        Err(End::Open(reason)) => Stabbed::Undecided(reason),
    };
    (found, search.cost)
}

/// The directions in which lines cross polygons in order, each towards a side of the polygon's plane; `None`
/// when there are none, or several combinations of them.
pub(super) fn directions(portals: &[Polygon], limits: &Limits) -> Option<Vec<Ordering>> {
    let mut search = Search {
        limits,
        stop: &|| false,
        cost: Cost::default(),
    };
    let ways = search.directed(portals).ok()?;
    <[Directed; 1]>::try_from(ways)
        .ok()
        .map(|[way]| way.towards)
}

/// A point inside a polygon, and one off its plane, on the side to which its normal points.
fn across(polygon: &Polygon) -> [Source; 2] {
    let corners = [0, 1, 2].map(|i| integers(&polygon.points()[i]));
    let [a, b, c] = &corners;
    let inside = mix([a, b, c], &[IBig::ONE, IBig::ONE, IBig::ONE]);
    let plane = polygon.plane();
    let off = std::array::from_fn(|k| {
        if k < 3 {
            &inside[k] + &plane[k] * &inside[3]
        } else {
            inside[3].clone()
        }
    });
    [inside, off].map(|p| Source::Exact(Box::new(p)))
}

/// Polygons that are crossed in known directions: towards the side of their planes that is named.
#[derive(Clone)]
struct Directed {
    polygons: Vec<Polygon>,
    towards: Vec<Ordering>,
    /// Different normals that the direction of a line has positive products with: the first
    /// [`MOST_NORMALS`] of them.
    normals: Vec<[IBig; 3]>,
}

impl Directed {
    /// Whether some direction crosses the plane of a polygon so, and all planes so far as they are crossed.
    /// True where it is not known.
    fn may_go(&self, normal: &[IBig; 3]) -> bool {
        if self.normals.contains(normal) {
            return true;
        }
        let opposite = normal.each_ref().map(|c| -c);
        if self.normals.contains(&opposite) {
            return false;
        }
        // The directions are a cone. Its edges are among the cross products of two normals, and if it has an
        // inside their sum is inside.
        let all: Vec<&[IBig; 3]> = self.normals.iter().chain([normal]).collect();
        let dot = |a: &[IBig; 3], b: &[IBig; 3]| -> IBig { (0..3).map(|i| &a[i] * &b[i]).sum() };
        let cross = |a: &[IBig; 3], b: &[IBig; 3]| -> [IBig; 3] {
            let minor = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
            [minor(1, 2), minor(2, 0), minor(0, 1)]
        };
        let mut edges: Vec<[IBig; 3]> = Vec::new();
        for (k, a) in all.iter().enumerate() {
            for b in &all[k + 1..] {
                let edge = cross(a, b);
                for edge in [edge.each_ref().map(|c| -c), edge] {
                    if all.iter().all(|n| dot(n, &edge) >= IBig::ZERO)
                        && edge.iter().any(|c| !c.is_zero())
                    {
                        edges.push(edge);
                    }
                }
            }
        }
        let is_pointed = |edges: &[[IBig; 3]]| {
            // Normals in one plane leave both directions across it.
            !edges
                .iter()
                .any(|e| edges.iter().any(|f| (0..3).all(|i| e[i] == -&f[i])))
        };
        if all.len() < 3 || !edges.is_empty() && !is_pointed(&edges) {
            return true;
        }
        let sum: [IBig; 3] = std::array::from_fn(|i| edges.iter().map(|e| &e[i]).sum());
        all.iter().all(|n| dot(n, &sum) > IBig::ZERO)
    }

    /// The next polygon is crossed in a direction, with these parts of its neighbours.
    fn take(&mut self, (towards, normal): (Ordering, [IBig; 3]), parts: Vec<(usize, Polygon)>) {
        if self.normals.len() < MOST_NORMALS && !self.normals.contains(&normal) {
            self.normals.push(normal);
        }
        for (k, part) in parts {
            self.polygons[k] = part;
        }
        self.towards.push(towards);
    }
}

/// How the search ends before all regions are empty.
enum End {
    Found(Box<[Source; 2]>),
    Open(Reason),
}

/// The search cannot process a region: the polygons must be halved.
struct Stuck;

/// The state of the search, and the lines of the edges in between with the side on which a line passes them.
type Ends<'a> = (Local<'a>, Vec<(VectorId, Ordering)>);

struct Search<'a> {
    limits: &'a Limits,
    stop: &'a dyn Fn() -> bool,
    cost: Cost,
}

impl Search<'_> {
    fn all(&mut self, portals: &[Polygon]) -> Result<(), End> {
        let mut open = None;
        for Directed {
            polygons, towards, ..
        } in self.directed(portals)?
        {
            let [first, middle @ .., last] = &polygons[..] else {
                continue;
            };
            let middle: Vec<(&Polygon, Ordering)> = middle
                .iter()
                .zip(&towards[1..])
                .map(|(p, t)| (p, *t))
                .collect();
            // The ends have rays for each pair of their corners, and are searched in pieces of few.
            for a in first.clone().pieces() {
                for b in last.clone().pieces() {
                    match self.pair(&a, &b, &middle, 0) {
                        Ok(()) => {}
                        Err(End::Open(reason)) => open = Some(reason),
                        Err(found) => return Err(found),
                    }
                }
            }
        }
        open.map_or(Ok(()), |reason| Err(End::Open(reason)))
    }

    /// All ways to cross the polygons in order, each with the parts that can be crossed so: none of a polygon
    /// is on the wrong side of its neighbours' planes. More than one arises where a polygon reaches through
    /// another's plane. Each step of a way counts as a region.
    fn directed(&mut self, portals: &[Polygon]) -> Result<Vec<Directed>, End> {
        let mut ways = vec![Directed {
            polygons: portals.to_vec(),
            towards: Vec::new(),
            normals: Vec::new(),
        }];
        let n = portals.len();
        for i in 0..n {
            let mut next = Vec::with_capacity(ways.len());
            for mut way in ways {
                self.count(0)?;
                let [x, y, z, _] = portals[i].plane();
                // Without a common factor, so that parallel planes have equal or opposite normals.
                let mut up = [x, y, z];
                primitive(&mut up);
                let down = up.each_ref().map(|c| -c);
                let greater = way
                    .may_go(&up)
                    .then(|| cut(&way, portals, i, Ordering::Greater))
                    .flatten();
                let less = way
                    .may_go(&down)
                    .then(|| cut(&way, portals, i, Ordering::Less))
                    .flatten();
                // Mostly there is one direction, and nothing is copied.
                let other = if greater.is_some() && less.is_some() {
                    Some(way.clone())
                } else {
                    None
                };
                match (greater, less) {
                    (Some(greater), less) => {
                        way.take((Ordering::Greater, up), greater);
                        next.push(way);
                        if let (Some(mut other), Some(less)) = (other, less) {
                            other.take((Ordering::Less, down), less);
                            next.push(other);
                        }
                    }
                    (None, Some(less)) => {
                        way.take((Ordering::Less, down), less);
                        next.push(way);
                    }
                    (None, None) => {}
                }
            }
            // A second way is a copy of all polygons.
            if next.len() * n > self.limits.vectors as usize {
                return Err(End::Open(Reason::Memory));
            }
            ways = next;
        }
        // The first and the last polygon must be wholly on the right side of each other's planes, too.
        let fit = |mut way: Directed| {
            let first = behind(
                &way.polygons[0],
                &portals[n - 1],
                way.towards[n - 1].reverse(),
            )?;
            let last = behind(&way.polygons[n - 1], &portals[0], way.towards[0])?;
            way.polygons[0] = first;
            way.polygons[n - 1] = last;
            Some(way)
        };
        Ok(ways.into_iter().filter_map(fit).collect())
    }

    /// Searches the lines from `a` to `b`, and halves them if the first attempt fails.
    fn pair(
        &mut self,
        a: &Polygon,
        b: &Polygon,
        middle: &[(&Polygon, Ordering)],
        depth: u32,
    ) -> Result<(), End> {
        if self.try_pair(a, b, middle)?.is_ok() {
            return Ok(());
        }
        if depth == self.limits.divisions {
            return Err(End::Open(Reason::Divisions));
        }
        self.cost.divisions += 1;
        let (which, [from, to]) = widest(a, b);
        let mut open = None;
        for half in (if which == Which::A { a } else { b }).divided(from, to) {
            let found = match which {
                Which::A => self.pair(&half, b, middle, depth + 1),
                Which::B => self.pair(a, &half, middle, depth + 1),
            };
            match found {
                Ok(()) => {}
                Err(End::Open(reason)) => open = Some(reason),
                Err(found) => return Err(found),
            }
        }
        open.map_or(Ok(()), |reason| Err(End::Open(reason)))
    }

    fn try_pair(
        &mut self,
        a: &Polygon,
        b: &Polygon,
        middle: &[(&Polygon, Ordering)],
    ) -> Result<Result<(), Stuck>, End> {
        let (near_a, near_b) = (a.rounded(), b.rounded());
        let mut space = Space::new(Frame::around(&near_a, &near_b));
        let (a_sides, b_sides) = (b.sides(a), a.sides(b));
        let Ok(mut pair) = stabbing_polyhedron::stabbing(&mut space, (a, &a_sides), (b, &b_sides))
        else {
            return Ok(Err(Stuck));
        };
        let edges = edges(&mut space, middle);
        let regions = std::mem::take(&mut pair.regions);
        let local = Local::new(space, pair, [(a, &near_a[..]), (b, &near_b[..])]);
        let mut ends = (local, edges);
        let mut result = Ok(());
        for region in regions {
            result = self.region(&mut ends, region)?;
            if result.is_err() {
                break;
            }
        }
        self.cost.decisions += ends.0.space.decisions;
        Ok(result)
    }

    /// Searches a region and what its splits leave.
    fn region(&mut self, ends: &mut Ends<'_>, region: Region) -> Result<Result<(), Stuck>, End> {
        let region = match self.within(ends, region)? {
            Ok(Some(region)) => region,
            Ok(None) => return Ok(Ok(())),
            Err(Stuck) => return Ok(Err(Stuck)),
        };
        let mut open = vec![region];
        let mut splits = 0;
        while let Some(region) = open.pop() {
            self.count(ends.0.space.size())?;
            let local = &mut ends.0;
            match contents(&mut local.space, &region, LINES, &mut local.forms) {
                Contents::Nothing => continue,
                Contents::Unsure => {}
                Contents::Lines(lines) => {
                    for line in lines {
                        if let Some(points) = ends.0.snap(&line) {
                            self.check(ends, points)?;
                        }
                    }
                }
            }
            if let Some(line) = klein::precise(&mut ends.0.space, &region)
                && let Some(points) = ends.0.snap_precisely(&line)
            {
                self.check(ends, points)?;
            }
            if splits == self.limits.splits {
                return Ok(Err(Stuck));
            }
            splits += 1;
            self.cost.splits += 1;
            let Some((_, parts)) = polar::split(&mut ends.0.space, &region) else {
                return Ok(Err(Stuck));
            };
            open.extend(parts);
        }
        Ok(Ok(()))
    }

    /// Counts a region; ends the search at the limits.
    fn count(&mut self, vectors: usize) -> Result<(), End> {
        self.cost
            .region(vectors, self.limits, self.stop)
            .map_or(Ok(()), |reason| Err(End::Open(reason)))
    }

    /// The part of a region whose lines pass all edges on the right sides; none if it has no inside. Each cut
    /// counts as a region.
    fn within(
        &mut self,
        (local, edges): &mut Ends<'_>,
        mut region: Region,
    ) -> Result<Result<Option<Region>, Stuck>, End> {
        let mut sides = Vec::new();
        for (edge, keep) in edges.iter() {
            region.sides(&mut local.space, *edge, &mut sides);
            if !sides.contains(keep) {
                return Ok(Ok(None));
            }
            if sides.contains(&keep.reverse()) {
                self.count(local.space.size())?;
                let Ok([less, greater]) = region.split(&mut local.space, *edge, &sides) else {
                    return Ok(Err(Stuck));
                };
                region = if *keep == Ordering::Less {
                    less
                } else {
                    greater
                };
            }
        }
        Ok(Ok(Some(region)))
    }

    /// Ends the search if a line passes all edges on the right sides. Its ends are strictly inside the first
    /// and the last polygon by construction.
    fn check(
        &mut self,
        (local, edges): &mut Ends<'_>,
        (p, q): (Snapped, Snapped),
    ) -> Result<(), End> {
        self.cost.lines += 1;
        let line = local.space.join(p.0, q.0);
        if edges
            .iter()
            .all(|(edge, keep)| local.space.side(line, *edge) == *keep)
        {
            self.cost.decisions += local.space.decisions;
            return Err(End::Found(Box::new([
                local.source(p.0, 0),
                local.source(q.0, 1),
            ])));
        }
        Ok(())
    }
}

/// The lines of the edges of polygons, and the side on which a line passes them that crosses the polygon in
/// its direction.
pub(super) fn edges(
    space: &mut Space,
    middle: &[(&Polygon, Ordering)],
) -> Vec<(VectorId, Ordering)> {
    let mut out = Vec::new();
    for (polygon, towards) in middle {
        let mut point = |source: &Source| {
            let point = match source {
                Source::Given(p) => space.frame().given(*p),
                Source::Exact(p) => space.frame().exact((**p).clone()),
            };
            space.point(point)
        };
        let corners: Vec<u32> = polygon.points().iter().map(&mut point).collect();
        // A line that crosses the polygon towards the greater side of its plane.
        let [inside, above] = across(polygon).each_ref().map(&mut point);
        let line = space.join(inside, above);
        let n = corners.len();
        for k in 0..n {
            let edge = space.join(corners[k], corners[(k + 1) % n]);
            let side = space.side(line, edge);
            out.push((
                edge,
                if *towards == Ordering::Greater {
                    side
                } else {
                    side.reverse()
                },
            ));
        }
    }
    out
}

/// The neighbours of polygon `i` that remain when it is crossed in a direction; `None` when one vanishes.
fn cut(
    way: &Directed,
    portals: &[Polygon],
    i: usize,
    towards: Ordering,
) -> Option<Vec<(usize, Polygon)>> {
    let mut parts = Vec::with_capacity(2);
    if i > 0 {
        parts.push((
            i - 1,
            behind(&way.polygons[i - 1], &portals[i], towards.reverse())?,
        ));
    }
    if i + 1 < portals.len() {
        parts.push((i + 1, behind(&way.polygons[i + 1], &portals[i], towards)?));
    }
    Some(parts)
}

/// The part of a polygon on a side of another's plane.
fn behind(polygon: &Polygon, of: &Polygon, keep: Ordering) -> Option<Polygon> {
    polygon.part(&of.plane(), &of.sides(polygon), keep)
}
