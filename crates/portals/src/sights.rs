//! The triangles that are visible from a view cell through portals: a conservative set (Teller 1992, sections
//! 5.3 and 8.3).
//!
//! Lines begin in the box around the parts of the cell that contain viewpoints. Lines leave each leaf through
//! its portals and continue through the portals of the leaves beyond. Each portal has at most two outlines
//! per direction: the parts of the portal that lines from the cell can cross. Lines that reach the portal by
//! different ways can have different outlines. Beyond the portal, the lines stay within the planes that
//! separate the box from the outline. If lines on another way cross more of a portal, an outline grows to the
//! hull of both. So the number of portals bounds the work, although open space has exponentially many
//! sequences of portals.
//!
//! A line that crosses an outline has crossed other portals before. Each outline has two gates: the portal
//! that all lines through the outline crossed last, and the narrowest portal on their way. Planes that
//! separate the gates from the outline bound the lines as well.

use std::collections::VecDeque;

use glam::DVec3;
use rustc_hash::FxHashMap;
use sightline_numbers::Aabb;

use crate::beam::{LineSource, separators};
use crate::outline::{ErrorBounds, HalfSpace, Outline};
use crate::partition::{Partition, TrianglePart};
use crate::plane::PlaneId;
use crate::solids::Solid;
use crate::tree::{LeafId, PortalId};

/// The number of growths after which the search stops enlarging an outline, or its gates, step by step.
///
/// At this number, the outline becomes the whole portal, or the search removes the gates.
const GROWTHS: u32 = 64;
/// The maximum number of outlines of a portal per direction in which lines cross the portal.
const WAYS: usize = 2;

/// Computes the triangles that are not proved to be hidden from a box, in ascending order.
///
/// The function calls `stop` repeatedly. The result is `None` if `stop` returns true.
///
/// A segment may begin on a wall in a face of the box and continue behind the wall, and exact queries from a
/// closed box count such a segment. So lines also leave through each face into the leaves behind the face,
/// unless `is_open` is true.
pub fn sights(
    partition: &Partition,
    cell: Aabb,
    is_open: bool,
    stop: &dyn Fn() -> bool,
) -> Option<Vec<u32>> {
    let solids = partition.solids(cell);
    let mut behind: Vec<(Solid, HalfSpace)> = Vec::new();
    for (axis, up) in (0..3)
        .flat_map(|axis| [(axis, false), (axis, true)])
        .filter(|_| !is_open)
    {
        let mut slab = cell;
        let (near, far) = if up {
            (cell.max[axis], cell.max[axis].next_up())
        } else {
            (cell.min[axis], cell.min[axis].next_down())
        };
        (slab.min[axis], slab.max[axis]) = (near.min(far), near.max(far));
        let half = HalfSpace::across(axis, up, f64::from(near));
        let is_new = |solid: &Solid| solids.iter().all(|known| known.leaf != solid.leaf);
        behind.extend(
            partition
                .solids(slab)
                .into_iter()
                .filter(is_new)
                .map(|solid| (solid, half)),
        );
    }
    let ends = behind.iter().map(|(solid, _)| solid);
    let Some(body) = LineSource::around(&mut solids.iter().chain(ends), cell) else {
        return Some(Vec::new());
    };
    let mut search = SightSearch {
        partition,
        body,
        lit: FxHashMap::default(),
        order: Vec::new(),
        waiting: VecDeque::new(),
    };
    let mut is_seen = vec![false; partition.triangles()];
    for solid in &solids {
        partition
            .parts(solid.leaf)
            .iter()
            .for_each(|part| is_seen[part.triangle.at()] = true);
        search.light_portals(solid.leaf, None, &[], &Gates::NONE);
    }
    for (solid, half) in &behind {
        let is_lit =
            |part: &&TrianglePart| part.outline.within(&[*half], partition.errors()).is_some();
        let parts = partition.parts(solid.leaf).iter().filter(is_lit);
        parts.for_each(|part| is_seen[part.triangle.at()] = true);
        search.light_portals(solid.leaf, None, &[*half], &Gates::NONE);
    }
    if !search.run(stop) {
        return None;
    }
    search.show(&mut is_seen);
    Some(
        (0..is_seen.len() as u32)
            .filter(|id| is_seen[*id as usize])
            .collect(),
    )
}

/// A portal with the leaf into which lines cross it.
type Crossing = (PortalId, LeafId);

/// A part of space that all lines through an outline of a portal have crossed before.
#[derive(Clone, Debug)]
enum Gate {
    /// A part of a plane.
    Polygon(Outline),
    /// A box around parts of several planes.
    Box([DVec3; 2]),
}

impl Gate {
    fn bounds(&self) -> [DVec3; 2] {
        match self {
            Self::Polygon(outline) => outline.hull.bounds,
            Self::Box(bounds) => *bounds,
        }
    }

    fn body(&self) -> LineSource {
        match self {
            Self::Polygon(outline) => LineSource::of_polygon(&outline.hull),
            Self::Box(bounds) => LineSource::of_box(*bounds),
        }
    }

    /// Returns true if another gate has the same corners or bounds as this gate.
    fn equals(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Polygon(a), Self::Polygon(b)) => a.hull.corners == b.hull.corners,
            (Self::Box(a), Self::Box(b)) => a == b,
            _ => false,
        }
    }

    /// Returns true if another gate is certainly inside this gate.
    fn holds(&self, other: &Self, errors: ErrorBounds) -> bool {
        match (self, other) {
            (Self::Polygon(a), Self::Polygon(b)) => a.is_beside(b) && a.holds(b, errors),
            (Self::Polygon(_), Self::Box(_)) => false,
            (Self::Box([lo, hi]), _) => {
                let [min, max] = other.bounds();
                lo.cmple(min).all() && hi.cmpge(max).all()
            }
        }
    }

    /// Computes a gate that contains this gate and another gate.
    fn with(&self, other: &Self, errors: ErrorBounds) -> Self {
        match (self, other) {
            (Self::Polygon(a), Self::Polygon(b)) if a.is_beside(b) => {
                Self::Polygon(a.joined(b, errors))
            }
            _ => {
                let ([a0, a1], [b0, b1]) = (self.bounds(), other.bounds());
                Self::Box([a0.min(b0), a1.max(b1)])
            }
        }
    }
}

/// The gates of some lines. A gate is `None` if the lines come from the cell itself, or if no
/// portal is known that all lines have crossed.
#[derive(Clone, Debug)]
struct Gates {
    /// The portal that the lines crossed last.
    last: Option<Gate>,
    /// The narrowest portal that the lines have crossed.
    narrowest: Option<Gate>,
}

impl Gates {
    /// The gates of lines from the cell.
    const NONE: Self = Self {
        last: None,
        narrowest: None,
    };

    /// Computes the gates of lines beyond an outline of a portal, if the lines have these gates before the
    /// portal.
    fn beyond(&self, portal: &Outline) -> Self {
        let wide = |[lo, hi]: [DVec3; 2]| (hi - lo).length_squared();
        let own = Gate::Polygon(portal.clone());
        let known = self
            .narrowest
            .clone()
            .filter(|known| wide(known.bounds()) <= wide(own.bounds()));
        Self {
            narrowest: Some(known.unwrap_or_else(|| own.clone())),
            last: Some(own),
        }
    }

    /// Pairs each gate with the corresponding gate of `other`.
    fn both<'a>(&'a self, other: &'a Self) -> [(&'a Option<Gate>, &'a Option<Gate>); 2] {
        [
            (&self.last, &other.last),
            (&self.narrowest, &other.narrowest),
        ]
    }

    /// Returns true if the gates of `other` are inside these gates.
    fn hold(&self, other: &Self, errors: ErrorBounds) -> bool {
        self.both(other).iter().all(|pair| match pair {
            (Some(a), Some(b)) => a.holds(b, errors),
            (Some(_), None) => false,
            (None, _) => true,
        })
    }

    /// Computes gates that contain these gates and the gates of `other`.
    fn or(&self, other: &Self, errors: ErrorBounds) -> Self {
        let [last, narrowest] = self
            .both(other)
            .map(|(a, b)| a.as_ref().zip(b.as_ref()).map(|(a, b)| a.with(b, errors)));
        Self { last, narrowest }
    }

    /// Returns true if these gates can grow to contain the gates of `other` and no polygon becomes a box.
    ///
    /// A gate that is already a box or `None` fulfils this condition.
    fn are_beside(&self, other: &Self) -> bool {
        self.both(other).iter().all(|pair| match pair {
            (Some(Gate::Polygon(a)), Some(Gate::Polygon(b))) => a.is_beside(b),
            (Some(Gate::Polygon(_)), _) => false,
            (Some(Gate::Box(_)) | None, _) => true,
        })
    }

    /// Returns these gates with additional slack, so that later comparisons find that other gates are inside.
    ///
    /// The function does not widen the narrowest gate. Later portals receive it unchanged, so that it does
    /// not depend on the way.
    fn widened(self, errors: ErrorBounds) -> Self {
        let last = match self.last {
            Some(Gate::Polygon(outline)) => Some(Gate::Polygon(outline.widened(errors))),
            other => other,
        };
        Self { last, ..self }
    }
}

/// An outline of a portal, with the gates of the lines that cross the outline.
struct LitPart {
    outline: Outline,
    gates: Gates,
    /// The number of times that the outline has grown, and the number of times that the gates have grown.
    growths: [u32; 2],
    /// True if the search must still follow the lines beyond the outline.
    is_waiting: bool,
}

struct SightSearch<'a> {
    partition: &'a Partition,
    body: LineSource,
    /// The outlines of each crossing.
    lit: FxHashMap<Crossing, Vec<LitPart>>,
    /// The crossings in the order in which lines first reached them.
    order: Vec<Crossing>,
    /// The crossings beyond which the search must still follow the lines, each with the index of its outline
    /// in `lit`.
    waiting: VecDeque<(Crossing, usize)>,
}

impl SightSearch<'_> {
    /// Follows the lines through all portals that the lines reach. Returns false if `stop` returned true and
    /// ended the search.
    fn run(&mut self, stop: &dyn Fn() -> bool) -> bool {
        while let Some((crossing, way)) = self.waiting.pop_front() {
            if stop() {
                return false;
            }
            let Some(lit) = self
                .lit
                .get_mut(&crossing)
                .and_then(|ways| ways.get_mut(way))
            else {
                continue;
            };
            lit.is_waiting = false;
            let (plane, gates) = (lit.outline.plane, lit.gates.beyond(&lit.outline));
            let beam = self.beam(crossing, way);
            self.light_portals(crossing.1, plane, &beam, &gates);
        }
        true
    }

    /// Computes the half-spaces that bound the lines beyond the outline `way` of a portal.
    fn beam(&self, crossing: Crossing, way: usize) -> Vec<HalfSpace> {
        let mut beam = Vec::new();
        beam.extend(self.partition.beyond(crossing.0, crossing.1));
        let Some(lit) = self.lit.get(&crossing).and_then(|ways| ways.get(way)) else {
            return beam;
        };
        let (hull, errors) = (&lit.outline.hull, self.partition.errors());
        separators(&self.body, hull, errors, &mut beam);
        let Gates { last, narrowest } = &lit.gates;
        let is_other = |gate: &&Gate| last.as_ref().is_none_or(|last| !last.equals(gate));
        for gate in last.iter().chain(narrowest.iter().filter(is_other)) {
            separators(&gate.body(), hull, errors, &mut beam);
        }
        beam
    }

    /// Adds outlines to the portals of a leaf that lines within the half-spaces of `beam` can cross.
    ///
    /// The lines entered the leaf through a portal in the plane `entered`, and do not cross this plane again.
    /// `entered` is `None` if the lines start in the leaf.
    fn light_portals(
        &mut self,
        leaf: LeafId,
        entered: Option<PlaneId>,
        beam: &[HalfSpace],
        gates: &Gates,
    ) {
        let partition = self.partition;
        for portal in &partition.tree().leaf(leaf).portals {
            let Some(whole) = partition.opening(*portal) else {
                continue;
            };
            let into = partition.tree().portal(*portal).beyond(leaf);
            if entered.is_some() && whole.plane == entered
                || partition.is_beyond(*portal, into, &self.body)
            {
                continue;
            }
            if let Some(part) = whole.within(beam, partition.errors()) {
                self.light((*portal, into), part, gates, whole);
            }
        }
    }

    /// Adds the part of a portal that lines with some gates can cross: as a new outline, or by growth of an
    /// outline of the portal. `whole` is the outline of the whole portal.
    fn light(&mut self, crossing: Crossing, part: Outline, gates: &Gates, whole: &Outline) {
        let errors = self.partition.errors();
        let ways = self.lit.entry(crossing).or_default();
        let holds_part =
            |lit: &LitPart| lit.growths[0] >= GROWTHS || lit.outline.holds(&part, errors);
        let holds = |lit: &LitPart| holds_part(lit) && lit.gates.hold(gates, errors);
        if ways.iter().any(holds) {
            return;
        }
        let same = ways.iter().position(|lit| lit.gates.are_beside(gates));
        if same.is_none() && ways.len() < WAYS {
            if ways.is_empty() {
                self.order.push(crossing);
            }
            self.waiting.push_back((crossing, ways.len()));
            ways.push(LitPart {
                outline: part.widened(errors),
                gates: gates.clone().widened(errors),
                growths: [0; 2],
                is_waiting: true,
            });
            return;
        }
        // The last outline receives all lines that come by further ways.
        let way = same.unwrap_or(ways.len() - 1);
        let lit = &mut ways[way];
        // The existing part does not contain both the new outline and the new gates, so its outline or its
        // gates grow. An outline that is the whole portal cannot grow.
        if !holds_part(lit) {
            lit.growths[0] += 1;
            lit.outline = if lit.growths[0] < GROWTHS {
                lit.outline.joined(&part, errors)
            } else {
                whole.clone()
            };
        }
        if !lit.gates.hold(gates, errors) {
            lit.growths[1] += 1;
            lit.gates = if lit.growths[1] < GROWTHS {
                lit.gates.or(gates, errors)
            } else {
                Gates::NONE
            };
        }
        if !std::mem::replace(&mut lit.is_waiting, true) {
            self.waiting.push_back((crossing, way));
        }
    }

    /// Marks the triangles that lines beyond the portals can reach.
    fn show(&self, is_seen: &mut [bool]) {
        for crossing in &self.order {
            let parts = self.partition.parts(crossing.1);
            let ways = self.lit.get(crossing).map_or(&[][..], |ways| ways);
            for (way, lit) in ways.iter().enumerate() {
                if parts.iter().all(|part| is_seen[part.triangle.at()]) {
                    break;
                }
                let beam = self.beam(*crossing, way);
                // Lines through the portal do not meet triangles in the portal's plane.
                let is_lit = |part: &TrianglePart| {
                    !part.outline.is_beside(&lit.outline)
                        && part
                            .outline
                            .within(&beam, self.partition.errors())
                            .is_some()
                };
                for part in parts {
                    let is_seen = &mut is_seen[part.triangle.at()];
                    *is_seen = *is_seen || is_lit(part);
                }
            }
        }
    }
}
