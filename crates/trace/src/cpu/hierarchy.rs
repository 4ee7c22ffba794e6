//! The hierarchy of the cpu backend: nodes of eight children over leaves of up to eight triangles.
//!
//! The dynamic programme of Ylitie, Karras and Laine (2017, section 3.1) joins the binary tree of `bvh.rs` to
//! wide nodes. It minimises the sum over nodes and leaves of area times cost.
//! Hits do not depend on the hierarchy (`mod.rs`), as long as boxes contain their triangles.

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::Aabb;

use super::float_mode::FloatMode;
use crate::bvh::{BinaryNode, Bvh, MAX_DEPTH};

/// The number of children of a node, and of triangles of a leaf.
pub(super) const WIDTH: usize = 8;
/// The bit of a child that marks a leaf. The other bits are the number of the node or leaf.
pub(super) const LEAF: u32 = 1 << 31;
/// A child that does not exist.
pub(super) const NO_CHILD: u32 = 1 << 30;
/// The mark of a triangle that rays pass.
pub(super) const PASSED: u32 = 1 << 31;
/// The mark of a triangle that is met only where its vertices run counter-clockwise.
pub(super) const ONE_SIDED: u32 = 1 << 30;
/// The bits of a triangle's number. The other bits are its marks.
pub(super) const NUMBER: u32 = ONE_SIDED - 1;
/// The number of a lane without a triangle, and of a ray without a hit.
pub(super) const NO_TRIANGLE: u32 = u32::MAX;
/// A coordinate beyond every box: the low planes of empty slots. The high planes are at minus this.
pub(super) const BEYOND: f32 = 3e38;
/// The cost of a leaf and of a node, as the dynamic programme weighs them.
const LEAF_COST: f32 = 1.0;
const NODE_COST: f32 = 1.0;
/// The number of triangles below which a subtree is joined on one thread.
const PARALLEL: usize = 4096;

/// A node: the boxes of eight children.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// The planes by row, then child. Rows: low x, high x, low y, high y, low z, high z. Row 6 has the bits
    /// of
    /// the children ([`Self::child`]); row 7 is unused. All rows are `f32` so that a row is found without a
    /// test of its number.
    rows: [[f32; WIDTH]; 8],
}

/// A leaf: the vertices of up to eight triangles by corner, axis and triangle. Unused places are NaN, so no
/// ray meets them.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Leaf {
    pub(super) vertices: [[[f32; WIDTH]; 3]; 3],
    /// The number of each triangle with its marks, or [`NO_TRIANGLE`].
    pub(super) triangles: [u32; WIDTH],
}

impl Node {
    const EMPTY: Self = {
        let mut rows = [[0.0; WIDTH]; 8];
        let mut axis = 0;
        while axis < 3 {
            rows[2 * axis] = [BEYOND; WIDTH];
            rows[2 * axis + 1] = [-BEYOND; WIDTH];
            axis += 1;
        }
        rows[6] = [f32::from_bits(NO_CHILD); WIDTH];
        Self { rows }
    };

    /// Returns a row of planes.
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> &[f32; WIDTH] {
        &self.rows[row & 7]
    }

    /// Returns the child in a slot: a node, or a leaf with the mark [`LEAF`].
    #[inline(always)]
    pub(super) fn child(&self, slot: usize) -> u32 {
        self.rows[6][slot & 7].to_bits()
    }

    fn set(&mut self, slot: usize, bounds: &Aabb, child: u32) {
        for axis in 0..3 {
            self.rows[2 * axis][slot] = bounds.min[axis];
            self.rows[2 * axis + 1][slot] = bounds.max[axis];
        }
        self.rows[6][slot] = f32::from_bits(child);
    }
}

impl Leaf {
    const EMPTY: Self = Self {
        vertices: [[[f32::NAN; WIDTH]; 3]; 3],
        triangles: [NO_TRIANGLE; WIDTH],
    };
}

/// A triangle to add: its vertices, and its number with its marks.
#[derive(Clone, Copy, Debug)]
pub(super) struct InputTriangle {
    pub(super) vertices: [Vec3; 3],
    pub(super) number: u32,
}

/// The nodes and leaves. The root is node 0.
pub(super) struct WideHierarchy {
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: Vec<Leaf>,
    /// The units of the vertices.
    pub(super) units: Units,
}

/// The units of a scene's hierarchies: coordinates are translated and scaled without rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Units {
    /// The coordinates of the new origin, in world space.
    pub(super) origin: Vec3,
    /// Powers of two: the scale of the translated coordinates, of which the largest becomes 1/2 to 1, and its
    /// inverse.
    pub(super) scale: f32,
    pub(super) unscale: f32,
}

impl Units {
    /// Returns the units of a scene with these bounds.
    ///
    /// Along an axis on which the scene is far from the origin of world space, the origin moves to the near
    /// end of the scene. The difference between this end and any coordinate of up to twice its absolute value
    /// is exact (Sterbenz 1974), so the vertices of triangles do not move relative to each other.
    pub(super) fn of_scene(bounds: Aabb) -> Self {
        let mut origin = Vec3::ZERO;
        for axis in 0..3 {
            let (low, high) = (bounds.min[axis], bounds.max[axis]);
            if low > 0.0 && high <= 2.0 * low {
                origin[axis] = low;
            } else if high < 0.0 && low >= 2.0 * high {
                origin[axis] = high;
            }
        }
        let (low, high) = (bounds.min - origin, bounds.max - origin);
        let (scale, unscale) = scales(low.abs().max(high.abs()).max_element());
        Self {
            origin,
            scale,
            unscale,
        }
    }

    /// Converts a point from world space.
    #[inline(always)]
    pub(super) fn convert(&self, point: Vec3) -> Vec3 {
        (point - self.origin) * self.scale
    }
}

/// The cheapest forms of a subtree: by number of roots minus one, the cost and how it is attained.
#[derive(Clone, Copy)]
struct Forms {
    cost: [f32; WIDTH],
    form: [Form; WIDTH],
}

/// One form of a subtree.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    /// One leaf.
    Leaf,
    /// One node of eight children.
    Node,
    /// The form with one root fewer.
    Fewer,
    /// The roots of both children, of which the left child has this number.
    Split(u8),
}

impl WideHierarchy {
    /// Builds the hierarchy over triangles in a scene's units.
    ///
    /// # Errors
    /// A message if there are more triangles than a leaf can number.
    pub(super) fn build(triangles: &[InputTriangle], units: Units) -> Result<Self, String> {
        let boxes: Vec<Aabb> = triangles
            .par_iter()
            .map(|t| {
                let _mode = FloatMode::set();
                Aabb::around(t.vertices.map(|v| units.convert(v)))
            })
            .collect();
        let tree = Bvh::build(&boxes)?;
        drop(boxes);
        if tree.nodes.is_empty() {
            let nodes = vec![Node::EMPTY];
            return Ok(Self {
                nodes,
                leaves: Vec::new(),
                units,
            });
        }
        let mut forms = vec![
            Forms {
                cost: [0.0; WIDTH],
                form: [Form::Leaf; WIDTH]
            };
            tree.nodes.len()
        ];
        join(&tree.nodes, &mut forms);
        let _mode = FloatMode::set();
        let mut built = Emission {
            tree: &tree,
            forms: &forms,
            triangles,
            units,
            nodes: Vec::with_capacity(triangles.len() / 4 + 1),
            leaves: Vec::with_capacity(triangles.len() / 3 + 1),
        };
        built.emit();
        Ok(Self {
            nodes: built.nodes,
            leaves: built.leaves,
            units,
        })
    }
}

/// Returns powers of two: the scale that brings a coordinate to 1/2 to 1, and its inverse.
fn scales(reach: f32) -> (f32, f32) {
    let exponent = (reach.to_bits() >> 23).clamp(2, 252);
    (
        f32::from_bits((253 - exponent) << 23),
        f32::from_bits((exponent + 1) << 23),
    )
}

/// Computes the cheapest forms of all subtrees of a tree in preorder.
fn join(nodes: &[BinaryNode], forms: &mut [Forms]) {
    let node = &nodes[0];
    let area = node.half_area();
    if node.is_leaf() {
        forms[0] = Forms {
            cost: [area * LEAF_COST; WIDTH],
            form: [Form::Leaf; WIDTH],
        };
        for form in &mut forms[0].form[1..] {
            *form = Form::Fewer;
        }
        return;
    }
    let left = 2 * nodes[1].count as usize - 1;
    let (own, below) = forms.split_at_mut(1);
    let (left_forms, right_forms) = below.split_at_mut(left);
    let (left_nodes, right_nodes) = nodes[1..].split_at(left);
    if nodes.len() >= 2 * PARALLEL {
        rayon::join(
            || join(left_nodes, left_forms),
            || join(right_nodes, right_forms),
        );
    } else {
        join(left_nodes, left_forms);
        join(right_nodes, right_forms);
    }
    let (l, r) = (&left_forms[0], &right_forms[0]);
    let Forms { cost, form } = &mut own[0];
    // The cheapest division of k roots among the children. The left child has at most as many as triangles.
    let most = [left_nodes[0].count, right_nodes[0].count].map(|n| (n as usize).min(WIDTH));
    let mut divided = [(f32::INFINITY, 0u8); WIDTH + 1];
    let all = WIDTH.min(most[0] + most[1]);
    for (k, best) in divided.iter_mut().enumerate().take(all + 1).skip(2) {
        for q in k.saturating_sub(most[1]).max(1)..=most[0].min(k - 1) {
            let sum = l.cost[q - 1] + r.cost[k - q - 1];
            if sum < best.0 {
                *best = (sum, q as u8);
            }
        }
    }
    // A node may have fewer than eight children.
    let children = divided
        .iter()
        .fold(f32::INFINITY, |least, d| least.min(d.0));
    let as_leaf = if node.count as usize <= WIDTH {
        area * LEAF_COST
    } else {
        f32::INFINITY
    };
    let as_node = children + area * NODE_COST;
    (cost[0], form[0]) = if as_leaf <= as_node {
        (as_leaf, Form::Leaf)
    } else {
        (as_node, Form::Node)
    };
    for k in 2..=WIDTH {
        (cost[k - 1], form[k - 1]) = if divided[k].0 < cost[k - 2] {
            (divided[k].0, Form::Split(divided[k].1))
        } else {
            (cost[k - 2], Form::Fewer)
        };
    }
}

/// The state of the conversion from the binary tree to nodes and leaves.
struct Emission<'a> {
    tree: &'a Bvh,
    forms: &'a [Forms],
    triangles: &'a [InputTriangle],
    units: Units,
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
}

impl Emission<'_> {
    /// Writes all nodes, parents before their children and siblings close to each other.
    fn emit(&mut self) {
        self.nodes.push(Node::EMPTY);
        // (place in the binary tree, place of the wide node)
        let mut todo = vec![(0usize, 0usize)];
        while let Some((from, to)) = todo.pop() {
            let mut roots = [0usize; WIDTH];
            let mut count = 0;
            if self.tree.nodes[from].is_leaf() || self.forms[from].form[0] == Form::Leaf {
                // The whole hierarchy is one leaf below the root.
                roots[0] = from;
                count = 1;
            } else {
                self.children(from, &mut roots, &mut count);
            }
            let mut node = Node::EMPTY;
            for (slot, place) in roots.into_iter().take(count).enumerate() {
                let child = &self.tree.nodes[place];
                let number = if self.forms[place].form[0] == Form::Leaf {
                    LEAF | self.leaf(child)
                } else {
                    let number = self.nodes.len();
                    self.nodes.push(Node::EMPTY);
                    todo.push((place, number));
                    number as u32
                };
                node.set(slot, &child.bounds, number);
            }
            self.nodes[to] = node;
        }
    }

    /// Lists the roots of the two children of a node that becomes a wide node.
    fn children(&self, place: usize, roots: &mut [usize; WIDTH], count: &mut usize) {
        let (l, r) = (place + 1, self.tree.right(place));
        let (left, right) = (&self.forms[l], &self.forms[r]);
        let mut best = (f32::INFINITY, 1);
        for q in 1..WIDTH {
            let sum = left.cost[q - 1] + right.cost[WIDTH - q - 1];
            if sum < best.0 {
                best = (sum, q);
            }
        }
        self.roots(l, best.1, roots, count);
        self.roots(r, WIDTH - best.1, roots, count);
    }

    /// Lists the roots of a subtree in its cheapest form of at most `k` roots.
    fn roots(&self, place: usize, mut k: usize, roots: &mut [usize; WIDTH], count: &mut usize) {
        while self.forms[place].form[k - 1] == Form::Fewer {
            k -= 1;
        }
        match self.forms[place].form[k - 1] {
            Form::Split(left) => {
                let left = left as usize;
                self.roots(place + 1, left, roots, count);
                self.roots(self.tree.right(place), k - left, roots, count);
            }
            _ => {
                roots[*count] = place;
                *count += 1;
            }
        }
    }

    /// Writes a leaf and returns its number.
    fn leaf(&mut self, node: &BinaryNode) -> u32 {
        let mut leaf = Leaf::EMPTY;
        let places = node.first as usize..(node.first + node.count) as usize;
        for (lane, place) in places.enumerate() {
            let triangle = &self.triangles[self.tree.order[place] as usize];
            for (corner, v) in triangle.vertices.iter().enumerate() {
                let converted = self.units.convert(*v);
                for axis in 0..3 {
                    leaf.vertices[corner][axis][lane] = converted[axis];
                }
            }
            leaf.triangles[lane] = triangle.number;
        }
        self.leaves.push(leaf);
        self.leaves.len() as u32 - 1
    }
}

/// The largest number of nodes on a path from the root.
pub(super) const MAX_LEVELS: usize = MAX_DEPTH as usize;
