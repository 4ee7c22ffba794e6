//! The exact query between two polygons: feedback-guided subtraction in line space (Nirenstein 2003, chapter
//! 5 and section 6.1; the feedback follows Haumont et al. 2005).
//!
//! The search traces a real line inside the remaining region of lines from A to B. If the line between the
//! polygons meets no triangle, the line is a witness. Otherwise the search subtracts one of the occluders
//! that the line meets, the occluder that covers most of the region. Then it continues with the pieces
//! outside that occluder. When no piece contains real lines, B is hidden, and the steps are the proof.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use sightline_certificate::proof::{Proof, QueryPolygon, Step};
use sightline_scene::TriangleId;

use crate::geometry::frame::{Frame, PointOrigin};
use crate::geometry::parts::parts;
use crate::geometry::polygon::Polygon;
use crate::line_space::cone::Region;
use crate::line_space::klein::{self, Contents, contents};
use crate::line_space::polar;
use crate::line_space::space::Space;
use crate::line_space::stabbing_polyhedron;
use crate::occluders::{OccluderId, Occluders, OrientedOccluder};
use crate::search::halves::widest;
use crate::search::local::{PairState, SightLineEnd, triangles};
use crate::search::trace::SegmentMeeting;
use crate::search::verdict::{QueryCost, QueryLimits, UndecidedReason, Verdict};

/// Queries whether any part of `b` is visible from `a`.
///
/// `a` and `b` are each a list of convex polygons: one polygon, or the parts of one polygon.
pub fn sightlines(
    scene: &Occluders,
    a: &[Polygon],
    b: &[Polygon],
    limits: &QueryLimits,
) -> (Verdict, QueryCost) {
    sightlines_until(scene, a, b, limits, &|| false)
}

/// Queries like [`sightlines`], with a callback that can stop the search.
///
/// The function calls `stop` before every region, and the query ends undecided if `stop` returns true.
pub fn sightlines_until(
    scene: &Occluders,
    a: &[Polygon],
    b: &[Polygon],
    limits: &QueryLimits,
    stop: &dyn Fn() -> bool,
) -> (Verdict, QueryCost) {
    let mut search = HiddenSearch {
        scene,
        limits,
        stop,
        cost: QueryCost::default(),
        proof: Proof::default(),
        numbers: BTreeMap::new(),
    };
    let mut open: Option<UndecidedReason> = None;
    for x in a {
        for y in b {
            match search.polygons(x, y) {
                Ok(()) => {}
                Err(PairEnd::Seen(witness)) => return (Verdict::Visible(witness), search.cost),
                // Another part may still be visible.
                Err(PairEnd::Open(reason)) => open = Some(reason),
            }
        }
    }
    let verdict = match open {
        None => Verdict::Hidden(search.proof),
        Some(reason) => Verdict::Undecided(reason),
    };
    (verdict, search.cost)
}

/// A step of a proof, and the parts of the region that remain to be processed after this step.
type PairStep = (Step, Vec<Region>);

/// The end of the search of a pair before the pair is proved hidden.
enum PairEnd {
    Seen(Box<[PointOrigin; 2]>),
    Open(UndecidedReason),
}

/// Combines the result of a part with the result so far. A visible part ends the search; an undecided part
/// does not.
fn worst(
    before: Result<(), UndecidedReason>,
    now: Result<(), PairEnd>,
) -> Result<Result<(), UndecidedReason>, PairEnd> {
    match now {
        Ok(()) => Ok(before),
        Err(PairEnd::Open(reason)) => Ok(Err(reason)),
        Err(PairEnd::Seen(witness)) => Err(PairEnd::Seen(witness)),
    }
}

/// The error that no step could be found for a region: the caller must halve the polygons.
struct Unprocessable;

struct HiddenSearch<'a> {
    scene: &'a Occluders,
    limits: &'a QueryLimits,
    stop: &'a dyn Fn() -> bool,
    cost: QueryCost,
    proof: Proof,
    /// The index of each occluder in the proof's list of occluders, by its members.
    numbers: BTreeMap<Vec<OrientedOccluder>, u32>,
}

impl HiddenSearch<'_> {
    fn polygons(&mut self, a: &Polygon, b: &Polygon) -> Result<(), PairEnd> {
        let mut result = Ok(());
        for [x, y] in parts(a, b) {
            result = worst(result, self.pair(&x, &y, 0))?;
        }
        result.map_err(PairEnd::Open)
    }

    /// Proves that no unobstructed line connects two parts of polygons, and halves one of them if the first
    /// attempt fails. `depth` is the number of earlier halvings.
    fn pair(
        &mut self,
        a: &(Polygon, Vec<Ordering>),
        b: &(Polygon, Vec<Ordering>),
        depth: u32,
    ) -> Result<(), PairEnd> {
        let before = (self.proof.steps.len(), self.proof.occluders.len());
        if self.try_pair(a, b)?.is_ok() {
            return Ok(());
        }
        // The steps of a failed attempt do not belong to the proof.
        self.proof.steps.truncate(before.0);
        self.proof.occluders.truncate(before.1);
        self.numbers
            .retain(|_, number| (*number as usize) < before.1);
        if depth == self.limits.divisions {
            return Err(PairEnd::Open(UndecidedReason::Divisions));
        }
        self.cost.divisions += 1;
        let (which, [from, to]) = widest(&a.0, &b.0);
        self.proof.steps.push(Step::Divide {
            polygon: which,
            from,
            to,
        });
        let mut result = Ok(());
        let (whole, other) = if which == QueryPolygon::A {
            (&a.0, &b.0)
        } else {
            (&b.0, &a.0)
        };
        for half in whole.divided(from, to) {
            let sides = other.sides(&half);
            // The half lies in the plane of the whole polygon, but its normal may be reversed.
            let half_plane = half.sides(other);
            let (half, rest) = ((half, sides), (other.clone(), half_plane));
            let found = if which == QueryPolygon::A {
                self.pair(&half, &rest, depth + 1)
            } else {
                self.pair(&rest, &half, depth + 1)
            };
            result = worst(result, found)?;
        }
        result.map_err(PairEnd::Open)
    }

    /// Proves a pair like [`HiddenSearch::pair`], without halving.
    fn try_pair(
        &mut self,
        a: &(Polygon, Vec<Ordering>),
        b: &(Polygon, Vec<Ordering>),
    ) -> Result<Result<(), Unprocessable>, PairEnd> {
        let (near_a, near_b) = (a.0.rounded(), b.0.rounded());
        let mut space = Space::new(Frame::around(&near_a, &near_b));
        let Ok(mut pair) = stabbing_polyhedron::stabbing(&mut space, &a.0, &a.1, &b.0, &b.1) else {
            return Ok(Err(Unprocessable));
        };
        let regions = std::mem::take(&mut pair.regions);
        let ends = [(&a.0, &near_a[..]), (&b.0, &near_b[..])];
        let mut local = PairState::new(space, pair, ends);
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
    fn region(
        &mut self,
        local: &mut PairState<'_>,
        region: Region,
    ) -> Result<Result<(), Unprocessable>, PairEnd> {
        let mut open = vec![region];
        let mut splits = 0;
        while let Some(region) = open.pop() {
            if let Some(reason) = self.cost.region(local.space.size(), self.limits, self.stop) {
                self.cost.decisions += local.space.decisions;
                return Err(PairEnd::Open(reason));
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
                return Ok(Err(Unprocessable));
            };
            self.proof.steps.push(step);
            // The first part is processed next.
            open.extend(outside.into_iter().rev());
        }
        Ok(Ok(()))
    }

    /// Traces lines of a region until a line is unobstructed or meets an occluder that blocks part of the
    /// region.
    ///
    /// The function returns the step that subtracts the occluder, or `None` if no line leads to such a step.
    fn feed_back(
        &mut self,
        local: &mut PairState<'_>,
        region: &Region,
        lines: &[[f64; 6]],
    ) -> Result<Option<PairStep>, PairEnd> {
        for line in lines {
            let Some((p, q)) = local.snap(line) else {
                continue;
            };
            if let Some(found) = self.follow(local, region, p, q)? {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    /// Traces a line like [`HiddenSearch::feed_back`], for a region too thin for doubles.
    fn feed_back_precisely(
        &mut self,
        local: &mut PairState<'_>,
        region: &Region,
    ) -> Result<Option<PairStep>, PairEnd> {
        let Some(line) = klein::precise(&mut local.space, region) else {
            return Ok(None);
        };
        let Some((p, q)) = local.snap_precisely(&line) else {
            return Ok(None);
        };
        self.follow(local, region, p, q)
    }

    /// Traces the sight line from `p` to `q`, and subtracts one of the occluders that it meets from the
    /// region.
    fn follow(
        &mut self,
        local: &mut PairState<'_>,
        region: &Region,
        p: SightLineEnd,
        q: SightLineEnd,
    ) -> Result<Option<PairStep>, PairEnd> {
        self.cost.lines += 1;
        match local.trace(self.scene, p, q) {
            SegmentMeeting::Nothing => {
                self.cost.decisions += local.space.decisions;
                Err(PairEnd::Seen(Box::new([
                    local.source(p.0, 0),
                    local.source(q.0, 1),
                ])))
            }
            SegmentMeeting::Grazing => Ok(None),
            SegmentMeeting::Blocked(triangles) => {
                let mut met: Vec<(OccluderId, bool)> = triangles
                    .iter()
                    .filter_map(|(t, front)| self.scene.passed(TriangleId(*t), *front))
                    .collect();
                met.sort_unstable();
                met.dedup_by_key(|m| m.0);
                Ok(self.subtract_best(local, region, &met))
            }
        }
    }

    /// Subtracts the occluder that blocks most of the region from the region.
    ///
    /// The candidates are the occluders that a sight line meets. If the subtraction of one fails, the
    /// function tries the candidate that blocks the next largest part.
    ///
    /// The flag of an occluder in `met` is true if the line passes its edges on their negative side.
    fn subtract_best(
        &mut self,
        local: &mut PairState<'_>,
        region: &Region,
        met: &[(OccluderId, bool)],
    ) -> Option<PairStep> {
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
            let fused = local.fuse(self.scene, id, negative, held);
            // If no fused occluder exists or its subtraction fails, the occluder is subtracted without its
            // neighbours.
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

    /// Returns the index of an occluder in the proof's list of occluders, and adds the occluder if needed.
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

/// The maximum number of lines in doubles that are traced for one region.
const LINES: usize = 2;
