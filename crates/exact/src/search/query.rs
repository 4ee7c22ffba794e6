//! The exact query between two polygons: feedback-guided subtraction in line space (Nirenstein 2003, chapter
//! 5 and section 6.1; the feedback after Haumont et al. 2005).
//!
//! Take a real line inside the remaining region of lines from A to B and trace it. If it meets no triangle it
//! is a witness. Otherwise subtract one of the occluders it meets, the one that covers most of the region,
//! and continue with the pieces outside that occluder. When no piece contains real lines, B is hidden, and
//! the steps are the proof.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use sightline_certificate::proof::{Proof, Step, Which};

use crate::geometry::frame::{Frame, Source};
use crate::geometry::parts::parts;
use crate::geometry::polygon::Polygon;
use crate::line_space::cone::Region;
use crate::line_space::klein::{self, Contents, contents};
use crate::line_space::polar;
use crate::line_space::space::Space;
use crate::line_space::stabbing_polyhedron;
use crate::occluders::{OccluderId, Occluders, OrientedOccluder};
use crate::search::halving::widest;
use crate::search::local::{Local, Snapped, triangles};
use crate::search::trace::Met;
use crate::search::verdict::{Cost, Limits, Reason, Verdict};

/// Whether any part of `b` is seen from `a`, each a convex polygon or the parts of one.
pub fn sightlines(
    scene: &Occluders,
    a: &[Polygon],
    b: &[Polygon],
    limits: &Limits,
) -> (Verdict, Cost) {
    sightlines_until(scene, (a, b), limits, &|| false)
}

/// As [`sightlines`]; `stop` is called before every region; the query ends undecided when it returns true.
pub fn sightlines_until(
    scene: &Occluders,
    (a, b): (&[Polygon], &[Polygon]),
    limits: &Limits,
    stop: &dyn Fn() -> bool,
) -> (Verdict, Cost) {
    let mut search = Search {
        scene,
        limits,
        stop,
        cost: Cost::default(),
        proof: Proof::default(),
        numbers: BTreeMap::new(),
    };
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

/// A step of a proof, and the regions that remain to be processed.
type Found = (Step, Vec<Region>);

/// How the search of a pair ends before it is proved hidden.
enum End {
    Seen(Box<[Source; 2]>),
    Open(Reason),
}

/// Combines the result of a part with the result so far: a visible part ends the search, an open part does
/// not.
fn worst(before: Result<(), Reason>, now: Result<(), End>) -> Result<Result<(), Reason>, End> {
    match now {
        Ok(()) => Ok(before),
        Err(End::Open(reason)) => Ok(Err(reason)),
        Err(End::Seen(witness)) => Err(End::Seen(witness)),
    }
}

/// The search cannot process a region: the polygons must be halved.
struct Stuck;

struct Search<'a> {
    scene: &'a Occluders,
    limits: &'a Limits,
    stop: &'a dyn Fn() -> bool,
    cost: Cost,
    proof: Proof,
    /// The number of each occluder of the proof, by its members.
    numbers: BTreeMap<Vec<OrientedOccluder>, u32>,
}

impl Search<'_> {
    fn polygons(&mut self, a: &Polygon, b: &Polygon) -> Result<(), End> {
        let mut result = Ok(());
        for [x, y] in parts(a, b) {
            result = worst(result, self.pair(&x, &y, 0))?;
        }
        result.map_err(End::Open)
    }

    /// Proves that no unobstructed line connects two parts, and halves them if the first attempt fails.
    fn pair(
        &mut self,
        a: &(Polygon, Vec<Ordering>),
        b: &(Polygon, Vec<Ordering>),
        depth: u32,
    ) -> Result<(), End> {
        let before = (self.proof.steps.len(), self.proof.occluders.len());
        if self.try_pair(a, b)?.is_ok() {
            return Ok(());
        }
        // The steps of a failed attempt are no part of the proof.
        self.proof.steps.truncate(before.0);
        self.proof.occluders.truncate(before.1);
        self.numbers
            .retain(|_, number| (*number as usize) < before.1);
        if depth == self.limits.divisions {
            return Err(End::Open(Reason::Divisions));
        }
        self.cost.divisions += 1;
        let (which, [from, to]) = widest(&a.0, &b.0);
        self.proof.steps.push(Step::Divide {
            of: which,
            from,
            to,
        });
        let mut result = Ok(());
        let (whole, other) = if which == Which::A {
            (&a.0, &b.0)
        } else {
            (&b.0, &a.0)
        };
        for half in whole.divided(from, to) {
            let sides = other.sides(&half);
            // The half lies in the plane of the whole, but its normal may be reversed.
            let half_plane = half.sides(other);
            let (half, rest) = ((half, sides), (other.clone(), half_plane));
            let found = if which == Which::A {
                self.pair(&half, &rest, depth + 1)
            } else {
                self.pair(&rest, &half, depth + 1)
            };
            result = worst(result, found)?;
        }
        result.map_err(End::Open)
    }

    /// As [`Search::pair`], without halving.
    fn try_pair(
        &mut self,
        a: &(Polygon, Vec<Ordering>),
        b: &(Polygon, Vec<Ordering>),
    ) -> Result<Result<(), Stuck>, End> {
        let (near_a, near_b) = (a.0.rounded(), b.0.rounded());
        let mut space = Space::new(Frame::around(&near_a, &near_b));
        let Ok(mut pair) = stabbing_polyhedron::stabbing(&mut space, (&a.0, &a.1), (&b.0, &b.1))
        else {
            return Ok(Err(Stuck));
        };
        let regions = std::mem::take(&mut pair.regions);
        let ends = [(&a.0, &near_a[..]), (&b.0, &near_b[..])];
        let mut local = Local::new(space, pair, ends);
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

    /// Processes one region until none of its pieces remains.
    fn region(&mut self, local: &mut Local<'_>, region: Region) -> Result<Result<(), Stuck>, End> {
        let mut open = vec![region];
        let mut splits = 0;
        while let Some(region) = open.pop() {
            if let Some(reason) = self.cost.region(local.space.size(), self.limits, self.stop) {
                self.cost.decisions += local.space.decisions;
                return Err(End::Open(reason));
            }
            let mut found = match contents(&mut local.space, &region, LINES, &mut local.forms) {
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
                found = polar::split(&mut local.space, &region).map(|(polar, parts)| {
                    (
                        Step::Split {
                            polar: Box::new(polar),
                        },
                        parts.into(),
                    )
                });
            }
            let Some((step, outside)) = found else {
                return Ok(Err(Stuck));
            };
            self.proof.steps.push(step);
            // The first part is processed next.
            open.extend(outside.into_iter().rev());
        }
        Ok(Ok(()))
    }

    /// Traces lines of a region until one is unobstructed or meets an occluder that blocks part of the
    /// region.
    fn feed_back(
        &mut self,
        local: &mut Local<'_>,
        region: &Region,
        lines: &[[f64; 6]],
    ) -> Result<Option<Found>, End> {
        for line in lines {
            let Some(ends) = local.snap(line) else {
                continue;
            };
            if let Some(found) = self.follow(local, region, ends)? {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    /// As [`Search::feed_back`], for a region too thin for doubles.
    fn feed_back_precisely(
        &mut self,
        local: &mut Local<'_>,
        region: &Region,
    ) -> Result<Option<Found>, End> {
        let Some(line) = klein::precise(&mut local.space, region) else {
            return Ok(None);
        };
        let Some(ends) = local.snap_precisely(&line) else {
            return Ok(None);
        };
        self.follow(local, region, ends)
    }

    /// Traces one sight line.
    fn follow(
        &mut self,
        local: &mut Local<'_>,
        region: &Region,
        (p, q): (Snapped, Snapped),
    ) -> Result<Option<Found>, End> {
        self.cost.lines += 1;
        match local.trace(self.scene, (p.0, q.0), (p.1, q.1)) {
            Met::Nothing => {
                self.cost.decisions += local.space.decisions;
                Err(End::Seen(Box::new([
                    local.source(p.0, 0),
                    local.source(q.0, 1),
                ])))
            }
            Met::Grazing => Ok(None),
            Met::Blocked(triangles) => {
                let mut met: Vec<(OccluderId, bool)> = triangles
                    .iter()
                    .filter_map(|(t, front)| self.scene.passed(*t, *front))
                    .collect();
                met.sort_unstable();
                met.dedup_by_key(|m| m.0);
                Ok(self.subtract_best(local, region, &met))
            }
        }
    }

    /// Subtracts one of the occluders that a line meets: the one that blocks most of the region or, if its
    /// subtraction fails, the next. `met` says for each occluder whether the line passes its edges on their
    /// negative side.
    fn subtract_best(
        &mut self,
        local: &mut Local<'_>,
        region: &Region,
        met: &[(OccluderId, bool)],
    ) -> Option<Found> {
        local.begin();
        let mut ranked: Vec<(OccluderId, bool, u32)> = Vec::with_capacity(met.len());
        for (id, negative) in met {
            ranked.push((*id, *negative, local.held(self.scene, *id, *negative)));
        }
        ranked.sort_by(|x, y| {
            let edges = |o: OccluderId| self.scene.occluder(o).border.len();
            y.2.cmp(&x.2)
                .then(edges(x.0).cmp(&edges(y.0)))
                .then(x.0.cmp(&y.0))
        });
        for (id, negative, held) in ranked {
            let fused = local.fuse(self.scene, (id, negative, held));
            // If there is no fused occluder or its subtraction fails, the occluder is tried alone.
            for fused in [fused, None].into_iter().skip(usize::from(fused.is_none())) {
                let known = fused.or_else(|| local.constraints(self.scene, id));
                let taken = known.and_then(|k| Some((k, local.subtract(region, k, negative)?)));
                if let Some((known, (cuts, outside))) = taken {
                    self.cost.occluders += 1;
                    let occluder = self.number(&local.known[known].members);
                    return Some((
                        Step::Block {
                            occluder,
                            negative,
                            cuts,
                        },
                        outside,
                    ));
                }
            }
        }
        None
    }

    /// An occluder's number in the proof.
    fn number(&mut self, members: &[OrientedOccluder]) -> u32 {
        if let Some(number) = self.numbers.get(members) {
            return *number;
        }
        let number = self.proof.occluders.len() as u32;
        self.proof.occluders.push(triangles(self.scene, members));
        self.numbers.insert(members.to_vec(), number);
        number
    }
}

/// Maximum number of lines in doubles that are traced for one region.
const LINES: usize = 2;
