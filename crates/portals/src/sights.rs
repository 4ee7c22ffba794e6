//! What is seen from a view cell through portals: everything that the cell's lines can reach, and perhaps
//! more (Teller 1992, sections 5.3 and 8.3).
//!
//! Lines begin in the box around the parts of the cell where viewpoints are. They leave each leaf through its
//! portals, and go on through those of the leaves beyond. For each portal there are a few outlines: the parts
//! of it that lines from the cell can cross, by the ways they came. Beyond it they stay within the planes
//! that separate the box from the outline. When one more way lights more of a portal, an outline grows to the
//! hull of both, so the work is bounded by the portals and not by their sequences, of which there are
//! exponentially many in open space.
//!
//! A line has crossed other portals before. With each outline there are two gates: the portal that all its
//! lines have crossed just before, and the narrowest on their way. Planes that separate these from the
//! outline bound the lines as well.

use std::collections::VecDeque;

use glam::DVec3;
use rustc_hash::FxHashMap;
use sightline_numbers::Aabb;

use crate::beam::{Body, separators};
use crate::outline::{Errors, HalfSpace, Outline};
use crate::partition::{Part, Partition};
use crate::plane::PlaneId;
use crate::solids::Solid;
use crate::tree::{LeafId, PortalId};

/// How often the lit part of a portal grows before it is taken to be the whole portal, and how often its
/// gates grow before nothing is known of them.
const GROWTHS: u32 = 64;
/// Most outlines of a portal.
const WAYS: usize = 2;

/// Finds the triangles that are not proved to be hidden from a box, ascending. `None` when `stop`, which is
/// called now and then, returns true.
///
/// A segment may begin on a wall in a face of the box and go on at its other side: exact queries from a
/// closed box count it. So unless the box `is_open`, lines also leave through each face into the leaves
/// that lie behind it.
pub fn sights(
    partition: &Partition,
    of: Aabb,
    is_open: bool,
    stop: &dyn Fn() -> bool,
) -> Option<Vec<u32>> {
    let solids = partition.solids(of);
    let mut behind: Vec<(Solid, HalfSpace)> = Vec::new();
    for (axis, up) in (0..3)
        .flat_map(|axis| [(axis, false), (axis, true)])
        .filter(|_| !is_open)
    {
        let mut slab = of;
        let (near, far) = if up {
            (of.max[axis], of.max[axis].next_up())
        } else {
            (of.min[axis], of.min[axis].next_down())
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
    let Some(body) = Body::around(&mut solids.iter().chain(ends), of) else {
        return Some(Vec::new());
    };
    let mut search = Search {
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
            .for_each(|part| is_seen[part.triangle as usize] = true);
        search.go_on(solid.leaf, None, &[], &Gates::NONE);
    }
    for (solid, half) in &behind {
        let is_lit = |part: &&Part| part.outline.within(&[*half], partition.errors()).is_some();
        let parts = partition.parts(solid.leaf).iter().filter(is_lit);
        parts.for_each(|part| is_seen[part.triangle as usize] = true);
        search.go_on(solid.leaf, None, &[*half], &Gates::NONE);
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

/// A portal with the leaf into which it is crossed.
type Crossing = (PortalId, LeafId);

/// What all lines through a portal have crossed before.
#[derive(Clone, Debug)]
enum Gate {
    /// A part of a plane.
    Polygon(Outline),
    /// Parts of several planes, in a box.
    Box([DVec3; 2]),
}

impl Gate {
    fn bounds(&self) -> [DVec3; 2] {
        match self {
            Self::Polygon(outline) => outline.hull.bounds,
            Self::Box(bounds) => *bounds,
        }
    }

    fn body(&self) -> Body {
        match self {
            Self::Polygon(outline) => Body::of_polygon(&outline.hull),
            Self::Box(bounds) => Body::of_box(*bounds),
        }
    }

    /// Whether another gate is the same.
    fn is(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Polygon(a), Self::Polygon(b)) => a.hull.corners == b.hull.corners,
            (Self::Box(a), Self::Box(b)) => a == b,
            _ => false,
        }
    }

    /// Whether another gate is in this one.
    fn holds(&self, other: &Self, errors: Errors) -> bool {
        match (self, other) {
            (Self::Polygon(a), Self::Polygon(b)) => a.is_beside(b) && a.holds(b, errors),
            (Self::Polygon(_), Self::Box(_)) => false,
            (Self::Box([lo, hi]), _) => {
                let [min, max] = other.bounds();
                lo.cmple(min).all() && hi.cmpge(max).all()
            }
        }
    }

    /// What holds both.
    fn with(&self, other: &Self, errors: Errors) -> Self {
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

/// The gates of some lines; `None` where they come from the cell itself.
#[derive(Clone, Debug)]
struct Gates {
    /// The portal before.
    last: Option<Gate>,
    /// The narrowest portal on the way.
    narrowest: Option<Gate>,
}

impl Gates {
    /// The gates of lines from the cell.
    const NONE: Self = Self {
        last: None,
        narrowest: None,
    };

    /// The gates beyond a portal with these gates.
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

    /// Each gate with another one.
    fn both<'a>(&'a self, other: &'a Self) -> [(&'a Option<Gate>, &'a Option<Gate>); 2] {
        [
            (&self.last, &other.last),
            (&self.narrowest, &other.narrowest),
        ]
    }

    /// Whether others are in these.
    fn hold(&self, other: &Self, errors: Errors) -> bool {
        self.both(other).iter().all(|pair| match pair {
            (Some(a), Some(b)) => a.holds(b, errors),
            (Some(_), None) => false,
            (None, _) => true,
        })
    }

    /// The gates of lines that have crossed either.
    fn or(&self, other: &Self, errors: Errors) -> Self {
        let [last, narrowest] = self
            .both(other)
            .map(|(a, b)| a.as_ref().zip(b.as_ref()).map(|(a, b)| a.with(b, errors)));
        Self { last, narrowest }
    }

    /// Whether polygons hold these and others without becoming boxes, or these are boxes or nothing already.
    fn are_beside(&self, other: &Self) -> bool {
        self.both(other).iter().all(|pair| match pair {
            (Some(Gate::Polygon(a)), Some(Gate::Polygon(b))) => a.is_beside(b),
            (Some(Gate::Polygon(_)), _) => false,
            (Some(Gate::Box(_)) | None, _) => true,
        })
    }

    /// The same with slack to find that others are inside. The narrowest gate is handed on from portal to
    /// portal as it is, so that it is the same whatever its way.
    fn widened(self, errors: Errors) -> Self {
        let last = match self.last {
            Some(Gate::Polygon(outline)) => Some(Gate::Polygon(outline.widened(errors))),
            other => other,
        };
        Self { last, ..self }
    }
}

/// A lit part of a portal.
struct Lit {
    outline: Outline,
    gates: Gates,
    /// How often the outline and the gates have grown.
    growths: [u32; 2],
    is_waiting: bool,
}

struct Search<'a> {
    partition: &'a Partition,
    body: Body,
    /// The lit parts of each portal.
    lit: FxHashMap<Crossing, Vec<Lit>>,
    /// The crossings in the order in which they were first lit.
    order: Vec<Crossing>,
    /// Those whose light has not gone on, with the number of the part.
    waiting: VecDeque<(Crossing, usize)>,
}

impl Search<'_> {
    /// Lights all portals; false when stopped.
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
            self.go_on(crossing.1, plane, &beam, &gates);
        }
        true
    }

    /// The half-spaces beyond a lit part of a portal.
    fn beam(&self, crossing: Crossing, way: usize) -> Vec<HalfSpace> {
        let mut beam = Vec::new();
        beam.extend(self.partition.beyond(crossing.0, crossing.1));
        let Some(lit) = self.lit.get(&crossing).and_then(|ways| ways.get(way)) else {
            return beam;
        };
        let (hull, errors) = (&lit.outline.hull, self.partition.errors());
        separators(&self.body, hull, errors, &mut beam);
        let Gates { last, narrowest } = &lit.gates;
        let is_other = |gate: &&Gate| last.as_ref().is_none_or(|last| !last.is(gate));
        for gate in last.iter().chain(narrowest.iter().filter(is_other)) {
            separators(&gate.body(), hull, errors, &mut beam);
        }
        beam
    }

    /// Lights the portals of a leaf that lines can cross within some half-spaces. They have entered it
    /// through a portal in a plane, which they do not cross again.
    fn go_on(&mut self, leaf: LeafId, entered: Option<PlaneId>, beam: &[HalfSpace], gates: &Gates) {
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

    fn light(&mut self, crossing: Crossing, part: Outline, gates: &Gates, whole: &Outline) {
        let errors = self.partition.errors();
        let ways = self.lit.entry(crossing).or_default();
        let holds_part = |lit: &Lit| lit.growths[0] >= GROWTHS || lit.outline.holds(&part, errors);
        let holds = |lit: &Lit| holds_part(lit) && lit.gates.hold(gates, errors);
        if ways.iter().any(holds) {
            return;
        }
        let same = ways.iter().position(|lit| lit.gates.are_beside(gates));
        if same.is_none() && ways.len() < WAYS {
            if ways.is_empty() {
                self.order.push(crossing);
            }
            self.waiting.push_back((crossing, ways.len()));
            ways.push(Lit {
                outline: part.widened(errors),
                gates: gates.clone().widened(errors),
                growths: [0; 2],
                is_waiting: true,
            });
            return;
        }
        // The last one takes all that came by other ways.
        let way = same.unwrap_or(ways.len() - 1);
        let lit = &mut ways[way];
        // It does not hold both, so one of them grows. The whole portal cannot.
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

    /// Marks the triangles with parts that are in the light.
    fn show(&self, is_seen: &mut [bool]) {
        for crossing in &self.order {
            let parts = self.partition.parts(crossing.1);
            let ways = self.lit.get(crossing).map_or(&[][..], |ways| ways);
            for (way, lit) in ways.iter().enumerate() {
                if parts.iter().all(|part| is_seen[part.triangle as usize]) {
                    break;
                }
                let beam = self.beam(*crossing, way);
                // Nothing in the portal's plane is seen through it.
                let is_lit = |part: &Part| {
                    !part.outline.is_beside(&lit.outline)
                        && part
                            .outline
                            .within(&beam, self.partition.errors())
                            .is_some()
                };
                for part in parts {
                    let is_seen = &mut is_seen[part.triangle as usize];
                    *is_seen = *is_seen || is_lit(part);
                }
            }
        }
    }
}
