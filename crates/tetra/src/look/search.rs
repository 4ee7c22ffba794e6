//! The search: beams go through boxes or cells, nearest first, and are cut along the edges of the triangles
//! that they meet.
//!
//! A beam keeps the nearest triangle so far that covers all of it, its cap. A triangle that is met divides
//! the beam into the parts beside it, which go on as they are, and the part in it. That part is divided along
//! the line where the triangle's plane meets the cap's: where the triangle is nearer it becomes the cap. What
//! is behind the cap's plane, in the beam, is hidden, so a beam ends when nothing is left in front of its
//! cap. The order of the work decides how long it takes, never what comes out (Weiler and Atherton, "Hidden
//! Surface Removal Using Polygon Area Sorting", 1977, cut in the same way and sort first).

use crate::surfaces::{BLOCKS, SHOWS};

use super::areas::area;
use super::beam::{self, Edge, Place};
use super::eye::Eye;
use super::hierarchy::Node;
use super::planes::{Facing, Kind, Plane, Planes, Side};
use super::rounded::{Number, Rounded, U};
use super::scratch::Scratch;
use super::space::{Space, THROUGH_FACE};
use super::stack::{Beam, Entry};
use super::view::{Mode, Seen};
use super::within::Limits;

/// A part by which bounds on distances are moved: far more than their few roundings.
const BOUND: f64 = 1e-12;

/// What a search looks at.
pub(super) struct Scene<'a> {
    pub triangles: &'a [[u32; 3]],
    pub flags: &'a [u8],
    pub nodes: &'a [Node],
    pub order: &'a [u32],
    /// The cells, where they answer.
    pub space: Option<Space<'a>>,
}

/// One search.
pub(super) struct Search<'a> {
    pub scene: Scene<'a>,
    pub eye: Eye<'a>,
    pub mode: Mode,
    pub limits: Limits,
    /// Faces of target boxes, numbered after the triangles. They are caps from the start and are never met.
    pub faces: &'a [[u32; 3]],
    pub scratch: &'a mut Scratch,
    /// Solid angle in which the cap is a face.
    pub of_faces: f64,
    /// Solid angle that was begun with.
    pub begun: f64,
}

impl Search<'_> {
    /// Begins with all directions on the inner side of some planes, and with a cap or none.
    pub fn begin(&mut self, sides: &[Side], caps: &[u32]) {
        if let Some(space) = &self.scene.space {
            let Scratch { rings, hint, .. } = &mut *self.scratch;
            space.start(&self.eye, hint, &mut rings.start);
        }
        for signs in 0..8 {
            let Scratch { planes, stack, beam, rings, entered, .. } = &mut *self.scratch;
            beam::octant(planes, &self.eye, signs, &mut rings.inside);
            let missed = sides.iter().any(|side| {
                match beam::place(planes, &self.eye, &rings.inside, *side, &mut rings.signs) {
                    Place::Outside => return true,
                    Place::Inside => {}
                    Place::Both => {
                        let signs = &rings.signs;
                        beam::cut(
                            planes,
                            &self.eye,
                            &rings.inside,
                            *side,
                            signs,
                            &mut rings.next,
                            &mut rings.far,
                        );
                        std::mem::swap(&mut rings.inside, &mut rings.next);
                    }
                }
                false
            });
            if missed {
                continue;
            }
            beam.pending.clear();
            beam.met.clear();
            if self.scene.space.is_some() {
                beam.pending.extend_from_slice(&rings.start);
            } else if !self.scene.nodes.is_empty() {
                beam.pending.push(Entry { key: 0.0, first: 0, count: 0 });
            }
            self.begun += area(&rings.inside);
            stack.push(beam, &rings.inside, caps, false, (planes.list.len(), entered.len()));
        }
    }

    /// Ends all beams.
    pub fn run(&mut self) {
        let mut beam = std::mem::take(&mut self.scratch.beam);
        while let Some((planes, entered)) = self.scratch.stack.pop(&mut beam) {
            self.scratch.planes.list.truncate(planes);
            self.scratch.entered.truncate(entered);
            self.follow(&mut beam);
        }
        self.scratch.beam = beam;
    }

    /// Follows a beam until it ends or is divided.
    fn follow(&mut self, beam: &mut Beam) {
        let mut cap = beam.caps.first().and_then(|t| self.facing(*t));
        let mut reach = self.reach(beam, cap.as_ref());
        while let Some(entry) = beam.pending.pop() {
            if entry.key > reach {
                // All boxes that wait are at least as far away.
                break;
            }
            if matches!(entry.count, 0 | THROUGH_FACE) {
                match self.scene.space {
                    Some(_) => self.enter(beam, cap.as_ref(), &entry),
                    None => self.open(beam, cap.as_ref(), entry.first),
                }
                continue;
            }
            if entry.count > 1 {
                beam.pending.push(Entry { first: entry.first + 1, count: entry.count - 1, ..entry });
            }
            let triangle = match self.scene.space {
                Some(_) => entry.first,
                None => self.scene.order[entry.first as usize],
            };
            // The cells name a triangle once for each of its faces.
            if beam.caps.contains(&triangle) || beam.met.contains(&triangle) {
                continue;
            }
            let before = cap.map(|cap| cap.points);
            if self.meet(beam, &mut cap, triangle) {
                return;
            }
            if cap.map(|cap| cap.points) != before {
                reach = self.reach(beam, cap.as_ref());
            }
        }
        self.end(beam, cap.as_ref());
    }

    /// The square of how far away the cap is at most in a beam, with what rounding may add; infinite without
    /// a cap, and where cells answer, whose keys are no bounds.
    fn reach(&self, beam: &Beam, cap: Option<&Facing>) -> f64 {
        let Some(cap) = cap.filter(|_| self.scene.space.is_none()) else { return f64::INFINITY };
        // The part of the plane in the beam is convex, so a corner is its farthest place.
        beam.ring.iter().fold(0.0, |most: f64, edge| {
            let way = &edge.corner.way;
            let along = cap.normal.dot(way);
            let least = along.value - along.error;
            if least <= 0.0 {
                return f64::INFINITY;
            }
            let size = way.v.iter().fold(0.0, |sum, c| sum + (c.abs() + way.error) * (c.abs() + way.error));
            let times = (cap.height.value + cap.height.error) / least;
            most.max(times * times * size * (1.0 + BOUND))
        })
    }

    /// Goes into a box, if some of the beam does in front of its cap.
    fn open(&mut self, beam: &mut Beam, cap: Option<&Facing>, number: u32) {
        let node = &self.scene.nodes[number as usize];
        let x = self.eye.x;
        if beam::misses(&self.scratch.planes, &beam.ring, x, node.low, node.high)
            || cap.is_some_and(|cap| behind(cap, x, node))
            || self.limits.beyond(x, node.low, node.high)
        {
            return;
        }
        self.scratch.seen.cells += 1;
        let below = beam.pending.last().map_or(f64::INFINITY, |entry| entry.key);
        if node.count > 0 {
            beam.pending.push(Entry { key: below.min(near(node, x)), first: node.first, count: node.count });
            return;
        }
        let [a, b] = [node.first, node.first + 1].map(|n| (near(&self.scene.nodes[n as usize], x), n));
        let (first, second) = if b.0 < a.0 { (b, a) } else { (a, b) };
        let key = below.min(second.0);
        beam.pending.push(Entry { key, first: second.1, count: 0 });
        beam.pending.push(Entry { key: key.min(first.0), first: first.1, count: 0 });
    }

    /// Goes into a cell, if some of the beam does in front of its cap, and if no beam that this one is a part
    /// of has been there: what that found waits already.
    fn enter(&mut self, beam: &mut Beam, cap: Option<&Facing>, entry: &Entry) {
        let Some(space) = &self.scene.space else { return };
        let Scratch { planes, entered, seen, rings, .. } = &mut *self.scratch;
        let cell = space.cell_of(entry);
        if entered.holds(cell)
            || !space.is_reached(&self.eye, planes, (&beam.ring, cap), entry, &mut rings.ways)
        {
            return;
        }
        entered.add(cell);
        seen.cells += 1;
        let flags = self.scene.flags;
        let blocks = |t: u32| flags[t as usize] & BLOCKS != 0;
        let is_entered = |cell: u32| entered.holds(cell);
        let lists = (&mut beam.pending, &mut rings.ways);
        space.leave(&self.eye, planes, (&beam.ring, cap), cell, (blocks, is_entered), lists);
    }

    fn points(&self, triangle: u32) -> [u32; 3] {
        let t = triangle as usize;
        match self.scene.triangles.get(t) {
            Some(points) => *points,
            None => self.faces[t - self.scene.triangles.len()],
        }
    }

    fn facing(&self, triangle: u32) -> Option<Facing> {
        Facing::of(&self.eye, self.points(triangle))
    }

    fn flags(&self, triangle: u32) -> u8 {
        // Faces of targets block, and are in no set.
        self.scene.flags.get(triangle as usize).copied().unwrap_or(BLOCKS)
    }

    /// Meets a triangle. Says whether the beam was divided, and its parts are on the stack.
    fn meet(&mut self, beam: &mut Beam, cap: &mut Option<Facing>, triangle: u32) -> bool {
        let points = self.points(triangle);
        let eye = &self.eye;
        // In its plane: an edge of it is all that could be seen.
        let Some(facing) = Facing::of(eye, points) else { return false };
        let Scratch { planes, stack, rings, seen, entered, .. } = &mut *self.scratch;
        let ways = facing.points.map(|p| eye.to(p));
        let beside = |edge: &Edge| {
            let n = planes.normal(edge.side);
            ways.iter().all(|w| n.dot(w).sign() == Some(-1))
        };
        if beam.ring.iter().any(beside) {
            return false;
        }
        if let Some(cap) = cap {
            let beyond = |w: &Rounded| {
                let along = cap.normal.dot(w);
                let apart = Number {
                    value: along.value - cap.height.value,
                    error: along.error + cap.height.error + U * (along.value.abs() + cap.height.value.abs()),
                };
                apart.sign() == Some(1)
            };
            if ways.iter().all(beyond) {
                return false;
            }
        }
        let made = planes.list.len();
        let [a, b, c] = facing.points;
        let mut covered = true;
        let mut sides = [Side::new(0, false); 3];
        for (side, (a, b)) in sides.iter_mut().zip([(a, b), (b, c), (c, a)]) {
            *side = planes.add_edge(eye, a, b);
            match beam::place(planes, eye, &beam.ring, *side, &mut rings.signs) {
                Place::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                Place::Inside => {}
                Place::Both => covered = false,
            }
        }
        if self.scene.flags[triangle as usize] & BLOCKS == 0 {
            planes.list.truncate(made);
            beam.met.push(triangle);
            return false;
        }
        if beam.whole {
            planes.list.truncate(made);
            self.meet_whole(beam, cap, triangle, &facing, covered);
            return false;
        }
        // The part in the triangle, and the parts beside it.
        rings.inside.clear();
        rings.inside.extend_from_slice(&beam.ring);
        let mut parts = 0;
        for side in sides {
            match beam::place(planes, eye, &rings.inside, side, &mut rings.signs) {
                Place::Inside => {}
                Place::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                Place::Both => {
                    let out = &mut rings.out[parts];
                    beam::cut(planes, eye, &rings.inside, side, &rings.signs, &mut rings.next, out);
                    std::mem::swap(&mut rings.inside, &mut rings.next);
                    parts += 1;
                }
            }
        }
        let mut far = false;
        let mut level = false;
        if let Some(cap) = cap {
            let side = planes.add(meeting(cap, &facing));
            match beam::place(planes, eye, &rings.inside, side, &mut rings.signs) {
                Place::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                Place::Inside => level = rings.signs.iter().all(|s| *s == 0),
                Place::Both => {
                    let signs = &rings.signs;
                    beam::cut(planes, eye, &rings.inside, side, signs, &mut rings.next, &mut rings.far);
                    std::mem::swap(&mut rings.inside, &mut rings.next);
                    far = true;
                }
            }
        }
        if parts == 0 && !far {
            if level {
                beam.caps.push(triangle);
            } else {
                beam.caps.clear();
                beam.caps.push(triangle);
                *cap = Some(facing);
            }
            return false;
        }
        let made = (planes.list.len(), entered.len());
        if self.scene.space.is_none() {
            prune(self.scene.nodes, planes, self.eye.x, beam, cap.as_ref());
        }
        let keep = |ring: &[Edge], seen: &mut Seen| keep(self.mode, planes, ring, &self.limits, seen);
        for out in &rings.out[..parts] {
            if let Some(whole) = keep(out, seen) {
                stack.push(beam, out, &beam.caps, whole, made);
            }
        }
        if far && let Some(whole) = keep(&rings.far, seen) {
            stack.push(beam, &rings.far, &beam.caps, whole, made);
        }
        if let Some(whole) = keep(&rings.inside, seen) {
            if level {
                beam.caps.push(triangle);
            } else {
                beam.caps.clear();
                beam.caps.push(triangle);
            }
            stack.push(beam, &rings.inside, &beam.caps, whole, made);
        }
        true
    }

    /// A beam that is not cut meets a triangle that overlaps it.
    fn meet_whole(
        &mut self,
        beam: &mut Beam,
        cap: &mut Option<Facing>,
        triangle: u32,
        facing: &Facing,
        covered: bool,
    ) {
        let (place, level) = self.against(beam, cap.as_ref(), facing);
        match (covered, place) {
            (_, Place::Outside) => {}
            (true, Place::Inside) if level => beam.caps.push(triangle),
            (true, Place::Inside) => {
                beam.met.append(&mut beam.caps);
                beam.caps.push(triangle);
                *cap = Some(*facing);
            }
            _ => beam.met.push(triangle),
        }
    }

    /// Where a beam is on the nearer side of a face, seen from its cap, and whether both are in one plane.
    fn against(&mut self, beam: &Beam, cap: Option<&Facing>, facing: &Facing) -> (Place, bool) {
        let Some(cap) = cap else { return (Place::Inside, false) };
        let Scratch { planes, rings, .. } = &mut *self.scratch;
        let made = planes.list.len();
        let side = planes.add(meeting(cap, facing));
        let place = beam::place(planes, &self.eye, &beam.ring, side, &mut rings.signs);
        planes.list.truncate(made);
        (place, rings.signs.iter().all(|s| *s == 0))
    }

    /// Ends a beam: counts what is seen in it.
    fn end(&mut self, beam: &mut Beam, cap: Option<&Facing>) {
        self.scratch.seen.beams += 1;
        let (whole, near) = self.limits.areas(&beam.ring, cap);
        if beam.caps.iter().any(|t| *t as usize >= self.scene.triangles.len()) {
            self.of_faces += near;
            return;
        }
        let limited = self.limits.is_limited();
        if limited && whole <= 0.0 {
            return;
        }
        let mut undecided = false;
        for k in 0..beam.met.len() {
            let triangle = beam.met[k];
            undecided |= self.end_met(beam, cap, triangle) && self.flags(triangle) & BLOCKS != 0;
        }
        let Scratch { planes, tally, seen, .. } = &mut *self.scratch;
        let shows = |t: &&u32| self.scene.flags[**t as usize] & SHOWS != 0;
        if !limited || near > 0.0 {
            for t in beam.caps.iter().filter(shows) {
                tally.see(*t);
                if !undecided {
                    tally.witness(*t, near, || beam::middle(planes, &beam.ring));
                }
            }
        }
        let owner = beam.caps.iter().filter(shows).min();
        if undecided {
            seen.dropped += whole;
            return;
        }
        seen.sky += whole - near;
        match owner {
            Some(t) if near > 0.0 => {
                tally.see(*t);
                tally.add(*t, near);
            }
            Some(_) => {}
            None => seen.unseen += near,
        }
    }

    /// Whether a triangle that the beam met besides its cap is seen: its part of the beam in front of the
    /// cap.
    fn end_met(&mut self, beam: &Beam, cap: Option<&Facing>, triangle: u32) -> bool {
        let shows = self.flags(triangle) & SHOWS != 0;
        let Some(facing) = self.facing(triangle) else { return false };
        if beam.whole {
            let seen = self.against(beam, cap, &facing).0 != Place::Outside;
            if seen && shows {
                self.scratch.tally.see(triangle);
            }
            return seen;
        }
        let Scratch { planes, rings, tally, .. } = &mut *self.scratch;
        let made = planes.list.len();
        rings.inside.clear();
        rings.inside.extend_from_slice(&beam.ring);
        let [a, b, c] = facing.points;
        let mut seen = true;
        let edges = [Some((a, b)), Some((b, c)), Some((c, a)), None];
        for edge in edges {
            let side = match (edge, cap) {
                (Some((a, b)), _) => planes.add_edge(&self.eye, a, b),
                (None, Some(cap)) => planes.add(meeting(cap, &facing)),
                (None, None) => continue,
            };
            match beam::place(planes, &self.eye, &rings.inside, side, &mut rings.signs) {
                Place::Inside => {}
                Place::Outside => {
                    seen = false;
                    break;
                }
                Place::Both => {
                    let signs = &rings.signs;
                    beam::cut(planes, &self.eye, &rings.inside, side, signs, &mut rings.next, &mut rings.far);
                    std::mem::swap(&mut rings.inside, &mut rings.next);
                }
            }
        }
        if seen {
            let near = self.limits.areas(&rings.inside, Some(&facing)).1;
            seen = !self.limits.is_limited() || near > 0.0;
            if seen && shows {
                tally.see(triangle);
                tally.witness(triangle, near, || beam::middle(planes, &rings.inside));
            }
        }
        planes.list.truncate(made);
        seen
    }
}

/// The square of how far away a box is at least, but for a few roundings of one part in 2⁵³ each.
fn near(node: &Node, x: [f64; 3]) -> f64 {
    let sum = (0..3).fold(0.0, |sum, k| {
        let d = (f64::from(node.low[k]) - x[k]).max(x[k] - f64::from(node.high[k])).max(0.0);
        sum + d * d
    });
    sum * (1.0 - BOUND)
}

/// Leaves out the boxes that a beam does not go into, once for all of its parts, and brings the keys of the
/// others up to date.
fn prune(nodes: &[Node], planes: &Planes, x: [f64; 3], beam: &mut Beam, cap: Option<&Facing>) {
    let Beam { ring, pending, .. } = beam;
    let mut least = f64::INFINITY;
    pending.retain_mut(|entry| {
        if entry.count == 0 {
            let node = &nodes[entry.first as usize];
            if beam::misses(planes, ring, x, node.low, node.high)
                || cap.is_some_and(|cap| behind(cap, x, node))
            {
                return false;
            }
            least = least.min(near(node, x));
        } else {
            least = least.min(entry.key);
        }
        entry.key = least;
        true
    });
}

/// Whether a part of a beam is to be followed, and whether it is cut any further. What is dropped is counted.
fn keep(mode: Mode, planes: &Planes, ring: &[Edge], limits: &Limits, seen: &mut Seen) -> Option<bool> {
    match mode {
        Mode::Exact => Some(false),
        Mode::Aggressive(angle) => {
            if beam::widths(planes, ring).0 >= libm::sin(angle.min(std::f64::consts::FRAC_PI_2)) {
                return Some(false);
            }
            seen.dropped += limits.areas(ring, None).0;
            None
        }
        Mode::Conservative(angle) => {
            Some(beam::widths(planes, ring).1 < 2.0 * libm::sin(angle.min(std::f64::consts::PI) / 2.0))
        }
    }
}

/// The plane of the directions in which two faces are equally near.
fn meeting(cap: &Facing, facing: &Facing) -> Plane {
    let mut plane = cap.meet(facing);
    let same = |p: u32| cap.points.contains(&p);
    if facing.points.iter().all(|p| same(*p)) {
        // The same points: one plane, and no rounding is to hide it.
        plane = Plane { kind: Kind::Normal([0.0; 3]), normal: Rounded::default() };
    }
    plane
}

/// Whether all of a box is behind a face's plane for certain.
fn behind(cap: &Facing, x: [f64; 3], node: &Node) -> bool {
    let n = &cap.normal;
    let mut least = 0.0;
    let mut reach = 0.0f64;
    for (k, x) in x.into_iter().enumerate() {
        let (low, high) = (f64::from(node.low[k]) - x, f64::from(node.high[k]) - x);
        least += (n.v[k] * low).min(n.v[k] * high);
        reach = reach.max(low.abs()).max(high.abs());
    }
    let slack = reach * (3.0 * n.error + 16.0 * U * n.size()) + cap.height.error;
    least > cap.height.value + slack + 4.0 * U * cap.height.value
}
