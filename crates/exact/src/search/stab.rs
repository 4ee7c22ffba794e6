//! Lines that stab a sequence of convex polygons: lines that pass strictly through the interior of each
//! polygon, in order (Teller 1992, section 7.1).
//!
//! A line crosses each polygon in one of two directions. For chosen directions, the polygons before a polygon
//! must lie on one side of its plane, and the polygons after it on the other side. The search cuts off the
//! parts on the wrong side, which also determines the order of the crossings. Lines through the first and the
//! last polygon are a convex region of line space, and every edge of a polygon in between removes a
//! half-space. The search then looks for real lines in the remaining region as a query does, but it traces no
//! line: it checks each line exactly against all edges. No tolerance is used.

use std::cmp::Ordering;

use dashu_int::IBig;
use sightline_certificate::proof::QueryPolygon;

use crate::arithmetic::number::primitive;
use crate::geometry::frame::{Frame, PointOrigin};
use crate::geometry::polygon::Polygon;
use crate::geometry::predicates::integers;
use crate::line_space::cone::Region;
use crate::line_space::klein::{self, Contents, contents};
use crate::line_space::polar;
use crate::line_space::space::{Space, VectorId, mix};
use crate::line_space::stabbing_polyhedron;
use crate::search::halves::widest;
use crate::search::local::{PairState, SightLineEnd};
use crate::search::verdict::{QueryCost, QueryLimits, UndecidedReason};

/// The maximum number of normals of crossed polygons that the search compares with the normals of the next
/// polygon.
///
/// Each of these normals restricts the direction of a stabbing line.
const MOST_NORMALS: usize = 12;
/// The maximum number of lines in doubles that are tried for one region.
const LINES: usize = 2;

/// The result of the search for a line that stabs a sequence.
#[derive(Clone, Debug)]
pub enum Stabbed {
    /// A line stabs the sequence and passes through these points.
    ///
    /// The first point is inside the first polygon, and the second inside the last.
    ///
    /// For a single polygon, the second point is off the polygon's plane.
    Line(Box<[PointOrigin; 2]>),
    /// No line stabs the sequence.
    Blocked,
    /// The search ended without a result, for this reason.
    Undecided(UndecidedReason),
}

/// Searches for a line strictly through the interior of each of the polygons, in order.
///
/// The sequence needs at least one polygon. The function calls `stop` before every region and before every
/// cut of a region, and the search ends undecided if `stop` returns true.
pub fn stab(
    portals: &[Polygon],
    limits: &QueryLimits,
    stop: &dyn Fn() -> bool,
) -> (Stabbed, QueryCost) {
    let mut search = StabSearch {
        limits,
        stop,
        cost: QueryCost::default(),
    };
    let found = match portals {
        [] => Ok(()),
        [only] => return (Stabbed::Line(Box::new(across(only))), QueryCost::default()),
        _ => search.all(portals),
    };
    let found = match found {
        Ok(()) => Stabbed::Blocked,
        Err(StabEnd::Found(line)) => Stabbed::Line(line),
        Err(StabEnd::Open(reason)) => Stabbed::Undecided(reason),
    };
    (found, search.cost)
}

/// Computes the directions in which lines cross polygons in order, each towards a side of the polygon's
/// plane.
///
/// The result is `None` if no combination or several combinations of directions exist, or if the search for
/// them reaches a limit.
pub(super) fn directions(portals: &[Polygon], limits: &QueryLimits) -> Option<Vec<Ordering>> {
    let mut search = StabSearch {
        limits,
        stop: &|| false,
        cost: QueryCost::default(),
    };
    let ways = search.directed(portals).ok()?;
    <[Directed; 1]>::try_from(ways)
        .ok()
        .map(|[way]| way.towards)
}

/// Computes a point inside a polygon, and a point off its plane, on the side to which its normal points.
fn across(polygon: &Polygon) -> [PointOrigin; 2] {
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
    [inside, off].map(|p| PointOrigin::Exact(Box::new(p)))
}

/// A sequence of polygons with a chosen direction of crossing for each polygon: the side of its plane to
/// which lines cross.
#[derive(Clone)]
struct Directed {
    polygons: Vec<Polygon>,
    towards: Vec<Ordering>,
    /// The first [`MOST_NORMALS`] different normals with which the direction of a stabbing line must have a
    /// positive scalar product.
    normals: Vec<[IBig; 3]>,
}

impl Directed {
    /// Returns true if a line may exist that crosses a polygon towards `normal` and all polygons so far in
    /// their chosen directions.
    ///
    /// The result is also true if the function cannot decide this.
    fn may_go(&self, normal: &[IBig; 3]) -> bool {
        if self.normals.contains(normal) {
            return true;
        }
        let opposite = normal.each_ref().map(|c| -c);
        if self.normals.contains(&opposite) {
            return false;
        }
        // The directions are a cone. The edges of this cone are among the cross products of two normals, and
        // if the cone has an interior, the sum of its edges is inside.
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
            // Normals in one plane allow both directions across this plane.
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

    /// Records the direction in which lines cross the next polygon, and replaces polygons by `parts`, their
    /// remaining parts. Each part comes with the index of its polygon.
    fn take(&mut self, towards: Ordering, normal: [IBig; 3], parts: Vec<(usize, Polygon)>) {
        if self.normals.len() < MOST_NORMALS && !self.normals.contains(&normal) {
            self.normals.push(normal);
        }
        for (k, part) in parts {
            self.polygons[k] = part;
        }
        self.towards.push(towards);
    }
}

/// The end of the search before all regions are empty.
enum StabEnd {
    Found(Box<[PointOrigin; 2]>),
    Open(UndecidedReason),
}

/// The error that a region could not be decided: the caller must halve the polygons.
struct StabUnprocessable;

/// The state of the search between the first and the last polygon, and the edges of the polygons in between.
struct PairSearch<'a> {
    /// The space of the first and the last polygon, with buffers.
    local: PairState<'a>,
    /// The lines of the edges, each with the side on which a stabbing line passes the edge.
    edges: Vec<(VectorId, Ordering)>,
}

struct StabSearch<'a> {
    limits: &'a QueryLimits,
    stop: &'a dyn Fn() -> bool,
    cost: QueryCost,
}

impl StabSearch<'_> {
    fn all(&mut self, portals: &[Polygon]) -> Result<(), StabEnd> {
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
            // A region has rays for each pair of corners of the first and the last polygon, so the search
            // uses pieces with few corners.
            for a in first.clone().pieces() {
                for b in last.clone().pieces() {
                    match self.pair(&a, &b, &middle, 0) {
                        Ok(()) => {}
                        Err(StabEnd::Open(reason)) => open = Some(reason),
                        Err(found) => return Err(found),
                    }
                }
            }
        }
        open.map_or(Ok(()), |reason| Err(StabEnd::Open(reason)))
    }

    /// Computes all combinations of directions in which a line may cross the polygons in order, each with the
    /// parts of the polygons that the line can cross.
    ///
    /// No such part is on the wrong side of its neighbours' planes. Several combinations arise if a polygon
    /// reaches through another polygon's plane. Each polygon of each combination counts as a region for the
    /// limits.
    fn directed(&mut self, portals: &[Polygon]) -> Result<Vec<Directed>, StabEnd> {
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
                // The normal has no common factor, so that parallel planes have equal or opposite normals.
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
                // For most polygons, only one direction is possible, and then the combination is not copied.
                let other = if greater.is_some() && less.is_some() {
                    Some(way.clone())
                } else {
                    None
                };
                match (greater, less) {
                    (Some(greater), less) => {
                        way.take(Ordering::Greater, up, greater);
                        next.push(way);
                        if let (Some(mut other), Some(less)) = (other, less) {
                            other.take(Ordering::Less, down, less);
                            next.push(other);
                        }
                    }
                    (None, Some(less)) => {
                        way.take(Ordering::Less, down, less);
                        next.push(way);
                    }
                    (None, None) => {}
                }
            }
            // Each combination stores a copy of all polygons, so their number counts as memory.
            if next.len() * n > self.limits.vectors as usize {
                return Err(StabEnd::Open(UndecidedReason::Memory));
            }
            ways = next;
        }
        // The first and the last polygon must be wholly on the required sides of each other's planes, too.
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

    /// Searches the lines from `a` to `b` for a stabbing line, and halves one of the polygons if the first
    /// attempt fails. `depth` is the number of earlier halvings.
    fn pair(
        &mut self,
        a: &Polygon,
        b: &Polygon,
        middle: &[(&Polygon, Ordering)],
        depth: u32,
    ) -> Result<(), StabEnd> {
        if self.try_pair(a, b, middle)?.is_ok() {
            return Ok(());
        }
        if depth == self.limits.divisions {
            return Err(StabEnd::Open(UndecidedReason::Divisions));
        }
        self.cost.divisions += 1;
        let (which, [from, to]) = widest(a, b);
        let mut open = None;
        for half in (if which == QueryPolygon::A { a } else { b }).divided(from, to) {
            let found = match which {
                QueryPolygon::A => self.pair(&half, b, middle, depth + 1),
                QueryPolygon::B => self.pair(a, &half, middle, depth + 1),
            };
            match found {
                Ok(()) => {}
                Err(StabEnd::Open(reason)) => open = Some(reason),
                Err(found) => return Err(found),
            }
        }
        open.map_or(Ok(()), |reason| Err(StabEnd::Open(reason)))
    }

    fn try_pair(
        &mut self,
        a: &Polygon,
        b: &Polygon,
        middle: &[(&Polygon, Ordering)],
    ) -> Result<Result<(), StabUnprocessable>, StabEnd> {
        let (near_a, near_b) = (a.rounded(), b.rounded());
        let mut space = Space::new(Frame::around(&near_a, &near_b));
        let (a_sides, b_sides) = (b.sides(a), a.sides(b));
        let Ok(mut pair) = stabbing_polyhedron::stabbing(&mut space, a, &a_sides, b, &b_sides)
        else {
            return Ok(Err(StabUnprocessable));
        };
        let edges = edges(&mut space, middle);
        let regions = std::mem::take(&mut pair.regions);
        let local = PairState::new(space, pair, [(a, &near_a[..]), (b, &near_b[..])]);
        let mut pair = PairSearch { local, edges };
        let mut result = Ok(());
        for region in regions {
            result = self.region(&mut pair, region)?;
            if result.is_err() {
                break;
            }
        }
        self.cost.decisions += pair.local.space.decisions;
        Ok(result)
    }

    /// Searches a region and the parts that its splits create.
    fn region(
        &mut self,
        pair: &mut PairSearch<'_>,
        region: Region,
    ) -> Result<Result<(), StabUnprocessable>, StabEnd> {
        let region = match self.within(pair, region)? {
            Ok(Some(region)) => region,
            Ok(None) => return Ok(Ok(())),
            Err(StabUnprocessable) => return Ok(Err(StabUnprocessable)),
        };
        let mut open = vec![region];
        let mut splits = 0;
        while let Some(region) = open.pop() {
            self.count(pair.local.space.size())?;
            let local = &mut pair.local;
            match contents(&mut local.space, &region, LINES, &mut local.forms) {
                Contents::Nothing => continue,
                Contents::Unsure => {}
                Contents::Lines(lines) => {
                    for line in lines {
                        if let Some((p, q)) = pair.local.snap(&line) {
                            self.check(pair, p, q)?;
                        }
                    }
                }
            }
            if let Some(line) = klein::precise(&mut pair.local.space, &region)
                && let Some((p, q)) = pair.local.snap_precisely(&line)
            {
                self.check(pair, p, q)?;
            }
            if splits == self.limits.splits {
                return Ok(Err(StabUnprocessable));
            }
            splits += 1;
            self.cost.splits += 1;
            let Some((_, parts)) = polar::split(&mut pair.local.space, &region) else {
                return Ok(Err(StabUnprocessable));
            };
            open.extend(parts);
        }
        Ok(Ok(()))
    }

    /// Counts a region, and returns an error at a limit or if the caller stops the search. `vectors` is the
    /// number of vectors stored.
    fn count(&mut self, vectors: usize) -> Result<(), StabEnd> {
        self.cost
            .region(vectors, self.limits, self.stop)
            .map_or(Ok(()), |reason| Err(StabEnd::Open(reason)))
    }

    /// Returns the part of a region whose lines pass all edges of the polygons in between on the required
    /// sides.
    ///
    /// The result is `None` if this part has no interior. Each cut counts as a region.
    fn within(
        &mut self,
        pair: &mut PairSearch<'_>,
        mut region: Region,
    ) -> Result<Result<Option<Region>, StabUnprocessable>, StabEnd> {
        let PairSearch { local, edges } = pair;
        let mut sides = Vec::new();
        for (edge, keep) in edges.iter() {
            region.sides(&mut local.space, *edge, &mut sides);
            if !sides.contains(keep) {
                return Ok(Ok(None));
            }
            if sides.contains(&keep.reverse()) {
                self.count(local.space.size())?;
                let Ok([less, greater]) = region.split(&mut local.space, *edge, &sides) else {
                    return Ok(Err(StabUnprocessable));
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

    /// Ends the search with the line from `p` to `q` if this line passes all edges on the required sides.
    ///
    /// The ends are strictly inside the first and the last polygon by construction.
    fn check(
        &mut self,
        pair: &mut PairSearch<'_>,
        p: SightLineEnd,
        q: SightLineEnd,
    ) -> Result<(), StabEnd> {
        let PairSearch { local, edges } = pair;
        self.cost.lines += 1;
        let line = local.space.join(p.0, q.0);
        if edges
            .iter()
            .all(|(edge, keep)| local.space.side(line, *edge) == *keep)
        {
            self.cost.decisions += local.space.decisions;
            return Err(StabEnd::Found(Box::new([
                local.source(p.0, 0),
                local.source(q.0, 1),
            ])));
        }
        Ok(())
    }
}

/// Adds the lines of the polygons' edges to the space.
///
/// Each line is returned with its required side: the side on which a line passes the edge if the line crosses
/// the polygon in the polygon's direction.
pub(super) fn edges(
    space: &mut Space,
    middle: &[(&Polygon, Ordering)],
) -> Vec<(VectorId, Ordering)> {
    let mut out = Vec::new();
    for (polygon, towards) in middle {
        let mut point = |source: &PointOrigin| {
            let point = match source {
                PointOrigin::Given(p) => space.frame().given(*p),
                PointOrigin::Exact(p) => space.frame().exact((**p).clone()),
            };
            space.point(point)
        };
        let corners: Vec<u32> = polygon.points().iter().map(&mut point).collect();
        // This line crosses the polygon towards the upper side of its plane.
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

/// Cuts the neighbours of polygon `i` along its plane, and returns the parts that a line can cross if it
/// crosses polygon `i` in the direction `towards`. Each part comes with the index of its polygon.
///
/// The result is `None` if no part of a neighbour remains.
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

/// Returns the part of `polygon` on the side `keep` of the plane of `reference`, or `None` if no corner is on
/// that side.
fn behind(polygon: &Polygon, reference: &Polygon, keep: Ordering) -> Option<Polygon> {
    polygon.part(&reference.plane(), &reference.sides(polygon), keep)
}
