//! The ray partition of a source (Apostu et al., sections 4.1 and 5.1): a binary tree of the Plücker
//! hyperplanes of edges. Its leaves are classes of rays that start in the source.
//!
//! A hyperplane belongs to the line through an edge a–b. The sign of ((a − s) × (b − s))·(t − s) is the side
//! on which a ray from s through t passes. The form is linear in s and in t. So its sign for all rays between
//! two convex sets equals its sign for the rays between their corners (theorem 1 and corollary, section 3.2).
//! If doubles cannot decide a sign, the item goes to both sides, which costs time and does not affect the
//! result (section 5.2, "conservative insertion"). The tree divides a class when a query reaches the class.
//!
//! A tree is of one of two kinds. In a union, a class ends at any face that hides all rays of the class,
//! whether or not the face is the first hit, so triangles may cross each other. In a tree of first hits, a
//! class ends with the first face that its rays meet. Where planes cross, the line of intersection divides
//! the class (section 4.1 requires scenes that are prepared for that).

use std::rc::Rc;

use glam::DVec3;

use crate::hyperplane::{Hyperplane, PassingSide, l1};
use crate::items::{Face, ItemKind, Items, SourceSide};
use crate::receivers::ReceiverHull;

/// The property of rays that a tree determines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PartitionUse {
    /// The existence of a hit within the hiding range.
    Union,
    /// The first face that rays meet, at any distance.
    First,
}

/// A class of rays that the tree has not divided yet.
#[derive(Clone, Debug, Default)]
pub struct UndefinedClass {
    /// The numbers of the items that rays of the class may meet, the item with the largest solid angle first.
    list: Rc<Vec<u32>>,
    /// The filter that has not been applied to the list yet. The class shares the list with neighbouring
    /// classes.
    pending: Option<DeferredFace>,
    /// The side of the first item's plane on which the rays start, if known: true for the side that the
    /// normal points to. The first item is then a face.
    from: Option<bool>,
    /// The number of a face that all rays of the class meet, and the side of the face on which the rays
    /// start, if such a face is known.
    class: Option<(u32, bool)>,
}

/// A deferred filter of a class's list: a face, and the sides on which the rays of the class pass its edges.
///
/// The tree removes items that no ray of the class can meet when a query reaches the class, because no query
/// reaches most classes.
#[derive(Clone, Copy, Debug)]
struct DeferredFace {
    /// The number of the face's item.
    item: u32,
    /// True if the rays start on the side of the face's plane that the normal points to.
    front: bool,
    /// The number of edges of the face, counted from the first edge, that the rays pass on the inside.
    inside: u32,
    /// True if the rays pass the edge after these edges on the outside.
    outside: bool,
    /// The number of a face that hides all items behind the face, and the side of the face on which the rays
    /// start.
    before: Option<(u32, bool)>,
}

/// A node of the tree of a ray partition.
#[derive(Clone, Debug)]
pub enum PartitionNode {
    /// A class that the tree has not divided yet.
    Undefined(UndefinedClass),
    /// The class of rays that meet no face within the hiding range.
    Free,
    /// The class of rays that all meet the face with this number: within the hiding range in a union, as the
    /// first face in a tree of first hits.
    Met(u32),
    /// A division of rays by the hyperplane of an edge.
    Edge {
        /// The number of the edge's first point, for [`Items::point`].
        a: u32,
        /// The number of the edge's second point, for [`Items::point`].
        b: u32,
        /// The number of the node for rays on the positive side.
        inside: u32,
        /// The number of the node for all other rays.
        outside: u32,
    },
    /// A division of rays by the position of their origins.
    Start {
        /// The number of the face whose plane divides the origins.
        face: u32,
        /// The numbers of the nodes for rays that start on the negative side, in the plane, and on the
        /// positive side.
        from: [u32; 3],
    },
    /// The class of rays that all meet a face, some of them perhaps beyond the hiding range.
    Near {
        /// The number of the face.
        face: u32,
        /// The number of the node for rays that meet the face beyond the hiding range.
        beyond: u32,
    },
    /// The class of rays that all meet two faces whose planes may cross.
    Order {
        /// The numbers of the two faces.
        faces: [u32; 2],
        /// The numbers of the nodes for rays that meet `faces[0]` first, and for all other rays.
        first: [u32; 2],
    },
}

/// The binary tree of a ray partition.
pub struct Partition {
    tells: PartitionUse,
    nodes: Vec<PartitionNode>,
    /// The numbers of the items of the root class.
    root: Vec<u32>,
    /// The memory of the classes' lists, in bytes.
    lists: usize,
    /// The number of list entries that classes received since the tree was created.
    told: usize,
    /// The hyperplanes of the filter that is applied now, in reused memory.
    hyperplanes: Vec<Hyperplane>,
    /// The list of the class that is divided now, in reused memory.
    list: Vec<u32>,
}

impl Partition {
    /// Creates a tree of one undefined class, whose list contains the item numbers `root`.
    pub fn new(tells: PartitionUse, root: Vec<u32>) -> Self {
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

    /// Resets the tree to one undefined class.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.lists = 0;
        let list = Rc::new(self.root.clone());
        self.leaf(UndefinedClass {
            list,
            ..UndefinedClass::default()
        });
    }

    /// Returns the approximate memory of the tree, in bytes.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<PartitionNode>() + self.lists
    }

    /// Returns the number of list entries that classes received since the tree was created.
    pub fn told(&self) -> usize {
        self.told
    }

    /// Returns the node with the number `at`.
    pub fn node(&self, at: u32) -> &PartitionNode {
        &self.nodes[at as usize]
    }

    fn push(&mut self, node: PartitionNode) -> u32 {
        self.nodes.push(node);
        self.nodes.len() as u32 - 1
    }

    fn leaf(&mut self, leaf: UndefinedClass) -> u32 {
        let node = self.undefined(leaf);
        self.push(node)
    }

    fn undefined(&mut self, leaf: UndefinedClass) -> PartitionNode {
        match leaf {
            UndefinedClass {
                list, class: None, ..
            } if list.is_empty() => PartitionNode::Free,
            UndefinedClass {
                list,
                class: Some((face, _)),
                ..
            } if list.is_empty() => PartitionNode::Met(face),
            leaf => PartitionNode::Undefined(leaf),
        }
    }

    /// Writes the items of an undefined class to `list`, and applies the deferred filter.
    fn resolve(
        &mut self,
        leaf: &mut UndefinedClass,
        items: &Items<'_>,
        source: &ReceiverHull,
        list: &mut Vec<u32>,
    ) {
        list.clear();
        let all = std::mem::take(&mut leaf.list);
        let Some(pending) = leaf.pending.take() else {
            list.extend_from_slice(&all);
            return;
        };
        let edges = Edges::new(items, pending.item, pending.front);
        self.hyperplanes.clear();
        let count = pending.inside + u32::from(pending.outside);
        self.hyperplanes
            .extend((0..count).map(|k| edges.hyperplane(items, source, k)));
        let (inside, outside) = self.hyperplanes.split_at(pending.inside as usize);
        let belongs = |id: &u32| {
            let (hull, far) = (items.hull(*id), items.item(*id).far);
            inside
                .iter()
                .all(|p| !matches!(p.passes(hull, far), PassingSide::Outside))
                && outside
                    .iter()
                    .all(|p| !matches!(p.passes(hull, far), PassingSide::Inside))
                && pending
                    .before
                    .is_none_or(|(f, front)| !is_behind(items.face(f), front, items.corners(*id)))
        };
        list.extend(all.iter().copied().filter(belongs));
        self.lists += list.len() * size_of::<u32>();
        self.told += list.len();
    }

    /// Divides the undefined class at node `at`, for a part of the sphere of directions that a query moved to
    /// the class. The edges of one face divide the class: the largest face that may hide directions of the
    /// part.
    ///
    /// `may` returns true if an item may hide directions of the part. If `may` returns false for all items,
    /// the class stays undefined, and the part meets the class's face or is free.
    pub fn grow(
        &mut self,
        at: u32,
        items: &mut Items<'_>,
        source: &ReceiverHull,
        may: &mut dyn FnMut(&Items<'_>, u32) -> bool,
    ) -> ClassGrowth {
        let mut list = std::mem::take(&mut self.list);
        let grown = self.grow_with(at, items, source, may, &mut list);
        self.list = list;
        grown
    }

    fn grow_with(
        &mut self,
        at: u32,
        items: &mut Items<'_>,
        source: &ReceiverHull,
        may: &mut dyn FnMut(&Items<'_>, u32) -> bool,
        list: &mut Vec<u32>,
    ) -> ClassGrowth {
        let mut leaf = match std::mem::replace(&mut self.nodes[at as usize], PartitionNode::Free) {
            PartitionNode::Undefined(leaf) => leaf,
            other => {
                self.nodes[at as usize] = other;
                return ClassGrowth::Defined;
            }
        };
        self.resolve(&mut leaf, items, source, list);
        if list.is_empty() {
            self.nodes[at as usize] = self.undefined(leaf);
            return ClassGrowth::Defined;
        }
        let mut k = 0;
        let found = loop {
            let Some(id) = list.get(k).copied() else {
                break None;
            };
            // If the side on which the rays start is known, the first face needs no test.
            if leaf.from.is_none() && !may(items, id) {
                k += 1;
                continue;
            }
            match items.item(id).what {
                ItemKind::Face(face) => break Some((id, face)),
                ItemKind::Box(_) => {
                    list.remove(k);
                    items.open(id, list);
                }
            }
        };
        let Some((item, face)) = found else {
            let class = leaf.class.map(|(face, _)| face);
            leaf.list = Rc::new(list.clone());
            self.nodes[at as usize] = self.undefined(leaf);
            return ClassGrowth::Nothing(class);
        };
        let whole = *items.face(face);
        let front = match (leaf.from.take(), whole.from) {
            (Some(front), _) | (None, SourceSide::Side(front)) => front,
            (None, SourceSide::Both) => {
                // Move the face to the front, and preserve the order of the other items.
                list[..=k].rotate_right(1);
                leaf.list = Rc::new(list.clone());
                let side = |front| UndefinedClass {
                    from: Some(front),
                    ..leaf.clone()
                };
                let (behind, ahead) = (self.leaf(side(false)), self.leaf(side(true)));
                leaf.list = Rc::new(leaf.list[1..].to_vec());
                let held = self.leaf(leaf);
                self.nodes[at as usize] = PartitionNode::Start {
                    face,
                    from: [behind, held, ahead],
                };
                return ClassGrowth::Defined;
            }
        };
        list.remove(k);
        leaf.list = Rc::new(list.clone());
        self.chain(at, items, item, face, front, &leaf);
        ClassGrowth::Defined
    }

    /// Replaces node `at` by RP(S, T), the partition for the source S and the face T: one node for each edge
    /// of the face, for rays that pass the edge on the outside and on the inside.
    fn chain(
        &mut self,
        at: u32,
        items: &Items<'_>,
        item: u32,
        face: u32,
        front: bool,
        leaf: &UndefinedClass,
    ) {
        let edges = Edges::new(items, item, front);
        let pending = DeferredFace {
            item,
            front,
            inside: edges.count,
            outside: false,
            before: None,
        };
        let mut next = self.inner(items, pending, face, leaf);
        for k in (0..edges.count).rev() {
            let (a, b) = edges.edge(k);
            let pending = DeferredFace {
                inside: k,
                outside: true,
                ..pending
            };
            let outside = self.leaf(UndefinedClass {
                pending: Some(pending),
                from: None,
                ..leaf.clone()
            });
            let node = PartitionNode::Edge {
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

    /// Adds the class of the rays of `leaf` that all meet a face, and returns the number of its node. If
    /// `leaf` already has a face, all of these rays meet that face, too.
    fn inner(
        &mut self,
        items: &Items<'_>,
        pending: DeferredFace,
        face: u32,
        leaf: &UndefinedClass,
    ) -> u32 {
        let (whole, front) = (items.face(face), pending.front);
        // The filter removes items that a nearer face hides, without a test of edges (`depthCulling`).
        let undefined_before = |face: (u32, bool), class| UndefinedClass {
            list: Rc::clone(&leaf.list),
            pending: Some(DeferredFace {
                before: Some(face),
                ..pending
            }),
            from: None,
            class,
        };
        if self.tells == PartitionUse::Union {
            return if whole.within {
                self.push(PartitionNode::Met(face))
            } else {
                let beyond = self.leaf(undefined_before((face, front), None));
                self.push(PartitionNode::Near { face, beyond })
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
        self.push(PartitionNode::Order {
            faces: [face, other.0],
            first: [one, two],
        })
    }
}

/// The edges of a face, counter-clockwise as seen from outside the sphere of directions.
struct Edges {
    first: u32,
    count: u32,
    front: bool,
    far: f64,
}

impl Edges {
    fn new(items: &Items<'_>, item: u32, front: bool) -> Self {
        let (first, count) = (items.first(item), items.corners(item).len() as u32);
        Self {
            first,
            count,
            front,
            far: items.item(item).far,
        }
    }

    /// Returns the numbers of the points of edge `k`. Seen from a point in front of the face, the corners are
    /// counter-clockwise, and so clockwise as seen from outside the sphere.
    fn edge(&self, k: u32) -> (u32, u32) {
        let (a, b) = (self.first + k, self.first + (k + 1) % self.count);
        if self.front { (b, a) } else { (a, b) }
    }

    fn hyperplane(&self, items: &Items<'_>, source: &ReceiverHull, k: u32) -> Hyperplane {
        let (a, b) = self.edge(k);
        Hyperplane::new(source, items.point(a), items.point(b), self.far)
    }
}

/// The result of [`Partition::grow`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClassGrowth {
    /// The node of the class was replaced, so the part descends further.
    Defined,
    /// No item may hide directions of the part. The part meets the face with this number, or is free if the
    /// class has no face.
    Nothing(Option<u32>),
}

/// Returns true if all corners lie in or behind the plane of a face, for rays that start on the side
/// `front`. The nearer face then hides all directions that the polygon of these corners hides
/// (`depthCulling`).
fn is_behind(face: &Face, front: bool, corners: &[DVec3]) -> bool {
    corners.iter().all(|c| {
        let d = *c - face.at;
        let value = face.normal.dot(d);
        let behind = if front { -value } else { value };
        behind >= -face.error * l1(d)
    })
}
