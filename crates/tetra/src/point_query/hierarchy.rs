//! A hierarchy of boxes over the triangles that block or show, and the neighbours of triangles.

use super::neighbours;
use super::rounded::BOUND;
use crate::surfaces::{BLOCKS, FLAT, SHOWS, SurfacesView};

/// A box that contains two boxes or some triangles. 32 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct BvhNode {
    /// The smallest coordinates.
    pub low: [f32; 3],
    /// The index of the first of two consecutive children in [`Hierarchy::nodes`], or of the first triangle
    /// in [`Hierarchy::order`].
    pub first: u32,
    /// The largest coordinates.
    pub high: [f32; 3],
    /// The number of the box's triangles in [`Hierarchy::order`]; 0 for a box that contains boxes.
    pub count: u32,
}

impl BvhNode {
    /// Returns a lower bound of the square of the distance between the box and a point.
    pub(super) fn near(&self, x: [f64; 3]) -> f64 {
        let sum = (0..3).fold(0.0, |sum, k| {
            let d = (f64::from(self.low[k]) - x[k])
                .max(x[k] - f64::from(self.high[k]))
                .max(0.0);
            sum + d * d
        });
        sum * (1.0 - BOUND)
    }

    /// Returns the square of the box's diagonal, rounded.
    pub(super) fn size(&self) -> f64 {
        (0..3).fold(0.0, |sum, k| {
            let d = f64::from(self.high[k]) - f64::from(self.low[k]);
            sum + d * d
        })
    }
}

/// A hierarchy of boxes over the triangles of a scene, and the neighbours of the triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hierarchy {
    /// The boxes, the root first; empty for a scene in which no triangle blocks or shows.
    pub nodes: Vec<BvhNode>,
    /// The ids of the triangles that block or show, grouped by leaf box.
    pub order: Vec<u32>,
    /// The ids of the triangles across the edges of each triangle, or 2³² − 1 (`neighbours`).
    pub neighbours: Vec<[u32; 3]>,
}

/// Borrowed lists of a [`Hierarchy`], for example from a mapped file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Boxes<'a> {
    /// The boxes, the root first ([`Hierarchy::nodes`]).
    pub nodes: &'a [BvhNode],
    /// The ids of the triangles, grouped by leaf box ([`Hierarchy::order`]).
    pub order: &'a [u32],
    /// The ids of the triangles across the edges of each triangle ([`Hierarchy::neighbours`]).
    pub neighbours: &'a [[u32; 3]],
}

impl Boxes<'_> {
    /// Checks that the boxes are a tree that lists each triangle that blocks or shows once.
    ///
    /// Also checks that each box contains its children or triangles.
    ///
    /// # Errors
    /// A description of the first fault.
    pub(crate) fn check(&self, surfaces: SurfacesView<'_>) -> Result<(), String> {
        let counts = |t: usize| is_listed(surfaces.flags[t]);
        let wanted = (0..surfaces.triangles.len()).filter(|t| counts(*t)).count();
        if self.order.len() != wanted || self.nodes.is_empty() != self.order.is_empty() {
            return Err("the boxes do not list each triangle that blocks or shows once".to_owned());
        }
        let mut listed = vec![false; surfaces.triangles.len()];
        for t in self.order {
            match listed.get_mut(*t as usize) {
                Some(listed) if !*listed && counts(*t as usize) => *listed = true,
                _ => {
                    return Err(format!(
                        "the boxes list triangle {t} twice, or the triangle does not exist, or the triangle \
                         neither blocks nor shows"
                    ));
                }
            }
        }
        // Children come in pairs after their parents. Triangles are in the order of leaves.
        let mut is_child = vec![false; self.nodes.len()];
        let mut in_leaves = 0usize;
        for (i, node) in self.nodes.iter().enumerate() {
            let bad = |what: &str| Err(format!("box {i} {what}"));
            if !node.low.iter().chain(&node.high).all(|c| c.is_finite()) {
                return bad("has a bound that is not a finite number");
            }
            let holds = |low: &[f32; 3], high: &[f32; 3]| {
                (0..3).all(|k| node.low[k] <= low[k] && high[k] <= node.high[k])
            };
            if node.count > 0 {
                let range = node.first as usize..node.first as usize + node.count as usize;
                let Some(own) = self.order.get(range) else {
                    return bad("refers to triangles that do not exist");
                };
                in_leaves += own.len();
                let corners = own.iter().flat_map(|t| surfaces.triangles[*t as usize]);
                if !corners
                    .map(|p| &surfaces.points[p as usize])
                    .all(|p| holds(p, p))
                {
                    return bad("does not contain its triangles");
                }
                continue;
            }
            for child in [node.first as usize, (node.first as usize).saturating_add(1)] {
                match (self.nodes.get(child), is_child.get_mut(child)) {
                    (Some(below), Some(is_child)) if child > i && !*is_child => {
                        *is_child = true;
                        if !holds(&below.low, &below.high) {
                            return bad("does not contain its child boxes");
                        }
                    }
                    _ => {
                        return bad(
                            "refers to a box that does not exist, or that another box refers to",
                        );
                    }
                }
            }
        }
        // If every box except the first is the child of one box, all boxes are below the first box. Even if
        // the leaves list the right number of triangles in total, two leaves could overlap and miss other
        // triangles.
        let mut covered = vec![false; self.order.len()];
        for node in self.nodes.iter().filter(|n| n.count > 0) {
            covered[node.first as usize..][..node.count as usize].fill(true);
        }
        match is_child.iter().skip(1).all(|c| *c)
            && in_leaves == wanted
            && covered.iter().all(|c| *c)
        {
            true => Ok(()),
            false => Err("a box or a triangle is in no box, or in two boxes".to_owned()),
        }
    }
}

/// Returns true if boxes list a triangle with these flags.
fn is_listed(flags: u8) -> bool {
    flags & FLAT == 0 && flags & (BLOCKS | SHOWS) != 0
}

/// Maximum number of triangles of a leaf box.
const LEAF: usize = 4;
/// Number of bins into which the middles of triangles are sorted along an axis. A box can be divided between
/// two bins.
const BINS: usize = 16;

impl Hierarchy {
    /// Returns views of the lists.
    pub fn view(&self) -> Boxes<'_> {
        Boxes {
            nodes: &self.nodes,
            order: &self.order,
            neighbours: &self.neighbours,
        }
    }

    /// Builds the boxes by the surface-area heuristic, and finds the neighbours of triangles.
    pub fn new(surfaces: SurfacesView<'_>) -> Self {
        let mut order: Vec<u32> = (0..surfaces.triangles.len() as u32)
            .filter(|t| is_listed(surfaces.flags[*t as usize]))
            .collect();
        let neighbours = neighbours::neighbours(surfaces);
        if order.is_empty() {
            return Self {
                neighbours,
                ..Self::default()
            };
        }
        let bounds: Vec<Bounds> = surfaces
            .triangles
            .iter()
            .map(|t| {
                t.iter()
                    .fold(Bounds::EMPTY, |b, p| b.with(surfaces.points[*p as usize]))
            })
            .collect();
        let mut nodes = vec![BvhNode::default()];
        let mut open = vec![(0usize, 0usize, order.len())];
        while let Some((at, from, to)) = open.pop() {
            let part = &mut order[from..to];
            let around = part
                .iter()
                .fold(Bounds::EMPTY, |b, t| b.and(&bounds[*t as usize]));
            let middle = divide(part, &bounds);
            let (first, count) = match middle {
                Some(middle) => {
                    let left = nodes.len();
                    nodes.extend([BvhNode::default(); 2]);
                    open.push((left + 1, from + middle, to));
                    open.push((left, from, from + middle));
                    (left as u32, 0)
                }
                None => (from as u32, part.len() as u32),
            };
            nodes[at] = BvhNode {
                low: around.low,
                first,
                high: around.high,
                count,
            };
        }
        Self {
            nodes,
            order,
            neighbours,
        }
    }
}

#[derive(Clone, Copy)]
struct Bounds {
    low: [f32; 3],
    high: [f32; 3],
}

impl Bounds {
    const EMPTY: Self = Self {
        low: [f32::INFINITY; 3],
        high: [f32::NEG_INFINITY; 3],
    };

    fn with(&self, p: [f32; 3]) -> Self {
        self.and(&Self { low: p, high: p })
    }

    fn and(&self, other: &Self) -> Self {
        Self {
            low: std::array::from_fn(|k| self.low[k].min(other.low[k])),
            high: std::array::from_fn(|k| self.high[k].max(other.high[k])),
        }
    }

    /// Computes the middle on axis `k` in doubles, because the sum of two large coordinates overflows in
    /// single precision.
    fn middle(&self, k: usize) -> f64 {
        (f64::from(self.low[k]) + f64::from(self.high[k])) / 2.0
    }

    fn half_area(&self) -> f64 {
        let d: [f64; 3] = std::array::from_fn(|k| f64::from(self.high[k]) - f64::from(self.low[k]));
        d[0] * d[1] + d[1] * d[2] + d[2] * d[0]
    }
}

/// Sorts triangle ids into two parts, and returns the index at which the second part starts.
///
/// Returns `None` if the triangles should be one leaf box.
fn divide(part: &mut [u32], bounds: &[Bounds]) -> Option<usize> {
    if part.len() <= LEAF {
        return None;
    }
    // Along each axis the smallest middle of the triangles' boxes, and the distance to the largest middle.
    let ranges: [(f64, f64); 3] = std::array::from_fn(|k| {
        let (least, most) = part
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| {
                let m = bounds[*t as usize].middle(k);
                (a.min(m), b.max(m))
            });
        (least, most - least)
    });
    let bin = |axis: usize, t: u32| {
        let (least, width) = ranges[axis];
        let at = (bounds[t as usize].middle(axis) - least) / width * BINS as f64;
        (at as usize).min(BINS - 1)
    };
    let mut best: Option<(f64, usize, usize)> = None;
    for axis in (0..3).filter(|axis| ranges[*axis].1 > 0.0) {
        let mut bins = [(0usize, Bounds::EMPTY); BINS];
        for t in part.iter() {
            let b = &mut bins[bin(axis, *t)];
            *b = (b.0 + 1, b.1.and(&bounds[*t as usize]));
        }
        for at in 1..BINS {
            let cost = cost(&bins[..at]) + cost(&bins[at..]);
            if best.is_none_or(|best| cost < best.0) {
                best = Some((cost, axis, at));
            }
        }
    }
    // If all middles agree, every division into halves is equally good.
    let Some((_, axis, at)) = best else {
        return Some(part.len() / 2);
    };
    part.sort_by_key(|t| (bin(axis, *t) >= at, *t));
    // The first and the last bin are not empty, so both parts are not empty.
    Some(part.iter().filter(|t| bin(axis, **t) < at).count())
}

/// Returns the expected cost of visiting the triangles of some bins, by the surface-area heuristic.
fn cost(bins: &[(usize, Bounds)]) -> f64 {
    let (count, around) = bins
        .iter()
        .fold((0, Bounds::EMPTY), |(n, a), b| (n + b.0, a.and(&b.1)));
    if count == 0 {
        f64::INFINITY
    } else {
        count as f64 * around.half_area()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_rejects_box_without_finite_bounds() {
        let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let surfaces = SurfacesView {
            points: &points,
            triangles: &[[0, 1, 2]],
            flags: &[BLOCKS | SHOWS],
        };
        let good = Hierarchy::new(surfaces);
        assert_eq!(good.view().check(surfaces), Ok(()));
        for (low, high) in [
            (f32::NEG_INFINITY, 1.0),
            (0.0, f32::INFINITY),
            (f32::NAN, 1.0),
        ] {
            let mut bad = good.clone();
            (bad.nodes[0].low[0], bad.nodes[0].high[0]) = (low, high);
            assert!(bad.view().check(surfaces).is_err(), "{low} to {high}");
        }
    }
}
