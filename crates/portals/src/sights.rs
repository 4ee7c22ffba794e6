//! What is seen from a view cell through portals: everything that the cell's lines can reach, and perhaps
//! more (Teller 1992, sections 5.3 and 8.3).
//!
//! Lines begin in the box around the parts of the cell where viewpoints are. They leave each leaf through its
//! portals, and go on through those of the leaves beyond. For each portal there is one outline: the part of
//! it that lines from the cell can cross, whichever way they came. Beyond it they stay within the planes that
//! separate the box from the outline. When a second way to a portal lights more of it, the outline grows to
//! the hull of both, so the work is bounded by the portals and not by their sequences, of which there are
//! exponentially many in open space.
//!
//! A line has crossed other portals before. For each portal there are two more boxes: one that all lines have
//! crossed just before, and one around the narrowest portals on their ways. Planes that separate these from
//! the outline bound the lines as well.

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
const GROWTHS: u32 = 8;

/// Finds the triangles that are not proved to be hidden from a box, ascending. `None` when `stop`, which is
/// called now and then, returns true.
///
/// A segment may begin on a wall in a face of the box and go on at its other side: exact queries from a
/// closed box count it. So unless the box `is_open`, lines also leave through each face into the leaves
/// that lie behind it.
pub fn sights(partition: &Partition, of: Aabb, is_open: bool, stop: &dyn Fn() -> bool) -> Option<Vec<u32>> {
    let solids = partition.solids(of);
    let mut behind: Vec<(Solid, HalfSpace)> = Vec::new();
    for (axis, up) in (0..3).flat_map(|axis| [(axis, false), (axis, true)]).filter(|_| !is_open) {
        let mut slab = of;
        let (near, far) = if up {
            (of.max[axis], of.max[axis].next_up())
        } else {
            (of.min[axis], of.min[axis].next_down())
        };
        (slab.min[axis], slab.max[axis]) = (near.min(far), near.max(far));
        let half = HalfSpace::across(axis, up, f64::from(near));
        let is_new = |solid: &Solid| solids.iter().all(|known| known.leaf != solid.leaf);
        behind.extend(partition.solids(slab).into_iter().filter(is_new).map(|solid| (solid, half)));
    }
    let ends = behind.iter().map(|(solid, _)| solid);
    let Some(body) = Body::around(&mut solids.iter().chain(ends), of) else { return Some(Vec::new()) };
    let mut search =
        Search { partition, body, lit: FxHashMap::default(), order: Vec::new(), waiting: VecDeque::new() };
    let mut is_seen = vec![false; partition.triangles()];
    for solid in &solids {
        partition.parts(solid.leaf).iter().for_each(|part| is_seen[part.triangle as usize] = true);
        search.go_on(solid.leaf, None, &[], Gates::NONE);
    }
    for (solid, half) in &behind {
        let is_lit = |part: &&Part| clip(&part.outline, &[*half], partition.errors()).is_some();
        let parts = partition.parts(solid.leaf).iter().filter(is_lit);
        parts.for_each(|part| is_seen[part.triangle as usize] = true);
        search.go_on(solid.leaf, None, &[*half], Gates::NONE);
    }
    if !search.run(stop) {
        return None;
    }
    search.show(&mut is_seen);
    Some((0..is_seen.len() as u32).filter(|id| is_seen[*id as usize]).collect())
}

/// A portal with the leaf into which it is crossed.
type Crossing = (PortalId, LeafId);

type Bounds = [DVec3; 2];

/// Boxes that all lines through a portal have crossed before; `None` where they come from the cell itself.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gates {
    /// Around the portals before.
    last: Option<Bounds>,
    /// Around the narrowest portals on the ways.
    narrowest: Option<Bounds>,
}

impl Gates {
    /// The boxes of lines from the cell.
    const NONE: Self = Self { last: None, narrowest: None };

    /// The boxes beyond a portal with these boxes.
    fn beyond(self, portal: Bounds) -> Self {
        let wide = |of: &Bounds| (of[1] - of[0]).length_squared();
        let narrowest = self.narrowest.filter(|known| wide(known) <= wide(&portal)).unwrap_or(portal);
        Self { last: Some(portal), narrowest: Some(narrowest) }
    }

    /// The boxes of lines that have crossed either.
    fn or(self, other: Self) -> Self {
        let union =
            |a: Option<Bounds>, b: Option<Bounds>| a.zip(b).map(|(a, b)| [a[0].min(b[0]), a[1].max(b[1])]);
        Self { last: union(self.last, other.last), narrowest: union(self.narrowest, other.narrowest) }
    }
}

/// The lit part of a portal.
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
    lit: FxHashMap<Crossing, Lit>,
    /// The crossings in the order in which they were first lit.
    order: Vec<Crossing>,
    waiting: VecDeque<Crossing>,
}

impl Search<'_> {
    /// Lights all portals; false when stopped.
    fn run(&mut self, stop: &dyn Fn() -> bool) -> bool {
        while let Some(crossing) = self.waiting.pop_front() {
            if stop() {
                return false;
            }
            let Some(lit) = self.lit.get_mut(&crossing) else { continue };
            lit.is_waiting = false;
            let (plane, gates) = (lit.outline.plane, lit.gates.beyond(lit.outline.hull.bounds));
            let beam = self.beam(crossing);
            self.go_on(crossing.1, plane, &beam, gates);
        }
        true
    }

    /// The half-spaces beyond the lit part of a portal.
    fn beam(&self, crossing: Crossing) -> Vec<HalfSpace> {
        let mut beam = Vec::new();
        beam.extend(self.partition.beyond(crossing.0, crossing.1));
        let Some(lit) = self.lit.get(&crossing) else { return beam };
        let (hull, errors) = (&lit.outline.hull, self.partition.errors());
        separators(&self.body, hull, errors, &mut beam);
        let Gates { last, narrowest } = lit.gates;
        for gate in last.into_iter().chain(narrowest.filter(|_| narrowest != last)) {
            separators(&Body::of_box(gate), hull, errors, &mut beam);
        }
        beam
    }

    /// Lights the portals of a leaf that lines can cross within some half-spaces. They have entered it
    /// through a portal in a plane, which they do not cross again.
    fn go_on(&mut self, leaf: LeafId, entered: Option<PlaneId>, beam: &[HalfSpace], gates: Gates) {
        let partition = self.partition;
        for portal in &partition.tree().leaf(leaf).portals {
            let Some(whole) = partition.opening(*portal) else { continue };
            let into = partition.tree().portal(*portal).beyond(leaf);
            if entered.is_some() && whole.plane == entered || partition.is_beyond(*portal, into, &self.body) {
                continue;
            }
            if let Some(part) = clip(whole, beam, partition.errors()) {
                self.light((*portal, into), part, gates, whole);
            }
        }
    }

    fn light(&mut self, crossing: Crossing, part: Outline, gates: Gates, whole: &Outline) {
        let errors = self.partition.errors();
        let Some(lit) = self.lit.get_mut(&crossing) else {
            self.lit.insert(
                crossing,
                Lit { outline: part.widened(errors), gates, growths: [0; 2], is_waiting: true },
            );
            self.order.push(crossing);
            self.waiting.push_back(crossing);
            return;
        };
        let mut grows = false;
        // The whole portal cannot grow.
        if lit.growths[0] < GROWTHS
            && let Some(joined) = lit.outline.joined(&part, errors)
        {
            lit.growths[0] += 1;
            lit.outline = if lit.growths[0] < GROWTHS { joined } else { whole.clone() };
            grows = true;
        }
        let gates = lit.gates.or(gates);
        if gates != lit.gates {
            lit.growths[1] += 1;
            lit.gates = if lit.growths[1] < GROWTHS { gates } else { Gates::NONE };
            grows = true;
        }
        if !grows {
            return;
        }
        if !std::mem::replace(&mut lit.is_waiting, true) {
            self.waiting.push_back(crossing);
        }
    }

    /// Marks the triangles with parts that are in the light.
    fn show(&self, is_seen: &mut [bool]) {
        for crossing in &self.order {
            let Some(lit) = self.lit.get(crossing) else { continue };
            let parts = self.partition.parts(crossing.1);
            if parts.iter().all(|part| is_seen[part.triangle as usize]) {
                continue;
            }
            let beam = self.beam(*crossing);
            // Nothing in the portal's plane is seen through it.
            let is_lit = |part: &Part| {
                let is_beside = part.outline.plane.is_some() && part.outline.plane == lit.outline.plane;
                !is_beside && clip(&part.outline, &beam, self.partition.errors()).is_some()
            };
            for part in parts {
                let is_seen = &mut is_seen[part.triangle as usize];
                *is_seen = *is_seen || is_lit(part);
            }
        }
    }
}

/// The part of a polygon within half-spaces.
fn clip(whole: &Outline, beam: &[HalfSpace], errors: Errors) -> Option<Outline> {
    let mut part: Option<Outline> = None;
    for half in beam {
        let at = part.as_ref().unwrap_or(whole);
        part = Some(at.part(half, errors)?);
    }
    Some(part.unwrap_or_else(|| whole.clone()))
}
