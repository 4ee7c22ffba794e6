//! The ray partition of a source (Apostu et al., sections 4.1 and 5.1): a binary tree of the Plücker
//! hyperplanes of edges, whose leaves are classes of rays that start in the source.
//!
//! A hyperplane belongs to the line through an edge a–b: on which side of it a ray from s through t passes is
//! the sign of ((a − s) × (b − s))·(t − s). The form is linear in s and in t, so its sign for all rays from
//! one convex set to another is that for the rays between their corners (theorem 1 and corollary, section
//! 3.2). Where doubles cannot tell, an item goes to both sides, which costs time and hides nothing wrongly
//! (section 5.2, "conservative insertion"). The tree grows where queries arrive.
//!
//! There are two kinds of trees. In a union a class ends at any face that hides all of its rays: no matter
//! which one is first, so triangles may cross each other. In a tree of first hits a class has the first face
//! that its rays meet, and where planes cross, a class is divided by the line in which they do (section 4.1
//! wants such scenes prepared).

use std::rc::Rc;

use glam::DVec3;

use crate::hyperplane::{Hyperplane, Passes, l1};
use crate::items::{Face, From, Items, What};
use crate::receivers::Source;

/// What a tree tells of its rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tells {
    /// Whether they meet anything within reach.
    Union,
    /// Which face they meet first, at whatever distance.
    First,
}

/// A class that no query has asked for.
#[derive(Clone, Debug, Default)]
pub struct Undefined {
    /// The items that its rays may meet, the largest first.
    list: Rc<Vec<u32>>,
    /// What has yet to be left out of the list, which it shares with its neighbours.
    pending: Option<Pending>,
    /// For the first item, a face, the side of its plane on which the rays start.
    from: Option<bool>,
    /// The face that all its rays meet, with the side on which they start, if any is known.
    class: Option<(u32, bool)>,
}

/// Where the rays of a class pass a face: items that none of them can meet are left out when a query arrives,
/// for to most classes none does.
#[derive(Clone, Copy, Debug)]
struct Pending {
    /// The face's item, and the side of its plane on which the rays start.
    item: u32,
    front: bool,
    /// They pass inside of so many of its edges.
    inside: u32,
    /// And outside of the next one.
    outside: bool,
    /// What lies behind this face counts no more, for rays that start on the given side of it.
    before: Option<(u32, bool)>,
}

/// A node of the tree.
#[derive(Clone, Debug)]
pub enum Node {
    /// A class that no query has asked for.
    Undefined(Undefined),
    /// Rays that meet nothing.
    Free,
    /// Rays that all meet this face: within reach, or first.
    Met(u32),
    /// The hyperplane of an edge.
    Edge {
        /// The edge's first point.
        a: u32,
        /// Its second point.
        b: u32,
        /// Where rays on the positive side go.
        inside: u32,
        /// Where the others go.
        outside: u32,
    },
    /// Rays by where they start.
    Start {
        /// The face in whose plane or on whose side that is.
        face: u32,
        /// Where rays go that start on the negative side, in the plane, and on the positive side.
        from: [u32; 3],
    },
    /// Rays that all meet a face, some of them perhaps beyond reach.
    Near {
        /// The face.
        face: u32,
        /// Where those go on.
        beyond: u32,
    },
    /// Rays that all meet two faces whose planes may cross.
    Order {
        /// The faces.
        faces: [u32; 2],
        /// Where rays go that meet the first one first, and the others.
        first: [u32; 2],
    },
}

/// The tree.
pub struct Partition {
    tells: Tells,
    nodes: Vec<Node>,
    /// The items of the root.
    root: Vec<u32>,
    /// Bytes of lists.
    lists: usize,
    /// Items that classes were told of, ever.
    told: usize,
    /// Hyperplanes of the class that is resolved, in memory that is used again.
    hyperplanes: Vec<Hyperplane>,
    /// The list of the class that is grown, likewise.
    list: Vec<u32>,
}

impl Partition {
    /// The tree of one undefined class.
    pub fn new(tells: Tells, root: Vec<u32>) -> Self {
        let mut tree = Self {
            tells,
            nodes: Vec::new(),
            root,
            lists: 0,
            told: 0,
            hyperplanes: Vec::new(),
            list: Vec::new(),
        };
        tree.clear();
        tree
    }

    /// Forgets all classes.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.lists = 0;
        let list = Rc::new(self.root.clone());
        self.leaf(Undefined {
            list,
            ..Undefined::default()
        });
    }

    /// Bytes that the tree takes, about.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.lists
    }

    /// Items that classes were told of since the tree is there.
    pub fn told(&self) -> usize {
        self.told
    }

    /// A node.
    pub fn node(&self, at: u32) -> &Node {
        &self.nodes[at as usize]
    }

    fn push(&mut self, node: Node) -> u32 {
        self.nodes.push(node);
        self.nodes.len() as u32 - 1
    }

    fn leaf(&mut self, leaf: Undefined) -> u32 {
        let node = self.undefined(leaf);
        self.push(node)
    }

    fn undefined(&mut self, leaf: Undefined) -> Node {
        match leaf {
            Undefined {
                list, class: None, ..
            } if list.is_empty() => Node::Free,
            Undefined {
                list,
                class: Some((face, _)),
                ..
            } if list.is_empty() => Node::Met(face),
            leaf => Node::Undefined(leaf),
        }
    }

    /// Puts the items of an undefined class into a list.
    fn resolve(
        &mut self,
        leaf: &mut Undefined,
        items: &Items<'_>,
        source: &Source,
        list: &mut Vec<u32>,
    ) {
        list.clear();
        let all = std::mem::take(&mut leaf.list);
        let Some(pending) = leaf.pending.take() else {
            list.extend_from_slice(&all);
            return;
        };
        let edges = Edges::of(items, pending.item, pending.front);
        self.hyperplanes.clear();
        let count = pending.inside + u32::from(pending.outside);
        self.hyperplanes
            .extend((0..count).map(|k| edges.hyperplane(items, source, k)));
        let (inside, outside) = self.hyperplanes.split_at(pending.inside as usize);
        let belongs = |id: &u32| {
            let (hull, far) = (items.hull(*id), items.item(*id).far);
            inside
                .iter()
                .all(|p| !matches!(p.passes(hull, far), Passes::Outside))
                && outside
                    .iter()
                    .all(|p| !matches!(p.passes(hull, far), Passes::Inside))
                && pending
                    .before
                    .is_none_or(|(f, front)| !is_behind(items.face(f), front, items.corners(*id)))
        };
        list.extend(all.iter().copied().filter(belongs));
        self.lists += list.len() * size_of::<u32>();
        self.told += list.len();
    }

    /// Defines an undefined class by the largest of its items that may hide something from a part of it.
    /// `None` when none may: then the class stays undefined, and the part is that of the class's face, or
    /// free. `may` says whether an item may.
    pub fn grow(
        &mut self,
        at: u32,
        items: &mut Items<'_>,
        source: &Source,
        may: &mut dyn FnMut(&Items<'_>, u32) -> bool,
    ) -> Grown {
        let mut list = std::mem::take(&mut self.list);
        let grown = self.grow_with(at, items, source, may, &mut list);
        self.list = list;
        grown
    }

    fn grow_with(
        &mut self,
        at: u32,
        items: &mut Items<'_>,
        source: &Source,
        may: &mut dyn FnMut(&Items<'_>, u32) -> bool,
        list: &mut Vec<u32>,
    ) -> Grown {
        let mut leaf = match std::mem::replace(&mut self.nodes[at as usize], Node::Free) {
            Node::Undefined(leaf) => leaf,
            other => {
                self.nodes[at as usize] = other;
                return Grown::Defined;
            }
        };
        self.resolve(&mut leaf, items, source, list);
        if list.is_empty() {
            self.nodes[at as usize] = self.undefined(leaf);
            return Grown::Defined;
        }
        let mut k = 0;
        let found = loop {
            let Some(id) = list.get(k).copied() else {
                break None;
            };
            // The face of a class whose start is known goes first.
            if leaf.from.is_none() && !may(items, id) {
                k += 1;
                continue;
            }
            match items.item(id).what {
                What::Face(face) => break Some((id, face)),
                What::Box(_) => {
                    list.remove(k);
                    items.open(id, list);
                }
            }
        };
        let Some((item, face)) = found else {
            let class = leaf.class.map(|(face, _)| face);
            leaf.list = Rc::new(list.clone());
            self.nodes[at as usize] = self.undefined(leaf);
            return Grown::Nothing(class);
        };
        let whole = *items.face(face);
        let front = match (leaf.from.take(), whole.from) {
            (Some(front), _) | (None, From::Side(front)) => front,
            (None, From::Both) => {
                // The face first, then the others as they are.
                list[..=k].rotate_right(1);
                leaf.list = Rc::new(list.clone());
                let side = |front| Undefined {
                    from: Some(front),
                    ..leaf.clone()
                };
                let (behind, ahead) = (self.leaf(side(false)), self.leaf(side(true)));
                leaf.list = Rc::new(leaf.list[1..].to_vec());
                let held = self.leaf(leaf);
                self.nodes[at as usize] = Node::Start {
                    face,
                    from: [behind, held, ahead],
                };
                return Grown::Defined;
            }
        };
        list.remove(k);
        leaf.list = Rc::new(list.clone());
        self.chain(at, items, (item, face, front), &leaf);
        Grown::Defined
    }

    /// Replaces a node by RP(S, T): a node for each edge of the face, which rays pass outside or inside.
    fn chain(
        &mut self,
        at: u32,
        items: &Items<'_>,
        (item, face, front): (u32, u32, bool),
        leaf: &Undefined,
    ) {
        let edges = Edges::of(items, item, front);
        let pending = Pending {
            item,
            front,
            inside: edges.count,
            outside: false,
            before: None,
        };
        let mut next = self.inner(items, (pending, face), leaf);
        for k in (0..edges.count).rev() {
            let (a, b) = edges.edge(k);
            let pending = Pending {
                inside: k,
                outside: true,
                ..pending
            };
            let outside = self.leaf(Undefined {
                pending: Some(pending),
                from: None,
                ..leaf.clone()
            });
            let node = Node::Edge {
                a,
                b,
                inside: next,
                outside,
            };
            if k == 0 {
                self.nodes[at as usize] = node;
            } else {
                next = self.push(node);
            }
        }
    }

    /// The class of the rays that all meet a face, and those of another class already if it has one.
    fn inner(
        &mut self,
        items: &Items<'_>,
        (pending, face): (Pending, u32),
        leaf: &Undefined,
    ) -> u32 {
        let (whole, front) = (items.face(face), pending.front);
        // What a face hides from nearer by needs no look (`depthCulling`).
        let undefined_before = |face: (u32, bool), class| Undefined {
            list: Rc::clone(&leaf.list),
            pending: Some(Pending {
                before: Some(face),
                ..pending
            }),
            from: None,
            class,
        };
        if self.tells == Tells::Union {
            return if whole.within {
                self.push(Node::Met(face))
            } else {
                let beyond = self.leaf(undefined_before((face, front), None));
                self.push(Node::Near { face, beyond })
            };
        }
        let this = (face, front);
        let Some(other) = leaf.class else {
            return self.leaf(undefined_before(this, Some(this)));
        };
        if is_behind(whole, front, items.corners(items.face(other.0).item)) {
            return self.leaf(undefined_before(this, Some(this)));
        }
        if is_behind(items.face(other.0), other.1, items.corners(pending.item)) {
            return self.leaf(undefined_before(other, Some(other)));
        }
        let (one, two) = (
            self.leaf(undefined_before(this, Some(this))),
            self.leaf(undefined_before(other, Some(other))),
        );
        self.push(Node::Order {
            faces: [face, other.0],
            first: [one, two],
        })
    }
}

/// The edges of a face in the order in which they turn to the left as seen from outside of the sphere of
/// directions.
struct Edges {
    first: u32,
    count: u32,
    front: bool,
    far: f64,
}

impl Edges {
    fn of(items: &Items<'_>, item: u32, front: bool) -> Self {
        let (first, count) = (items.first(item), items.corners(item).len() as u32);
        Self {
            first,
            count,
            front,
            far: items.item(item).far,
        }
    }

    /// The points of an edge. From the front the corners turn to the left as seen from the point, and so to
    /// the right from outside.
    fn edge(&self, k: u32) -> (u32, u32) {
        let (a, b) = (self.first + k, self.first + (k + 1) % self.count);
        if self.front { (b, a) } else { (a, b) }
    }

    fn hyperplane(&self, items: &Items<'_>, source: &Source, k: u32) -> Hyperplane {
        let (a, b) = self.edge(k);
        Hyperplane::new(source, items.point(a), items.point(b), self.far)
    }
}

/// What came of a query's wish to know more of a class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grown {
    /// The node is another one now.
    Defined,
    /// Nothing more may hide the part: it is that of this face, or free.
    Nothing(Option<u32>),
}

/// Whether corners lie on or behind a face, for rays that start on the given side of it: what they hide, the
/// face hides from nearer by (`depthCulling`).
fn is_behind(face: &Face, front: bool, corners: &[DVec3]) -> bool {
    corners.iter().all(|c| {
        let d = *c - face.at;
        let value = face.normal.dot(d);
        let behind = if front { -value } else { value };
        behind >= -face.error * l1(d)
    })
}
