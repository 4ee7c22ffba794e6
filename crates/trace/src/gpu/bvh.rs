//! The bounding volume hierarchy of the line tracer: a binary tree, built on the CPU with the binned surface
//! area heuristic.
//!
//! This file knows nothing of devices, rays or units. No triangle is split, and a built tree never changes.
//! The same triangles give the same nodes on every machine and with every number of threads: subtrees are
//! built in parallel, but the split alone decides the place of each subtree.
//!
//! **Depth.** A node of n triangles at depth d is split by the heuristic only while
//! d + 1 + [`levels`]\(n − 1) is at most [`MAX_DEPTH`]. Otherwise it is split at the median, which reduces
//! [`levels`] by one. So d + levels(n) never exceeds [`MAX_DEPTH`], and a traversal that descends into one
//! child and pushes the other never has more than [`MAX_DEPTH`] entries on its stack. [`Bvh::build`] measures
//! the depth nevertheless and refuses a deeper tree.
//!
//! The crate exact has a builder of its own, because nearly every rule differs: the axes tried, the precision
//! of costs, leaves, depth, uneven splits and the layout of nodes.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::Aabb;

/// Greatest depth of a leaf, where the root has depth 0; the number of entries of the shader's stack.
pub(super) const MAX_DEPTH: u32 = 40;
/// Most triangles in a leaf.
const MAX_LEAF: usize = 4;
/// Low bits of [`Node::child`] that hold a leaf's number of triangles.
const COUNT_BITS: u32 = 4;
/// Node and triangle indices must fit in the other bits.
const MOST: usize = 1 << (32 - COUNT_BITS);
/// Bins along each axis.
const BINS: usize = 16;
/// Cost of testing two boxes, in triangle tests.
const STEP_COST: f32 = 1.0;
/// A subtree of fewer triangles is built on one thread.
const PARALLEL: usize = 8192;

/// A node in the layout that `traverse.wgsl` reads. Siblings are adjacent, the left one at an even index.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Node {
    pub(super) low: Vec3,
    /// Inner node: the index of the left child in the upper 28 bits, 0 in the lower 4. Leaf: the place of its
    /// first triangle in the upper 28 bits, the number of its triangles in the lower 4.
    pub(super) child: u32,
    pub(super) high: Vec3,
    unused: u32,
}

/// A built hierarchy.
#[derive(Debug)]
pub(super) struct Bvh {
    /// The root, an unused node, then pairs of siblings. Empty when there are no boxes.
    pub(super) nodes: Vec<Node>,
    /// For each place in the leaves' order, the index of its box in the input.
    pub(super) order: Vec<u32>,
}

/// An input box and its index.
#[derive(Clone, Copy)]
struct Item {
    bounds: Aabb,
    id: u32,
}

impl Item {
    fn centre(&self) -> Vec3 {
        // Both terms are halved first, so the sum cannot overflow.
        self.bounds.min * 0.5 + self.bounds.max * 0.5
    }
}

/// A node in preorder: its left child follows it, its right child lies `right` places after it. A leaf has
/// `right` 0.
#[derive(Clone, Copy)]
struct Flat {
    bounds: Aabb,
    right: u32,
    first: u32,
    count: u32,
}

/// A split: items whose bin on `axis` is less than `bin` go to the left child.
struct Split {
    axis: usize,
    bin: usize,
    cost: f32,
}

/// Levels that n triangles need when every node is split at the median, until each leaf is small enough.
fn levels(n: usize) -> u32 {
    n.div_ceil(MAX_LEAF)
        .max(1)
        .next_power_of_two()
        .trailing_zeros()
}

impl Bvh {
    /// Builds the hierarchy over `boxes`, none of which is empty.
    ///
    /// # Errors
    /// A message, when there are more boxes than the nodes can number.
    pub(super) fn build(boxes: &[Aabb]) -> Result<Self, String> {
        // A binary tree has fewer than two nodes for each leaf, plus the unused node.
        if boxes.len() >= MOST / 2 {
            return Err(format!(
                "{} triangles are more than the {} a line tracer's hierarchy can number",
                boxes.len(),
                MOST / 2 - 1
            ));
        }
        if boxes.is_empty() {
            return Ok(Self {
                nodes: Vec::new(),
                order: Vec::new(),
            });
        }
        let mut items: Vec<Item> = boxes
            .iter()
            .zip(0..)
            .map(|(b, id)| Item { bounds: *b, id })
            .collect();
        let flat = subtree(&mut items, 0, 0);
        let (nodes, depth) = paired(&flat);
        if depth > MAX_DEPTH {
            return Err(format!(
                "the hierarchy became {depth} levels deep; {MAX_DEPTH} were expected"
            ));
        }
        Ok(Self {
            nodes,
            order: items.iter().map(|i| i.id).collect(),
        })
    }
}

/// The tree over `items` in preorder. The leaves' order begins at place `first`.
fn subtree(items: &mut [Item], first: usize, depth: u32) -> Vec<Flat> {
    let bounds = items.iter().fold(Aabb::EMPTY, |b, i| b.union(i.bounds));
    let leaf = Flat {
        bounds,
        right: 0,
        first: first as u32,
        count: items.len() as u32,
    };
    if items.len() == 1 {
        return vec![leaf];
    }
    let free = depth + 1 + levels(items.len() - 1) <= MAX_DEPTH;
    let centres = items.iter().fold(Aabb::EMPTY, |b, i| {
        let c = i.centre();
        b.union(Aabb { min: c, max: c })
    });
    let split = if free {
        best_split(items, &centres)
    } else {
        None
    };
    if items.len() <= MAX_LEAF {
        let whole = items.len() as f32 * half_area(&bounds);
        if split
            .as_ref()
            .is_none_or(|s| s.cost + STEP_COST * half_area(&bounds) >= whole)
        {
            return vec![leaf];
        }
    }
    let middle = match split {
        Some(s) => partition(items, |i| bin_of(i.centre(), &centres, s.axis) < s.bin),
        None => halve(items, &centres),
    };
    let (left, right) = items.split_at_mut(middle);
    let (left, right) = if left.len() + right.len() >= PARALLEL {
        rayon::join(
            || subtree(left, first, depth + 1),
            || subtree(right, first + middle, depth + 1),
        )
    } else {
        (
            subtree(left, first, depth + 1),
            subtree(right, first + middle, depth + 1),
        )
    };
    let mut all = Vec::with_capacity(1 + left.len() + right.len());
    all.push(Flat {
        right: 1 + left.len() as u32,
        ..leaf
    });
    all.extend_from_slice(&left);
    all.extend_from_slice(&right);
    all
}

/// Half the surface area; 0 for the empty box.
fn half_area(b: &Aabb) -> f32 {
    let e = (b.max - b.min).max(Vec3::ZERO);
    e.x * e.y + e.y * e.z + e.z * e.x
}

fn bin_of(centre: Vec3, centres: &Aabb, axis: usize) -> usize {
    let extent = centres.max[axis] - centres.min[axis];
    // The cast saturates. The quotient is no NaN, since `best_split` skips axes without extent.
    (((centre[axis] - centres.min[axis]) / extent * BINS as f32) as usize).min(BINS - 1)
}

/// The items of a bin: their bounds and their number.
type Bin = (Aabb, u32);

/// Whether the extent of the centres along an axis is too small to be divided into bins.
fn is_flat(centres: &Aabb, axis: usize) -> bool {
    centres.max[axis] - centres.min[axis] <= f32::MIN_POSITIVE * BINS as f32
}

/// The items in bins along each axis that is not flat.
fn binned(items: &[Item], centres: &Aabb) -> [[Bin; BINS]; 3] {
    let mut bins = [[(Aabb::EMPTY, 0); BINS]; 3];
    if items.len() >= PARALLEL {
        // Unions and sums do not depend on the order.
        let empty = bins;
        let parts = items
            .par_chunks(PARALLEL / 2)
            .map(|some| binned(some, centres));
        return parts.reduce(
            || empty,
            |mut all, part| {
                for (bin, more) in all.iter_mut().flatten().zip(part.iter().flatten()) {
                    *bin = (bin.0.union(more.0), bin.1 + more.1);
                }
                all
            },
        );
    }
    for axis in (0..3).filter(|axis| !is_flat(centres, *axis)) {
        for item in items {
            let bin = &mut bins[axis][bin_of(item.centre(), centres, axis)];
            *bin = (bin.0.union(item.bounds), bin.1 + 1);
        }
    }
    bins
}

/// The cheapest split with items on both sides. Among equal costs, the first axis and bin win.
fn best_split(items: &[Item], centres: &Aabb) -> Option<Split> {
    let mut best: Option<Split> = None;
    let all = binned(items, centres);
    for axis in (0..3).filter(|axis| !is_flat(centres, *axis)) {
        let bins = &all[axis];
        let mut above = [(0.0f32, 0u32); BINS];
        let (mut bounds, mut count) = (Aabb::EMPTY, 0);
        for bin in (1..BINS).rev() {
            bounds = bounds.union(bins[bin].0);
            count += bins[bin].1;
            above[bin] = (half_area(&bounds) * count as f32, count);
        }
        let (mut bounds, mut count) = (Aabb::EMPTY, 0);
        for bin in 1..BINS {
            bounds = bounds.union(bins[bin - 1].0);
            count += bins[bin - 1].1;
            let cost = half_area(&bounds) * count as f32 + above[bin].0;
            if count > 0 && above[bin].1 > 0 && best.as_ref().is_none_or(|b| cost < b.cost) {
                best = Some(Split { axis, bin, cost });
            }
        }
    }
    best
}

/// Moves the items for which `left` holds to the front and returns their number.
fn partition(items: &mut [Item], left: impl Fn(&Item) -> bool) -> usize {
    let mut middle = 0;
    for i in 0..items.len() {
        if left(&items[i]) {
            items.swap(i, middle);
            middle += 1;
        }
    }
    middle
}

/// Splits at the median centre along the widest axis. Among equal centres, smaller ids come first.
fn halve(items: &mut [Item], centres: &Aabb) -> usize {
    let extent = centres.max - centres.min;
    let axis = (1..3).fold(0, |a, b| if extent[b] > extent[a] { b } else { a });
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        a.centre()[axis]
            .total_cmp(&b.centre()[axis])
            .then(a.id.cmp(&b.id))
    });
    middle
}

/// The nodes with siblings adjacent, and the depth of the tree.
fn paired(flat: &[Flat]) -> (Vec<Node>, u32) {
    let node = |f: &Flat, child| Node {
        low: f.bounds.min,
        child,
        high: f.bounds.max,
        unused: 0,
    };
    let mut nodes = Vec::with_capacity(flat.len() + 1);
    nodes.extend([Node::zeroed(); 2]);
    let mut deepest = 0;
    // (index in `flat`, index in `nodes`, depth)
    let mut todo = vec![(0usize, 0usize, 0u32)];
    while let Some((from, to, depth)) = todo.pop() {
        let f = &flat[from];
        deepest = deepest.max(depth);
        if f.right == 0 {
            nodes[to] = node(f, (f.first << COUNT_BITS) | f.count);
        } else {
            let left = nodes.len();
            nodes.extend([Node::zeroed(); 2]);
            nodes[to] = node(f, (left as u32) << COUNT_BITS);
            todo.push((from + f.right as usize, left + 1, depth + 1));
            todo.push((from + 1, left, depth + 1));
        }
    }
    (nodes, deepest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that every box is in exactly one leaf and inside the boxes of all ancestors; returns the depth.
    fn check(boxes: &[Aabb], bvh: &Bvh) -> u32 {
        let mut met = vec![0; boxes.len()];
        let mut deepest = 0;
        let mut todo = vec![(0usize, 0u32)];
        while let Some((at, depth)) = todo.pop() {
            deepest = deepest.max(depth);
            let node = bvh.nodes[at];
            let bounds = Aabb {
                min: node.low,
                max: node.high,
            };
            let (place, count) = (
                (node.child >> COUNT_BITS) as usize,
                (node.child & 15) as usize,
            );
            if count == 0 {
                assert!(place.is_multiple_of(2) && place > at);
                for child in [place, place + 1] {
                    let c = bvh.nodes[child];
                    assert!(bounds.contains(c.low) && bounds.contains(c.high));
                    todo.push((child, depth + 1));
                }
            } else {
                assert!(count <= MAX_LEAF);
                for id in &bvh.order[place..place + count] {
                    let b = boxes[*id as usize];
                    assert!(bounds.contains(b.min) && bounds.contains(b.max));
                    met[*id as usize] += 1;
                }
            }
        }
        assert!(met.iter().all(|m| *m == 1));
        assert!(deepest <= MAX_DEPTH);
        deepest
    }

    #[test]
    fn every_box_is_in_one_leaf() {
        for count in [1, 2, 4, 5, 1000, 20_000] {
            let boxes: Vec<Aabb> = (0..count)
                .map(|i| {
                    let p = Vec3::new(
                        (i * 7919 % 1009) as f32,
                        (i * 104_729 % 977) as f32,
                        (i % 31) as f32,
                    );
                    Aabb {
                        min: p,
                        max: p + 1.0 + (i % 5) as f32,
                    }
                })
                .collect();
            let bvh = Bvh::build(&boxes).unwrap();
            check(&boxes, &bvh);
            let again = rayon::ThreadPoolBuilder::new()
                .num_threads(1)
                .build()
                .unwrap();
            let again = again.install(|| Bvh::build(&boxes).unwrap());
            assert_eq!((bvh.nodes, bvh.order), (again.nodes, again.order));
        }
        assert!(Bvh::build(&[]).unwrap().nodes.is_empty());
    }

    /// With boxes whose sizes and distances grow geometrically, the heuristic splits off a few boxes at a
    /// time.
    #[test]
    fn the_depth_is_bounded_where_the_heuristic_would_go_deep() {
        let boxes: Vec<Aabb> = (0..4000)
            .map(|i| {
                let p = Vec3::splat((i as f32 / 17.0 - 120.0).exp2());
                Aabb {
                    min: p * 0.5,
                    max: p,
                }
            })
            .collect();
        assert!(check(&boxes, &Bvh::build(&boxes).unwrap()) > levels(boxes.len()));
        let same = vec![
            Aabb {
                min: Vec3::ZERO,
                max: Vec3::ONE
            };
            3000
        ];
        assert_eq!(
            check(&same, &Bvh::build(&same).unwrap()),
            levels(same.len())
        );
    }
}
