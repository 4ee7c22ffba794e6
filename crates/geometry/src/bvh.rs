//! A bounding volume hierarchy that returns all triangles that a segment may meet, and possibly more.
//!
//! Callers test every candidate exactly, so the boxes only have to be large enough. The tests use no
//! division. A segment misses a box if one of six axes separates the two by more than a slack that covers all
//! rounding errors.
//!
//! The builder is separate from the builder of the hierarchy in the crate `sampling`, because nearly every
//! rule differs: the axes tried, the precision of costs, leaves, depth, uneven splits and the layout of
//! nodes.

use glam::{DVec3, Vec3};
use sightline_numbers::Aabb;

/// The maximum number of items in a leaf.
const LEAF: usize = 4;
/// The depth from which the builder splits the items of a node into halves, at any cost.
///
/// At most 32 more levels follow.
const DEEP: u32 = 48;
/// The capacity of a traversal's stack, in nodes: one node per level, and the next node.
const WAITING: usize = 96;

#[derive(Clone, Copy, Debug)]
struct Node {
    min: Vec3,
    /// For an inner node, the index of its first child; the second child follows. For a leaf, the index in
    /// `order` of its first item.
    first: u32,
    max: Vec3,
    /// The number of items of a leaf; 0 for an inner node.
    count: u32,
}

/// The children of a node, or the items of a leaf.
pub enum Below<'a> {
    /// The node indices of the two children of an inner node.
    Nodes([u32; 2]),
    /// The items of a leaf.
    Items(&'a [u32]),
}

/// A hierarchy over boxes. An item is the index of its box in the list of boxes.
pub struct Bvh {
    nodes: Vec<Node>,
    order: Vec<u32>,
    boxes: Vec<Aabb>,
}

impl Bvh {
    /// Builds a hierarchy over the items in `order`, which are indices of `boxes`.
    pub fn new(boxes: Vec<Aabb>, mut order: Vec<u32>) -> Self {
        let mut nodes = Vec::with_capacity(order.len() / 2 + 1);
        let bounds = |items: &[u32]| {
            items
                .iter()
                .fold(Aabb::EMPTY, |all: Aabb, i| all.union(boxes[*i as usize]))
        };
        let Aabb { min, max } = bounds(&order);
        nodes.push(Node {
            min,
            max,
            first: 0,
            count: order.len() as u32,
        });
        let mut open = vec![(0usize, 0u32)];
        while let Some((n, depth)) = open.pop() {
            let (first, count) = (nodes[n].first as usize, nodes[n].count as usize);
            if count <= LEAF {
                continue;
            }
            let items = &mut order[first..first + count];
            let half = split(&boxes, items, depth < DEEP);
            let at = nodes.len() as u32;
            for (start, part) in [(first, &items[..half]), (first + half, &items[half..])] {
                let Aabb { min, max } = bounds(part);
                nodes.push(Node {
                    min,
                    max,
                    first: start as u32,
                    count: part.len() as u32,
                });
            }
            (nodes[n].first, nodes[n].count) = (at, 0);
            open.extend([(at as usize, depth + 1), (at as usize + 1, depth + 1)]);
        }
        Self {
            nodes,
            order,
            boxes,
        }
    }

    /// Returns the number of nodes. The root is node 0, and children come after their parents.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Returns true if the hierarchy contains no items.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Returns the box of a node.
    pub fn bounds(&self, node: u32) -> Aabb {
        let n = &self.nodes[node as usize];
        Aabb {
            min: n.min,
            max: n.max,
        }
    }

    /// Returns the children of an inner node, or the items of a leaf. The hierarchy must contain an item.
    pub fn below(&self, node: u32) -> Below<'_> {
        let n = &self.nodes[node as usize];
        if n.count > 0 {
            Below::Items(&self.order[n.first as usize..(n.first + n.count) as usize])
        } else {
            Below::Nodes([n.first, n.first + 1])
        }
    }

    /// Appends to `out` every item whose box shares a point with the box from `min` to `max`.
    pub fn in_box(&self, min: Vec3, max: Vec3, out: &mut Vec<u32>) {
        let apart = |lo: Vec3, hi: Vec3| lo.cmpgt(max).any() || hi.cmplt(min).any();
        let mut open = [0u32; WAITING];
        let mut len = usize::from(!self.order.is_empty());
        while len > 0 {
            len -= 1;
            let node = &self.nodes[open[len] as usize];
            if apart(node.min, node.max) {
                continue;
            }
            if node.count > 0 {
                let items = &self.order[node.first as usize..(node.first + node.count) as usize];
                out.extend(items.iter().filter(|i| {
                    let b = self.boxes[**i as usize];
                    !apart(b.min, b.max)
                }));
            } else {
                (open[len], open[len + 1]) = (node.first, node.first + 1);
                len += 2;
            }
        }
    }

    /// Appends to `out` every item whose box the segment from `p` to `q` may touch.
    ///
    /// `slack` is the maximum error of each coordinate of `p` and `q`.
    pub fn along(&self, p: DVec3, q: DVec3, slack: f64, out: &mut Vec<u32>) {
        let segment = Segment::new(p, q, slack);
        let mut open = [0u32; WAITING];
        let mut len = 1;
        if self.order.is_empty() {
            return;
        }
        while len > 0 {
            len -= 1;
            let node = &self.nodes[open[len] as usize];
            if !segment.touches(node.min, node.max) {
                continue;
            }
            if node.count > 0 {
                let items = &self.order[node.first as usize..(node.first + node.count) as usize];
                out.extend(items.iter().filter(|i| {
                    let b = self.boxes[**i as usize];
                    segment.touches(b.min, b.max)
                }));
            } else {
                open[len] = node.first;
                open[len + 1] = node.first + 1;
                len += 2;
            }
        }
    }
}

impl Bvh {
    /// Calls `hit` for all items of the leaves whose boxes the ray meets before its end, nearer leaves first.
    ///
    /// `hit` receives an item and the current end of the ray, as a multiple of the length of `direction`, and
    /// returns the new end. Rounding may skip an item, so callers must not rely on a complete result.
    pub fn nearest(&self, origin: DVec3, direction: DVec3, mut hit: impl FnMut(u32, f64) -> f64) {
        let inverse = direction.recip();
        let enter = |n: &Node| {
            let (x, y) = (
                (n.min.as_dvec3() - origin) * inverse,
                (n.max.as_dvec3() - origin) * inverse,
            );
            let (near, far) = (x.min(y).max_element().max(0.0), x.max(y).min_element());
            if near <= far { near } else { f64::INFINITY }
        };
        let mut limit = f64::INFINITY;
        let mut open = [(0u32, 0.0f64); WAITING];
        let mut len = usize::from(!self.order.is_empty());
        while len > 0 {
            len -= 1;
            let (node, near) = open[len];
            if near > limit {
                continue;
            }
            let node = &self.nodes[node as usize];
            if node.count > 0 {
                for item in &self.order[node.first as usize..(node.first + node.count) as usize] {
                    limit = hit(*item, limit);
                }
                continue;
            }
            let [mut a, mut b] =
                [node.first, node.first + 1].map(|c| (c, enter(&self.nodes[c as usize])));
            if a.1 < b.1 {
                std::mem::swap(&mut a, &mut b);
            }
            for child in [a, b] {
                if child.1 < limit {
                    open[len] = child;
                    len += 1;
                }
            }
        }
    }
}

/// Splits the items into two parts and returns the size of the first part.
///
/// If `cheapest` is true, the function splits at the plane with the least surface-area cost between 16 bins
/// along the widest axis of the boxes' centres. Otherwise both parts have the same number of items.
fn split(boxes: &[Aabb], items: &mut [u32], cheapest: bool) -> usize {
    const BINS: usize = 16;
    let centre = |i: u32| {
        let b = boxes[i as usize];
        b.min * 0.5 + b.max * 0.5
    };
    let (lo, hi) = items
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), i| {
            (lo.min(centre(*i)), hi.max(centre(*i)))
        });
    let extent = hi - lo;
    let axis = (0..3)
        .max_by(|a, b| extent[*a].total_cmp(&extent[*b]))
        .unwrap_or(0);
    let middle = items.len() / 2;
    let by_centre = |a: &u32, b: &u32| centre(*a)[axis].total_cmp(&centre(*b)[axis]).then(a.cmp(b));
    let bin = |i: u32| {
        (((centre(i)[axis] - lo[axis]) / extent[axis] * BINS as f32) as usize).min(BINS - 1)
    };
    if !(cheapest && extent[axis] > 0.0 && extent[axis].is_finite()) {
        items.select_nth_unstable_by(middle, by_centre);
        return middle;
    }
    let area = |b: Aabb| {
        let d = b.max.as_dvec3() - b.min.as_dvec3();
        d.x * d.y + d.y * d.z + d.z * d.x
    };
    let mut bins = [(Aabb::EMPTY, 0usize); BINS];
    for i in items.iter() {
        let (all, n) = &mut bins[bin(*i)];
        *all = all.union(boxes[*i as usize]);
        *n += 1;
    }
    let mut best: Option<(f64, usize)> = None;
    for k in 1..BINS {
        let side = |part: &[(Aabb, usize)]| {
            part.iter()
                .fold((Aabb::EMPTY, 0), |(b, n), (c, m)| (b.union(*c), n + m))
        };
        let ((a, n), (b, m)) = (side(&bins[..k]), side(&bins[k..]));
        if n == 0 || m == 0 {
            continue;
        }
        let cost = area(a) * n as f64 + area(b) * m as f64;
        if best.is_none_or(|(c, _)| cost < c) {
            best = Some((cost, k));
        }
    }
    // A very uneven split makes the tree deep, so a split into halves replaces this split.
    match best {
        Some((_, k)) => {
            let mut half = 0;
            for i in 0..items.len() {
                if bin(items[i]) < k {
                    items.swap(i, half);
                    half += 1;
                }
            }
            if half.min(items.len() - half) * 16 < items.len() {
                items.select_nth_unstable_by(middle, by_centre);
                return middle;
            }
            half
        }
        None => {
            items.select_nth_unstable_by(middle, by_centre);
            middle
        }
    }
}

/// A segment, stored as its middle and half its extent.
struct Segment {
    middle: DVec3,
    half: DVec3,
    /// The magnitudes of the components of `half`.
    size: DVec3,
    /// The maximum error of each coordinate of the ends.
    slack: f64,
    /// The largest component of `size`.
    largest: f64,
}

impl Segment {
    fn new(p: DVec3, q: DVec3, slack: f64) -> Self {
        let (middle, half) = ((p + q) * 0.5, (q - p) * 0.5);
        let size = half.abs();
        Self {
            middle,
            half,
            size,
            slack,
            largest: size.max_element(),
        }
    }

    fn touches(&self, min: Vec3, max: Vec3) -> bool {
        let (lo, hi) = (min.as_dvec3(), max.as_dvec3());
        let c = self.middle - (lo + hi) * 0.5;
        let e = (hi - lo) * 0.5 + DVec3::splat(self.slack);
        let a = c.abs();
        if (a.cmpgt(e + self.size)).any() {
            return false;
        }
        let cross = c.cross(self.half).abs();
        let reach = DVec3::new(
            e.y * self.size.z + e.z * self.size.y,
            e.x * self.size.z + e.z * self.size.x,
            e.x * self.size.y + e.y * self.size.x,
        );
        // Ends that are off by the slack change the half extent by as much. So the error of a comparison is
        // the slack times the factors of the half extent in `cross` and `reach`.
        let slack = self.slack * (4.0 * self.largest + 4.0 * (a.max_element() + e.max_element()));
        !(cross.cmpgt(reach + DVec3::splat(slack))).any()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All splits of these thin boxes cost the same. If `split` chose the first plane every time, the tree
    /// would become a chain.
    #[test]
    fn tree_of_equal_costs_is_not_chain() {
        let boxes: Vec<Aabb> = (0..20_000)
            .map(|i| {
                let x = i as f32 * 1e-25;
                Aabb {
                    min: Vec3::new(x, 0.0, 0.0),
                    max: Vec3::new(x, 1.0, 1.0),
                }
            })
            .collect();
        let tree = Bvh::new(boxes.clone(), (0..boxes.len() as u32).collect());
        let mut found = Vec::new();
        tree.along(
            DVec3::new(-1.0, 0.5, 0.5),
            DVec3::new(1.0, 0.5, 0.5),
            0.0,
            &mut found,
        );
        assert_eq!(found.len(), boxes.len());
        found.clear();
        tree.in_box(Vec3::ZERO, Vec3::ONE, &mut found);
        assert_eq!(found.len(), boxes.len());
        let mut met = 0;
        tree.nearest(DVec3::new(-1.0, 0.5, 0.5), DVec3::X, |_, limit| {
            met += 1;
            limit
        });
        assert_eq!(met, boxes.len());
    }
}
