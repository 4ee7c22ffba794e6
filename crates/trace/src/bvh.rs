//! The binary bounding volume hierarchy of both tracers, built with the binned surface area heuristic.
//!
//! This module does not depend on devices, rays or units. Every leaf has one box, so n boxes have 2n − 1
//! nodes, and the place of each node is known before the node is built. Subtrees are built in parallel. The
//! same boxes result in the same nodes on every machine and with every number of threads. The tracers join
//! nodes to the leaves and widths that they need.
//!
//! **Depth.** A node of n boxes at depth d is split by the heuristic only while d + 1 + [`levels`]\(n − 1) is
//! at most [`MAX_DEPTH`]. Otherwise it is split at the median, which reduces [`levels`] by one. Therefore
//! d + levels(n) never exceeds [`MAX_DEPTH`], which bounds the stacks of traversals.
//!
//! The crate exact has a separate builder, because nearly every rule differs: the tested axes, the precision
//! of costs, leaves, depth, uneven splits and the layout of nodes.

use glam::{Vec3, Vec4, Vec4Swizzles as _};
use rayon::prelude::*;
use sightline_scene::Aabb;

/// Maximum depth of a leaf, where the root has depth 0. The stack in `gpu/traverse.wgsl` has this height.
pub(crate) const MAX_DEPTH: u32 = 40;
/// The number of bins along each axis for many boxes, and for at most [`FEW`] boxes.
const MANY_BINS: usize = 16;
const FEW_BINS: usize = 8;
/// The number of boxes up to which [`FEW_BINS`] bins are used.
const FEW: usize = 32;
/// The number of boxes up to which all splits along each axis are tried.
const SMALL: usize = 4;
/// The number of boxes below which a subtree is built on one thread.
const PARALLEL: usize = 4096;

/// A node. The left child of an inner node follows it; [`Bvh::right`] returns the place of the right child.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BinaryNode {
    /// The box around the node's input boxes.
    pub(crate) bounds: Aabb,
    /// The place of the node's first box in [`Bvh::order`].
    pub(crate) first: u32,
    /// The number of the node's boxes. A leaf has one.
    pub(crate) count: u32,
}

/// A built hierarchy.
#[derive(Debug)]
pub(crate) struct Bvh {
    /// The nodes in preorder; empty if the input has no boxes.
    pub(crate) nodes: Vec<BinaryNode>,
    /// The index of the input box for each place in the order of the leaves.
    pub(crate) order: Vec<u32>,
}

/// The bits of the first index. They and the bits of all other indices are normal numbers, which no processor
/// handles slowly.
const FIRST_ID: u32 = 0x3f80_0000;

/// An input box. The fourth component of `low` has the bits of the box's index plus [`FIRST_ID`].
#[derive(Clone, Copy)]
struct Item {
    low: Vec4,
    high: Vec4,
}

impl Item {
    fn id(&self) -> u32 {
        self.low.w.to_bits() - FIRST_ID
    }

    /// Returns the centre of the box. Both terms are halved first, so the sum cannot overflow.
    #[inline(always)]
    fn centre(&self) -> Vec4 {
        self.low * 0.5 + self.high * 0.5
    }
}

/// A box whose fourth components have no meaning.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vec4,
    high: Vec4,
}

impl Bounds {
    const EMPTY: Self = Self {
        low: Vec4::INFINITY,
        high: Vec4::NEG_INFINITY,
    };

    #[inline(always)]
    fn union(self, low: Vec4, high: Vec4) -> Self {
        Self {
            low: self.low.min(low),
            high: self.high.max(high),
        }
    }

    /// Computes half the surface area; 0 for the empty box.
    #[inline(always)]
    fn half_area(&self) -> f32 {
        half_area((self.high - self.low).xyz())
    }
}

fn half_area(extent: Vec3) -> f32 {
    let e = extent.max(Vec3::ZERO);
    e.x * e.y + e.y * e.z + e.z * e.x
}

impl BinaryNode {
    const EMPTY: Self = Self {
        bounds: Aabb::EMPTY,
        first: 0,
        count: 0,
    };

    /// Computes half the surface area of the node's box.
    pub(crate) fn half_area(&self) -> f32 {
        half_area(self.bounds.max - self.bounds.min)
    }

    /// Returns true if the node has no children.
    pub(crate) fn is_leaf(&self) -> bool {
        self.count == 1
    }
}

/// Returns the number of levels that n boxes need if every node is split at the median.
fn levels(n: usize) -> u32 {
    n.max(1).next_power_of_two().trailing_zeros()
}

impl Bvh {
    /// Builds the hierarchy over `boxes`, none of which is empty.
    ///
    /// # Errors
    /// A message if `boxes` has more elements than the nodes can number.
    pub(crate) fn build(boxes: &[Aabb]) -> Result<Self, String> {
        let most = 1usize << 30;
        if boxes.len() > most {
            return Err(format!(
                "{} triangles are more than the {most} that a hierarchy can number",
                boxes.len()
            ));
        }
        if boxes.is_empty() {
            return Ok(Self {
                nodes: Vec::new(),
                order: Vec::new(),
            });
        }
        let mut items: Vec<Item> = boxes
            .par_iter()
            .zip(0u32..boxes.len() as u32)
            .map(|(b, id)| Item {
                low: b.min.extend(f32::from_bits(FIRST_ID + id)),
                high: b.max.extend(0.0),
            })
            .collect();
        let mut nodes = vec![BinaryNode::EMPTY; 2 * boxes.len() - 1];
        subtree(&mut items, &mut nodes, 0, 0);
        Ok(Self {
            nodes,
            order: items.iter().map(Item::id).collect(),
        })
    }

    /// Returns the place of the right child of the inner node at `place`.
    pub(crate) fn right(&self, place: usize) -> usize {
        place + 2 * self.nodes[place + 1].count as usize
    }
}

/// Builds the tree over `items` into `nodes`, which has room for just this tree. The order of the leaves
/// begins at place `first`.
fn subtree(items: &mut [Item], nodes: &mut [BinaryNode], first: usize, depth: u32) {
    let (bounds, centres) = extents(items);
    nodes[0] = BinaryNode {
        bounds: Aabb {
            min: bounds.low.xyz(),
            max: bounds.high.xyz(),
        },
        first: first as u32,
        count: items.len() as u32,
    };
    if items.len() == 1 {
        return;
    }
    let free = depth + 1 + levels(items.len() - 1) <= MAX_DEPTH;
    let split = match items.len() {
        _ if !free => None,
        // Both splits of two boxes have the same cost.
        2 => Some(1),
        n if n <= SMALL => sorted_split(items),
        n if n <= FEW => binned_split::<FEW_BINS>(items, &centres),
        _ => binned_split::<MANY_BINS>(items, &centres),
    };
    let middle = split.unwrap_or_else(|| halve(items, &centres));
    let (left, right) = items.split_at_mut(middle);
    let (left_nodes, right_nodes) = nodes[1..].split_at_mut(2 * middle - 1);
    if left.len() + right.len() >= PARALLEL {
        rayon::join(
            || subtree(left, left_nodes, first, depth + 1),
            || subtree(right, right_nodes, first + middle, depth + 1),
        );
    } else {
        subtree(left, left_nodes, first, depth + 1);
        subtree(right, right_nodes, first + middle, depth + 1);
    }
}

/// Returns the box around the items and the box around their centres.
fn extents(items: &[Item]) -> (Bounds, Bounds) {
    if items.len() >= 4 * PARALLEL {
        // Unions do not depend on the order.
        return items.par_chunks(PARALLEL).map(extents).reduce(
            || (Bounds::EMPTY, Bounds::EMPTY),
            |a, b| (a.0.union(b.0.low, b.0.high), a.1.union(b.1.low, b.1.high)),
        );
    }
    let mut bounds = Bounds::EMPTY;
    let mut centres = Bounds::EMPTY;
    for item in items {
        bounds = bounds.union(item.low, item.high);
        let c = item.centre();
        centres = centres.union(c, c);
    }
    (bounds, centres)
}

/// Sorts a few items for the cheapest of all splits by centres along an axis, and returns the number of items
/// on the left. Returns `None` if the centres are equal.
fn sorted_split(items: &mut [Item]) -> Option<usize> {
    let n = items.len();
    let mut best: Option<(f32, usize, [Item; SMALL])> = None;
    for axis in 0..3 {
        let mut order = [items[0]; SMALL];
        order[..n].copy_from_slice(items);
        // An insertion sort, which is stable and short for four items.
        for i in 1..n {
            let mut j = i;
            while j > 0 && order[j - 1].centre()[axis] > order[j].centre()[axis] {
                order.swap(j - 1, j);
                j -= 1;
            }
        }
        if order[0].centre()[axis] == order[n - 1].centre()[axis] {
            continue;
        }
        let mut above = [0.0f32; SMALL];
        let mut bounds = Bounds::EMPTY;
        for i in (1..n).rev() {
            bounds = bounds.union(order[i].low, order[i].high);
            above[i] = bounds.half_area() * (n - i) as f32;
        }
        bounds = Bounds::EMPTY;
        for i in 1..n {
            bounds = bounds.union(order[i - 1].low, order[i - 1].high);
            let cost = bounds.half_area() * i as f32 + above[i];
            if best.as_ref().is_none_or(|b| cost < b.0) {
                best = Some((cost, i, order));
            }
        }
    }
    let (_, middle, order) = best?;
    items.copy_from_slice(&order[..n]);
    Some(middle)
}

/// The items of a bin: their bounds and their number.
type Bin = (Bounds, u32);

/// The map from centres to bins.
struct Binning {
    low: Vec4,
    /// The number of bins per unit; 0 along an axis that is too short to be divided.
    scale: Vec4,
}

impl Binning {
    fn new<const BINS: usize>(centres: &Bounds) -> Self {
        let extent = centres.high - centres.low;
        let usable = extent.cmpgt(Vec4::splat(f32::MIN_POSITIVE * BINS as f32));
        let scale = Vec4::splat(BINS as f32 * 0.999_9) / extent;
        Self {
            low: centres.low,
            scale: Vec4::select(usable, scale, Vec4::ZERO),
        }
    }

    /// Returns the bin of a centre along each axis.
    #[inline(always)]
    fn bins<const BINS: usize>(&self, centre: Vec4) -> [usize; 3] {
        let at = (centre - self.low) * self.scale;
        // The cast saturates.
        [at.x, at.y, at.z].map(|x| (x as i32 as usize).min(BINS - 1))
    }
}

/// Sorts the items into bins along each axis.
fn binned<const BINS: usize>(items: &[Item], binning: &Binning) -> [[Bin; BINS]; 3] {
    let empty = [[(Bounds::EMPTY, 0); BINS]; 3];
    if items.len() >= 4 * PARALLEL {
        let parts = items
            .par_chunks(PARALLEL)
            .map(|some| binned::<BINS>(some, binning));
        return parts.reduce(
            || empty,
            |mut all, part| {
                for (bin, more) in all.iter_mut().flatten().zip(part.iter().flatten()) {
                    *bin = (bin.0.union(more.0.low, more.0.high), bin.1 + more.1);
                }
                all
            },
        );
    }
    let mut bins = empty;
    for item in items {
        let places = binning.bins::<BINS>(item.centre());
        for axis in 0..3 {
            let bin = &mut bins[axis][places[axis]];
            bin.0 = bin.0.union(item.low, item.high);
            bin.1 += 1;
        }
    }
    bins
}

/// Moves the items left of the cheapest split to the front and returns their number. Among equal costs, the
/// first axis and bin win. Returns `None` if no split has items on both sides.
fn binned_split<const BINS: usize>(items: &mut [Item], centres: &Bounds) -> Option<usize> {
    let binning = Binning::new::<BINS>(centres);
    let all = binned::<BINS>(items, &binning);
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in (0..3).filter(|axis| binning.scale[*axis] > 0.0) {
        let bins = &all[axis];
        let mut above = [(0.0f32, 0u32); BINS];
        let (mut bounds, mut count) = (Bounds::EMPTY, 0);
        for bin in (1..BINS).rev() {
            bounds = bounds.union(bins[bin].0.low, bins[bin].0.high);
            count += bins[bin].1;
            above[bin] = (bounds.half_area() * count as f32, count);
        }
        (bounds, count) = (Bounds::EMPTY, 0);
        for bin in 1..BINS {
            bounds = bounds.union(bins[bin - 1].0.low, bins[bin - 1].0.high);
            count += bins[bin - 1].1;
            let cost = bounds.half_area() * count as f32 + above[bin].0;
            if count > 0 && above[bin].1 > 0 && best.is_none_or(|b| cost < b.0) {
                best = Some((cost, axis, bin));
            }
        }
    }
    let (_, axis, bin) = best?;
    Some(partition(items, |i| {
        binning.bins::<BINS>(i.centre())[axis] < bin
    }))
}

/// Moves the items for which `left` returns true to the front and returns their number.
fn partition(items: &mut [Item], left: impl Fn(&Item) -> bool) -> usize {
    let mut middle = 0;
    for i in 0..items.len() {
        let goes_left = left(&items[i]);
        items.swap(i, middle);
        middle += usize::from(goes_left);
    }
    middle
}

/// Splits at the median centre along the widest axis. Among equal centres, smaller indices come first.
fn halve(items: &mut [Item], centres: &Bounds) -> usize {
    let extent = centres.high - centres.low;
    let axis = (1..3).fold(0, |a, b| if extent[b] > extent[a] { b } else { a });
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        a.centre()[axis]
            .total_cmp(&b.centre()[axis])
            .then(a.id().cmp(&b.id()))
    });
    middle
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that every box is in one leaf and inside the boxes of all ancestors. Returns the depth.
    fn check(boxes: &[Aabb], bvh: &Bvh) -> u32 {
        let mut met = vec![0; boxes.len()];
        let mut deepest = 0;
        let mut todo = vec![(0usize, 0u32)];
        while let Some((at, depth)) = todo.pop() {
            deepest = deepest.max(depth);
            let node = bvh.nodes[at];
            for place in node.first..node.first + node.count {
                let b = boxes[bvh.order[place as usize] as usize];
                assert!(node.bounds.contains(b.min) && node.bounds.contains(b.max));
            }
            if node.is_leaf() {
                met[bvh.order[node.first as usize] as usize] += 1;
            } else {
                let children = [at + 1, bvh.right(at)];
                let counts = children.map(|c| bvh.nodes[c].count);
                assert_eq!(counts[0] + counts[1], node.count);
                todo.extend(children.map(|c| (c, depth + 1)));
            }
        }
        assert!(met.iter().all(|m| *m == 1));
        assert!(deepest <= MAX_DEPTH);
        deepest
    }

    #[test]
    fn every_box_is_in_one_leaf() {
        for count in [1, 2, 4, 5, 1000, 40_000] {
            let boxes: Vec<Aabb> = (0..count)
                .map(|i| {
                    let p = Vec3::new(
                        (i * 7919 % 1009) as f32,
                        (i % 977 * 104_729 % 977) as f32,
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

    /// Checks boxes whose sizes and distances grow geometrically. The heuristic splits off only a few of them
    /// at a time.
    #[test]
    fn depth_is_bounded_where_heuristic_would_go_deep() {
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
