//! Side bitsets: for each boundary edge, on which side the rays of a region and the sampled lines inside it
//! pass.
//!
//! They rank occluders by how much of a region they block. They are rounded and have no error bounds: the
//! ranking affects the time of a query, never its verdict. Edges are plain doubles here, and only the edges
//! of the chosen occluder become lines of the space.

use std::ops::Range;

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::arithmetic::number::normalised;
use crate::geometry::frame::Frame;
use crate::line_space::forms::Forms;
use crate::occluders::{OccluderId, Occluders};
use crate::search::maps::with_room;

/// A set of a region's rays and sampled lines, one bit each. Rays and lines beyond the first 256 are ignored;
/// few regions have more.
pub type Bits = [u64; 4];
/// Capacity of a [`Bits`].
const MOST: usize = 256;
/// Forms up to this magnitude count as 0; no component of either vector exceeds 1.
const ON: f64 = 1e-12;

/// An edge in the border of an occluder or of a fused occluder.
#[derive(Clone, Copy, Debug, Default)]
pub struct BoundaryEdge {
    /// Its number in the scene ([`crate::occluders::boundary_edges::BoundaryEdges`]).
    pub number: u32,
    /// The numbers of its corners, in the direction of the border.
    pub corners: [u32; 2],
    /// Its line, from the lesser corner to the greater.
    line: u32,
}

impl BoundaryEdge {
    /// Whether it runs from the greater corner to the lesser.
    pub fn back(&self) -> bool {
        self.corners[0] > self.corners[1]
    }

    /// The same edge run along the other way.
    pub fn reversed(self) -> Self {
        Self {
            corners: [self.corners[1], self.corners[0]],
            ..self
        }
    }
}

/// An edge of the border of a fused occluder.
pub struct Limit {
    pub edge: BoundaryEdge,
    /// The rays and lines of the region on its inner side, and their number.
    pub inside: Bits,
    pub count: u32,
    /// Whether no occluder can be added across it.
    pub last: bool,
}

/// For each line, which rays and sampled lines of the current region pass it on either side.
#[derive(Default)]
pub struct SideBitsets {
    /// The number of the current region, and the number of its rays and lines.
    region: u32,
    rays: usize,
    /// Corners of the scene in the frame, by number.
    corners: FxHashMap<u32, DVec3>,
    /// Lines by their corners, the lesser first.
    numbers: FxHashMap<[u32; 2], u32>,
    lines: Vec<[f64; 6]>,
    rows: Vec<Row>,
    /// The range of an occluder's edges in `edges`.
    shapes: FxHashMap<OccluderId, Range<usize>>,
    edges: Vec<BoundaryEdge>,
    forms: Vec<f64>,
}

#[derive(Clone, Copy, Default)]
struct Row {
    region: u32,
    /// Rays on the positive side and on the negative side; rays on the line are in both sets.
    sides: [Bits; 2],
}

/// Initial capacity for corners and lines; most pairs need few more.
const FEW: usize = 64;

impl SideBitsets {
    /// Empty tables.
    pub fn new() -> Self {
        Self {
            corners: with_room(FEW),
            numbers: with_room(FEW),
            shapes: with_room(FEW / 4),
            lines: Vec::with_capacity(FEW),
            rows: Vec::with_capacity(FEW),
            edges: Vec::with_capacity(FEW),
            ..Self::default()
        }
    }

    /// Starts a region with this number of rays and lines.
    pub fn begin(&mut self, rays: usize) {
        self.region += 1;
        self.rays = rays.min(MOST);
    }

    /// All rays.
    pub fn all(&self) -> Bits {
        std::array::from_fn(|k| match self.rays.saturating_sub(64 * k) {
            n @ 0..64 => (1 << n) - 1,
            _ => u64::MAX,
        })
    }

    /// The range of an occluder's edges, in the order of its border.
    pub fn shape(&mut self, scene: &Occluders, frame: &Frame, id: OccluderId) -> Range<usize> {
        if let Some(known) = self.shapes.get(&id) {
            return known.clone();
        }
        let occluder = scene.occluder(id);
        let from = self.edges.len();
        for (number, (corners, at)) in
            (scene.boundary_edges().first(id)..).zip(occluder.edges.iter().zip(&occluder.border))
        {
            let key = [corners[0].min(corners[1]), corners[0].max(corners[1])];
            let line = match self.numbers.get(&key) {
                Some(line) => *line,
                None => {
                    let mut place = |k: usize| {
                        *self
                            .corners
                            .entry(corners[k])
                            .or_insert_with(|| frame.near(at[k].as_dvec3()))
                    };
                    let (a, b) = (place(0), place(1));
                    let (a, b) = if corners[0] > corners[1] {
                        (b, a)
                    } else {
                        (a, b)
                    };
                    let (d, m) = (b - a, a.cross(b));
                    self.lines
                        .push(normalised([d.x, d.y, d.z, m.x, m.y, m.z]).0);
                    self.rows.push(Row::default());
                    let line = (self.lines.len() - 1) as u32;
                    self.numbers.insert(key, line);
                    line
                }
            };
            self.edges.push(BoundaryEdge {
                number,
                corners: *corners,
                line,
            });
        }
        let range = from..self.edges.len();
        self.shapes.insert(id, range.clone());
        range
    }

    /// The edges in a range.
    pub fn edges(&self, of: Range<usize>) -> &[BoundaryEdge] {
        &self.edges[of]
    }

    /// The rays on the positive side of an edge or, if `negative`, on its negative side.
    pub fn inside(&mut self, forms: &Forms, edge: BoundaryEdge, negative: bool) -> Bits {
        self.row(forms, edge.line)[usize::from(edge.back() != negative)]
    }

    /// The rays on the positive side and on the negative side of the line with this number.
    pub fn row(&mut self, forms: &Forms, line: u32) -> [Bits; 2] {
        let at = line as usize;
        if self.rows[at].region != self.region {
            let line = self.lines[at];
            let sides = self.sides_of(forms, &line);
            self.rows[at] = Row {
                region: self.region,
                sides,
            };
        }
        self.rows[at].sides
    }

    /// The rays on the positive side and on the negative side of a line; rays nearly on the line are in both
    /// sets.
    pub fn sides_of(&mut self, forms: &Forms, line: &[f64; 6]) -> [Bits; 2] {
        forms.against(line, &mut self.forms);
        let mut sides = [[0; 4]; 2];
        for (k, chunk) in self.forms[..self.rays].chunks(64).enumerate() {
            let (mut below, mut above) = (0, 0);
            for (i, s) in chunk.iter().enumerate() {
                // The sign bits are used to avoid branches.
                below |= ((s + ON).to_bits() >> 63) << i;
                above |= ((ON - s).to_bits() >> 63) << i;
            }
            let all = u64::MAX >> (64 - chunk.len());
            (sides[0][k], sides[1][k]) = (all & !below, all & !above);
        }
        sides
    }

    /// The number of the line between two corners, which runs from the lesser to the greater, if it is in the
    /// table.
    pub fn line(&self, corners: [u32; 2]) -> Option<u32> {
        self.numbers
            .get(&[corners[0].min(corners[1]), corners[0].max(corners[1])])
            .copied()
    }
}

/// The intersection of two sets.
pub fn both(a: Bits, b: Bits) -> Bits {
    std::array::from_fn(|k| a[k] & b[k])
}

/// The number of rays in a set.
pub fn count(of: Bits) -> u32 {
    of.iter().map(|b| b.count_ones()).sum()
}
