//! Everything visible from one view cell (thesis §6.2): what sampling has not shown is decided by queries, whole boxes
//! first.
//!
//! V(C) = I(C) ∪ V(∂C): what meets the cell is visible, everything else is seen through a face of the cell or not at all.
//! A box whose faces are all hidden from all faces of the cell hides everything in it. Boxes with something visible in
//! them are not asked about; the others are, from the root down, and only faces turned to each other.

use glam::{DVec3, Vec3};

use crate::bvh::Below;
use crate::frame::Source;
use crate::occluder::Occluders;
use crate::polygon::Polygon;
use crate::proof::Proof;
use crate::query::{Cost, Limits, Reason, Verdict, sightlines};

/// What is known of a triangle or box after a query.
#[derive(Clone, Debug)]
pub enum Found {
    /// Seen, along this segment from the cell.
    Visible(Box<[Source; 2]>),
    /// Hidden from each of these faces of the cell, with the proofs.
    Hidden(Vec<Proof>),
    /// Neither.
    Undecided(Reason),
}

/// What was decided about a cell.
#[derive(Debug, Default)]
pub struct Answer {
    /// Triangles that sampling had missed, each with its witness.
    pub seen: Vec<(u32, Box<[Source; 2]>)>,
    /// Triangles neither seen nor hidden, and why.
    pub undecided: Vec<(u32, Reason)>,
    /// Triangles proved hidden.
    pub hidden: u64,
    /// Boxes proved hidden.
    pub boxes: u64,
    /// Boxes and triangles asked about.
    pub queries: u64,
    /// What it took.
    pub cost: Cost,
}

impl Answer {
    fn join(mut self, other: Self) -> Self {
        self.seen.extend(other.seen);
        self.undecided.extend(other.undecided);
        self.hidden += other.hidden;
        self.boxes += other.boxes;
        self.queries += other.queries;
        self.cost += other.cost;
        self
    }
}

/// A view cell: a box in world space.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    min: Vec3,
    max: Vec3,
}

impl Cell {
    /// The box between two corners; none if it is empty or flat: a face without area is seen through by no open set of lines.
    pub fn new(min: Vec3, max: Vec3) -> Option<Self> {
        min.cmplt(max).all().then_some(Self { min, max })
    }
}

/// Decides every triangle with area that is not `known` to be visible. `known` must hold all that meet the cell.
pub fn solve(scene: &Occluders, cell: Cell, known: &[bool], limits: &Limits) -> Answer {
    let tree = scene.hierarchy();
    if tree.is_empty() {
        return Answer::default();
    }
    // Whether something below a node is visible; children come after their parents.
    let mut visible = vec![false; tree.len()];
    for node in (0..tree.len() as u32).rev() {
        visible[node as usize] = match tree.below(node) {
            Below::Nodes(children) => children.iter().any(|c| visible[*c as usize]),
            Below::Items(items) => items.iter().any(|t| known[*t as usize]),
        };
    }
    let work = Work { scene, cell, known, visible, limits };
    let mut answer = work.node(0);
    answer.seen.sort_by_key(|(t, _)| *t);
    answer.undecided.sort_by_key(|(t, _)| *t);
    answer
}

struct Work<'a> {
    scene: &'a Occluders,
    cell: Cell,
    known: &'a [bool],
    visible: Vec<bool>,
    limits: &'a Limits,
}

impl Work<'_> {
    fn node(&self, node: u32) -> Answer {
        let mut answer = Answer::default();
        let tree = self.scene.hierarchy();
        let [min, max] = tree.bounds(node);
        let touches = min.cmple(self.cell.max).all() && max.cmpge(self.cell.min).all();
        if !self.visible[node as usize] && !touches {
            answer.queries += 1;
            let faces = faces_towards(min, max, self.cell);
            let found = from_cell(self.scene, self.cell, &faces, self.limits, &mut answer.cost);
            if let Found::Hidden(_) = found {
                answer.hidden += self.count(node);
                answer.boxes += 1;
                return answer;
            }
        }
        let below = match tree.below(node) {
            Below::Nodes([a, b]) => {
                let (x, y) = rayon::join(|| self.node(a), || self.node(b));
                x.join(y)
            }
            Below::Items(items) => items
                .iter()
                .filter(|t| !self.known[**t as usize])
                .fold(Answer::default(), |all, t| all.join(self.triangle(*t))),
        };
        answer.join(below)
    }

    fn triangle(&self, id: u32) -> Answer {
        let mut answer = Answer { queries: 1, ..Answer::default() };
        let Some(target) = Polygon::triangle(self.scene.triangle(id).map(|v| v.as_dvec3())) else {
            return answer;
        };
        if behind_window(self.scene, self.cell, &target, self.limits, &mut answer.cost).is_some() {
            answer.hidden += 1;
            return answer;
        }
        match from_cell(self.scene, self.cell, &[target], self.limits, &mut answer.cost) {
            Found::Visible(ends) => answer.seen.push((id, ends)),
            Found::Hidden(_) => answer.hidden += 1,
            Found::Undecided(reason) => answer.undecided.push((id, reason)),
        }
        answer
    }

    fn count(&self, node: u32) -> u64 {
        match self.scene.hierarchy().below(node) {
            Below::Nodes([a, b]) => self.count(a) + self.count(b),
            Below::Items(items) => items.len() as u64,
        }
    }
}

/// Proves a target hidden by one query from a window: the part of the plane of one of the cell's faces that lines from anywhere
/// in the cell cross on their way to the target. It takes the place of up to three queries, from faces that are less. None says
/// nothing: a window shows more than the cell does.
pub fn behind_window(
    scene: &Occluders,
    cell: Cell,
    target: &Polygon,
    limits: &Limits,
    cost: &mut Cost,
) -> Option<Proof> {
    let corners = target.rounded();
    let least = corners.iter().fold(DVec3::INFINITY, |m, p| m.min(*p));
    let greatest = corners.iter().fold(DVec3::NEG_INFINITY, |m, p| m.max(*p));
    let (lo, hi) = ([cell.min.as_dvec3(), least], [cell.max.as_dvec3(), greatest]);
    // The axis along which the two are farthest apart.
    let gap = |k: usize| (lo[1][k] - hi[0][k]).max(lo[0][k] - hi[1][k]);
    let axis = (0..3).max_by(|a, b| gap(*a).total_cmp(&gap(*b))).unwrap_or(0);
    if gap(axis) <= 0.0 {
        return None;
    }
    let up = lo[1][axis] > hi[0][axis];
    let at = if up { hi[0][axis] } else { lo[0][axis] };
    let window = {
        let mut corners = [DVec3::splat(at); 2];
        for k in (0..3).filter(|k| *k != axis) {
            // Lines from x = c to x = n cross x = at in shares that depend on c and n alone; what is extreme there is among
            // the corners' shares.
            let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
            for c in [lo[0][axis], hi[0][axis]] {
                for n in [lo[1][axis], hi[1][axis]] {
                    let t = (at - c) / (n - c);
                    least = least.min(lo[0][k] + t * (lo[1][k] - lo[0][k]));
                    greatest = greatest.max(hi[0][k] + t * (hi[1][k] - hi[0][k]));
                }
            }
            // Rounded outwards by more than the few operations above can err.
            let slack =
                1e-12 * [lo[0][k], lo[1][k], hi[0][k], hi[1][k]].iter().fold(0.0f64, |m, x| m.max(x.abs()));
            (corners[0][k], corners[1][k]) = (least - slack, greatest + slack);
        }
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |s: usize, t: usize| {
            let mut p = DVec3::splat(at);
            (p[u], p[v]) = (corners[s][u], corners[t][v]);
            p
        };
        Polygon::rectangle([corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)])
    };
    let (verdict, took) = sightlines(scene, &[window], std::slice::from_ref(target), limits);
    *cost += took;
    match verdict {
        Verdict::Hidden(proof) => Some(proof),
        _ => None,
    }
}

/// Whether any of the targets, which do not meet the cell, is seen from it.
pub fn from_cell(
    scene: &Occluders,
    cell: Cell,
    targets: &[Polygon],
    limits: &Limits,
    cost: &mut Cost,
) -> Found {
    let mut proofs = Vec::new();
    let mut open = None;
    for (axis, up) in (0..6).map(|k| (k / 2, k % 2 == 1)) {
        let at = f64::from(if up { cell.max[axis] } else { cell.min[axis] });
        // Lines that leave through this face go to what is beyond it.
        let beyond: Vec<Polygon> = targets
            .iter()
            .filter(|t| t.rounded().iter().any(|p| if up { p[axis] > at } else { p[axis] < at }))
            .cloned()
            .collect();
        let face = face(cell.min, cell.max, axis, up);
        for target in beyond {
            let Some(outer) = outer_part(&target, &face, axis, up, at) else { continue };
            let (verdict, took) = sightlines(scene, std::slice::from_ref(&face), &[outer], limits);
            *cost += took;
            match verdict {
                Verdict::Visible(ends) => return Found::Visible(ends),
                Verdict::Hidden(proof) => proofs.push(proof),
                Verdict::Undecided(reason) => open = Some(reason),
            }
        }
    }
    match open {
        Some(reason) => Found::Undecided(reason),
        None => Found::Hidden(proofs),
    }
}

/// What of a polygon is on the outer side of a face of a box.
fn outer_part(target: &Polygon, face: &Polygon, axis: usize, up: bool, at: f64) -> Option<Polygon> {
    let inner = |p: &DVec3| if up { p[axis] < at } else { p[axis] > at };
    if !target.rounded().iter().any(inner) {
        return Some(target.clone());
    }
    let sides = face.sides(target);
    // The side of the face's plane the axis points to, or away from.
    let normal = face.plane();
    let along = crate::predicates::sign(&normal[axis]);
    let keep = if up { along } else { along.reverse() };
    target.part(&normal, &sides, keep)
}

/// One face of a box.
fn face(min: Vec3, max: Vec3, axis: usize, up: bool) -> Polygon {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let (lo, hi) = (min.as_dvec3(), max.as_dvec3());
    let corner = |s: bool, t: bool| {
        let mut p = lo;
        p[axis] = if up { hi[axis] } else { lo[axis] };
        p[u] = if s { hi[u] } else { lo[u] };
        p[v] = if t { hi[v] } else { lo[v] };
        p
    };
    Polygon::rectangle([corner(false, false), corner(true, false), corner(true, true), corner(false, true)])
}

/// The faces of a box that lines from the cell can enter by, without those that have no area. The two do not touch.
fn faces_towards(min: Vec3, max: Vec3, cell: Cell) -> Vec<Polygon> {
    let mut out = Vec::with_capacity(3);
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        if max[u] <= min[u] || max[v] <= min[v] {
            continue;
        }
        if cell.min[axis] < min[axis] {
            out.push(face(min, max, axis, false));
        }
        if cell.max[axis] > max[axis] {
            out.push(face(min, max, axis, true));
        }
    }
    out
}
