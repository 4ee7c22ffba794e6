//! The ray partition of a source (Apostu et al., sections 4.1 and 5.1): a binary tree of the Plücker hyperplanes of
//! edges, whose leaves are classes of rays that start in the source.
//!
//! A hyperplane belongs to the line through an edge a–b: on which side of it a ray from s through t passes is the sign
//! of ((a − s) × (b − s))·(t − s). The form is linear in s and in t, so its sign for all rays from one convex set to
//! another is that for the rays between their corners (theorem 1 and corollary, section 3.2). Where doubles cannot
//! tell, an item goes to both sides, which costs time and hides nothing wrongly (section 5.2, "conservative
//! insertion"). The tree grows where queries arrive.

use glam::DVec3;

use crate::items::{Face, From, Items, What};
use crate::polygon::Plane;
use crate::receivers::{Source, U};

/// A node of the tree.
#[derive(Clone, Debug)]
pub enum Node {
    /// A class that no query has asked for: the items that its rays may meet, the largest first.
    Undefined(Vec<u32>),
    /// The same, with the side of the first item's plane on which the ray starts.
    UndefinedFrom(Vec<u32>, bool),
    /// Rays that meet nothing.
    Free,
    /// Rays that all meet a face nearer than the distance.
    Hidden(u32),
    /// The hyperplane of the edge between two points; rays on its positive side go inside.
    Edge { a: u32, b: u32, inside: u32, outside: u32 },
    /// Rays by the side of a face's plane on which they start: on the negative, in it, on the positive.
    Start { face: u32, from: [u32; 3] },
    /// Rays that all meet a face, some of them perhaps beyond the distance; those that do go on.
    Near { face: u32, beyond: u32 },
}

/// On which side of a hyperplane the rays to an item pass.
enum Passes {
    Inside,
    Outside,
    Both,
}

/// A hyperplane, prepared for the corners of the source.
struct Hyperplane {
    /// For each corner of the source the plane through it and the line, and the bound of its error.
    planes: Vec<(DVec3, f64)>,
    /// Bound on what the source's slack can change, by the sum of two lengths.
    slack: f64,
    /// Largest distance of the source from the line's points.
    far: f64,
}

/// The tree.
pub struct Partition {
    nodes: Vec<Node>,
    /// The items of the root.
    root: Vec<u32>,
    /// Bytes of lists.
    lists: usize,
}

/// The sum of the absolute values.
fn l1(v: DVec3) -> f64 {
    v.x.abs() + v.y.abs() + v.z.abs()
}

/// The plane through a point `x` and the line from `a` to `b`. A difference is off by a rounding, and by the point's
/// own error; a product of two and the sum of three add three roundings, and m·v as many.
pub fn plane(a: DVec3, b: DVec3, x: DVec3) -> Plane {
    let (p, q) = (a - x, b - x);
    Plane { m: p.cross(q), error: 8.0 * U * l1(p) * l1(q) }
}

impl Hyperplane {
    fn new(source: &Source, a: DVec3, b: DVec3, far: f64) -> Self {
        let at = |s: &DVec3| {
            let Plane { m, error } = plane(a, b, *s);
            (m, 2.0 * error)
        };
        Self { planes: source.corners.iter().map(at).collect(), slack: source.slack * l1(b - a), far }
    }

    fn passes(&self, source: &Source, corners: &[DVec3], far: f64) -> Passes {
        let (mut inside, mut outside) = (true, true);
        let slack = self.slack * (far + self.far);
        for ((m, error), s) in self.planes.iter().zip(&source.corners) {
            let bound = error * far + slack;
            let from = m.dot(*s);
            for t in corners {
                let value = m.dot(*t) - from;
                inside &= value > bound;
                outside &= value < -bound;
            }
            if !inside && !outside {
                return Passes::Both;
            }
        }
        if inside { Passes::Inside } else { Passes::Outside }
    }
}

impl Partition {
    /// The tree of one undefined class.
    pub fn new(root: Vec<u32>) -> Self {
        let mut tree = Self { nodes: Vec::new(), root, lists: 0 };
        tree.clear();
        tree
    }

    /// Forgets all classes.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.lists = 0;
        let root = self.root.clone();
        self.leaf(root);
    }

    /// Bytes that the tree takes, about.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.lists
    }

    /// A node.
    pub fn node(&self, at: u32) -> &Node {
        &self.nodes[at as usize]
    }

    fn push(&mut self, node: Node) -> u32 {
        self.nodes.push(node);
        self.nodes.len() as u32 - 1
    }

    fn leaf(&mut self, list: Vec<u32>) -> u32 {
        if list.is_empty() {
            return self.push(Node::Free);
        }
        self.lists += list.capacity() * size_of::<u32>();
        self.push(Node::Undefined(list))
    }

    fn leaf_from(&mut self, list: Vec<u32>, front: bool) -> u32 {
        self.lists += list.capacity() * size_of::<u32>();
        self.push(Node::UndefinedFrom(list, front))
    }

    /// Defines an undefined class by the largest of its items that may hide something from a part of it. `false` when
    /// none may: that part is free, and the class stays undefined. `may` says whether an item may.
    pub fn grow(
        &mut self,
        at: u32,
        items: &mut Items<'_>,
        source: &Source,
        may: &mut dyn FnMut(&Items<'_>, u32) -> bool,
    ) -> bool {
        let (mut list, mut from) = match std::mem::replace(&mut self.nodes[at as usize], Node::Free) {
            Node::Undefined(list) => (list, None),
            Node::UndefinedFrom(list, front) => (list, Some(front)),
            other => {
                self.nodes[at as usize] = other;
                return true;
            }
        };
        self.lists -= list.capacity() * size_of::<u32>();
        let mut k = 0;
        let found = loop {
            let Some(id) = list.get(k).copied() else { break None };
            // The face of a class whose start is known goes first.
            if from.is_none() && !may(items, id) {
                k += 1;
                continue;
            }
            match items.item(id).what {
                What::Face(face) => break Some((id, face)),
                What::Box(_) => {
                    list.remove(k);
                    items.open(id, &mut list);
                }
            }
        };
        let Some((item, face)) = found else {
            self.lists += list.capacity() * size_of::<u32>();
            self.nodes[at as usize] = Node::Undefined(list);
            return false;
        };
        let whole = *items.face(face);
        let front = match (from.take(), whole.from) {
            (Some(front), _) | (None, From::Side(front)) => front,
            (None, From::Both) => {
                // The face first, then the others as they are.
                list[..=k].rotate_right(1);
                let behind = self.leaf_from(list.clone(), false);
                let ahead = self.leaf_from(list.clone(), true);
                list.remove(0);
                let held = self.leaf(list);
                self.nodes[at as usize] = Node::Start { face, from: [behind, held, ahead] };
                return true;
            }
        };
        list.remove(k);
        self.chain(at, items, source, (item, face, &whole, front), &list);
        true
    }

    /// Replaces a node by RP(S, T): a node for each edge of the face, which rays pass outside or inside.
    fn chain(
        &mut self,
        at: u32,
        items: &Items<'_>,
        source: &Source,
        (item, face, whole, front): (u32, u32, &Face, bool),
        rest: &[u32],
    ) {
        let (first, n, far) = (items.first(item), items.corners(item).len() as u32, items.item(item).far);
        // From the front the corners turn to the left as seen from the point, and so to the right from outside.
        let edge = |k: u32| {
            let (a, b) = (first + k, first + (k + 1) % n);
            if front { (b, a) } else { (a, b) }
        };
        let planes: Vec<Hyperplane> = (0..n)
            .map(|k| {
                let (a, b) = edge(k);
                Hyperplane::new(source, items.point(a), items.point(b), far)
            })
            .collect();
        let mut outside = vec![Vec::new(); n as usize];
        let mut inside = Vec::new();
        for id in rest {
            let (corners, far) = (items.corners(*id), items.item(*id).far);
            let mut passes_inside = true;
            for (plane, list) in planes.iter().zip(&mut outside) {
                match plane.passes(source, corners, far) {
                    Passes::Inside => {}
                    Passes::Both => list.push(*id),
                    Passes::Outside => {
                        list.push(*id);
                        passes_inside = false;
                        break;
                    }
                }
            }
            if passes_inside && !whole.within && !is_behind(whole, front, corners) {
                inside.push(*id);
            }
        }
        let last = if whole.within {
            self.push(Node::Hidden(face))
        } else {
            let beyond = self.leaf(inside);
            self.push(Node::Near { face, beyond })
        };
        let mut next = last;
        for (k, list) in outside.into_iter().enumerate().rev() {
            let (a, b) = edge(k as u32);
            let outside = self.leaf(list);
            let node = Node::Edge { a, b, inside: next, outside };
            if k == 0 {
                self.nodes[at as usize] = node;
            } else {
                next = self.push(node);
            }
        }
    }
}

/// Whether corners lie on or behind a face, for rays that start on the given side of it: what they hide, the face hides
/// from nearer by (`depthCulling`).
fn is_behind(face: &Face, front: bool, corners: &[DVec3]) -> bool {
    corners.iter().all(|c| {
        let d = *c - face.at;
        let value = face.normal.dot(d);
        let behind = if front { -value } else { value };
        behind >= -face.error * l1(d)
    })
}
