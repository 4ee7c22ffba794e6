//! A hierarchy of boxes over the triangles that block or show.

use crate::surfaces::{BLOCKS, FLAT, SHOWS, Surfaces};

/// A box with two boxes or some triangles in it. 32 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Node {
    /// Least coordinates.
    pub low: [f32; 3],
    /// The first of two children that follow one another, or the first triangle's place in
    /// [`Hierarchy::order`].
    pub first: u32,
    /// Largest coordinates.
    pub high: [f32; 3],
    /// Number of triangles; 0 for a box with boxes in it.
    pub count: u32,
}

/// The boxes, the root first, and the order of the triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hierarchy {
    /// The boxes; none for a scene in which nothing blocks or shows.
    pub nodes: Vec<Node>,
    /// Triangles, those of a leaf together.
    pub order: Vec<u32>,
}

/// Most triangles of a leaf.
const LEAF: usize = 4;
/// Places at which a box may be divided, along its longest side.
const BINS: usize = 16;

impl Hierarchy {
    /// Builds the boxes by the surface-area heuristic.
    pub fn new(surfaces: &Surfaces) -> Self {
        let mut order: Vec<u32> = (0..surfaces.triangles.len() as u32)
            .filter(|t| {
                let flags = surfaces.flags[*t as usize];
                flags & FLAT == 0 && flags & (BLOCKS | SHOWS) != 0
            })
            .collect();
        if order.is_empty() {
            return Self::default();
        }
        let bounds: Vec<Bounds> = surfaces
            .triangles
            .iter()
            .map(|t| t.iter().fold(Bounds::EMPTY, |b, p| b.with(surfaces.points[*p as usize])))
            .collect();
        let mut nodes = vec![Node::default()];
        let mut open = vec![(0usize, 0usize, order.len())];
        while let Some((at, from, to)) = open.pop() {
            let part = &mut order[from..to];
            let around = part.iter().fold(Bounds::EMPTY, |b, t| b.and(&bounds[*t as usize]));
            let middle = divide(part, &bounds);
            let (first, count) = match middle {
                Some(middle) => {
                    let left = nodes.len();
                    nodes.extend([Node::default(); 2]);
                    open.push((left + 1, from + middle, to));
                    open.push((left, from, from + middle));
                    (left as u32, 0)
                }
                None => (from as u32, part.len() as u32),
            };
            nodes[at] = Node { low: around.low, first, high: around.high, count };
        }
        Self { nodes, order }
    }
}

#[derive(Clone, Copy)]
struct Bounds {
    low: [f32; 3],
    high: [f32; 3],
}

impl Bounds {
    const EMPTY: Self = Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    fn with(&self, p: [f32; 3]) -> Self {
        self.and(&Self { low: p, high: p })
    }

    fn and(&self, other: &Self) -> Self {
        Self {
            low: std::array::from_fn(|k| self.low[k].min(other.low[k])),
            high: std::array::from_fn(|k| self.high[k].max(other.high[k])),
        }
    }

    /// In doubles, because the middle of two large coordinates overflows.
    fn middle(&self, k: usize) -> f64 {
        (f64::from(self.low[k]) + f64::from(self.high[k])) / 2.0
    }

    fn half_area(&self) -> f64 {
        let d: [f64; 3] = std::array::from_fn(|k| f64::from(self.high[k]) - f64::from(self.low[k]));
        d[0] * d[1] + d[1] * d[2] + d[2] * d[0]
    }
}

/// Sorts triangles into two parts and says where the second one begins; nothing for those that are to stay
/// together.
fn divide(part: &mut [u32], bounds: &[Bounds]) -> Option<usize> {
    if part.len() <= LEAF {
        return None;
    }
    let middles = |k: usize, part: &[u32]| {
        part.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| {
            let m = bounds[*t as usize].middle(k);
            (a.min(m), b.max(m))
        })
    };
    let ranges: [(f64, f64); 3] = std::array::from_fn(|k| middles(k, part));
    let width = |k: usize| ranges[k].1 - ranges[k].0;
    let axis = (0..3).max_by(|a, b| width(*a).total_cmp(&width(*b)))?;
    if width(axis) <= 0.0 {
        // All middles agree: any half is as good as another.
        return Some(part.len() / 2);
    }
    let bin = |t: u32| {
        let at = (bounds[t as usize].middle(axis) - ranges[axis].0) / width(axis) * BINS as f64;
        (at as usize).min(BINS - 1)
    };
    let mut bins = [(0usize, Bounds::EMPTY); BINS];
    for t in part.iter() {
        let b = &mut bins[bin(*t)];
        *b = (b.0 + 1, b.1.and(&bounds[*t as usize]));
    }
    let cost = |bins: &[(usize, Bounds)]| {
        let (count, around) = bins.iter().fold((0, Bounds::EMPTY), |(n, a), b| (n + b.0, a.and(&b.1)));
        if count == 0 { f64::INFINITY } else { count as f64 * around.half_area() }
    };
    let at = (1..BINS)
        .map(|k| (k, cost(&bins[..k]) + cost(&bins[k..])))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(BINS / 2, |b| b.0);
    part.sort_by_key(|t| (bin(*t) >= at, *t));
    let middle = part.iter().filter(|t| bin(**t) < at).count();
    // The first and the last bin hold something, so both parts do.
    Some(middle)
}
