//! Side bitsets: for each boundary edge, the side on which the rays of a region and the sampled lines inside
//! the region pass.
//!
//! Side bitsets rank occluders by the part of a region that they block. They are rounded and have no error
//! bounds, because the ranking affects the time of a query but never its verdict. Edges are plain doubles in
//! this module, and only the edges of the chosen occluder become lines of the space.

use std::ops::Range;

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::arithmetic::number::normalised;
use crate::geometry::frame::Frame;
use crate::line_space::forms::Forms;
use crate::occluders::{OccluderId, Occluders};
use crate::search::maps::with_room;

/// A set of a region's rays and sampled lines, one bit each.
///
/// Rays and lines beyond the first 256 are ignored; few regions have more.
pub type LineBits = [u64; 4];
/// The capacity of a [`LineBits`].
const MOST: usize = 256;
/// The largest magnitude of a form that counts as 0; no component of either vector exceeds 1.
const ON: f64 = 1e-12;

/// An edge in the border of an occluder or of a fused occluder.
#[derive(Clone, Copy, Debug, Default)]
pub struct BoundaryEdge {
    /// The number of the edge in the scene ([`crate::occluders::boundary_edges::BoundaryEdges`]).
    pub number: u32,
    /// The corner numbers of the edge, in the direction of the border.
    pub corners: [u32; 2],
    /// The number of the edge's line, which runs from the lower corner number to the higher.
    line: u32,
}

impl BoundaryEdge {
    /// Returns true if the edge runs from the higher corner number to the lower.
    pub fn back(&self) -> bool {
        self.corners[0] > self.corners[1]
    }

    /// Returns the edge in the opposite direction.
    pub fn reversed(self) -> Self {
        Self {
            corners: [self.corners[1], self.corners[0]],
            ..self
        }
    }
}

/// An edge of the border of a fused occluder.
pub struct FusedEdge {
    pub edge: BoundaryEdge,
    /// The rays and sampled lines of the region on the edge's inner side.
    pub inside: LineBits,
    /// The number of rays and lines in `inside`.
    pub count: u32,
    /// True if no occluder can be added across the edge.
    pub last: bool,
}

/// For each line of a boundary edge, the rays and sampled lines of the current region on either side of the
/// line.
#[derive(Default)]
pub struct SideBitsets {
    /// The number of regions started so far, which identifies the current region.
    region: u32,
    /// The number of rays and sampled lines of the current region, at most 256.
    rays: usize,
    /// The rounded positions of corners in the frame, by corner number.
    corners: FxHashMap<u32, DVec3>,
    /// The number of each line: its index in `lines` and `rows`. The key contains the corner numbers of the
    /// line, the lower number first.
    numbers: FxHashMap<[u32; 2], u32>,
    lines: Vec<[f64; 6]>,
    rows: Vec<Row>,
    /// For each occluder, the range of its edges in `edges`.
    shapes: FxHashMap<OccluderId, Range<usize>>,
    edges: Vec<BoundaryEdge>,
    forms: Vec<f64>,
}

#[derive(Clone, Copy, Default)]
struct Row {
    region: u32,
    /// The rays and sampled lines on the positive side and on the negative side. Rays and lines that meet the
    /// line are in both sets.
    sides: [LineBits; 2],
}

/// The initial capacity for corners and lines; most pairs need few more.
const FEW: usize = 64;

impl SideBitsets {
    /// Creates empty tables.
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

    /// Starts a new region with the given number of rays and sampled lines. Bitsets of earlier regions become
    /// invalid.
    pub fn begin(&mut self, rays: usize) {
        self.region += 1;
        self.rays = rays.min(MOST);
    }

    /// Returns the set of all rays and lines of the region.
    pub fn all(&self) -> LineBits {
        std::array::from_fn(|k| match self.rays.saturating_sub(64 * k) {
            n @ 0..64 => (1 << n) - 1,
            _ => u64::MAX,
        })
    }

    /// Returns the range of an occluder's edges for [`SideBitsets::edges`], in the order of the occluder's
    /// border.
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

    /// Returns the edges in a range that [`SideBitsets::shape`] returned.
    pub fn edges(&self, range: Range<usize>) -> &[BoundaryEdge] {
        &self.edges[range]
    }

    /// Returns the rays and sampled lines on the positive side of an edge or, if `negative` is true, on its
    /// negative side.
    pub fn inside(&mut self, forms: &Forms, edge: BoundaryEdge, negative: bool) -> LineBits {
        self.row(forms, edge.line)[usize::from(edge.back() != negative)]
    }

    /// Returns the rays and sampled lines on the positive side and on the negative side of the line with the
    /// number `line`.
    pub fn row(&mut self, forms: &Forms, line: u32) -> [LineBits; 2] {
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

    /// Computes the rays and sampled lines on the positive side and on the negative side of a line.
    ///
    /// Rays and sampled lines that nearly meet the line are in both sets.
    pub fn sides_of(&mut self, forms: &Forms, line: &[f64; 6]) -> [LineBits; 2] {
        forms.against(line, &mut self.forms);
        let mut sides = [[0; 4]; 2];
        for (k, chunk) in self.forms[..self.rays].chunks(64).enumerate() {
            let (mut below, mut above) = (0, 0);
            for (i, s) in chunk.iter().enumerate() {
                // The code uses the sign bits to avoid branches.
                below |= ((s + ON).to_bits() >> 63) << i;
                above |= ((ON - s).to_bits() >> 63) << i;
            }
            let all = u64::MAX >> (64 - chunk.len());
            (sides[0][k], sides[1][k]) = (all & !below, all & !above);
        }
        sides
    }

    /// Returns the number of the line between two corners, or `None` if the table does not contain the line.
    ///
    /// The line runs from the lower corner number to the higher.
    pub fn line(&self, corners: [u32; 2]) -> Option<u32> {
        self.numbers
            .get(&[corners[0].min(corners[1]), corners[0].max(corners[1])])
            .copied()
    }
}

/// Returns the intersection of two sets.
pub fn both(a: LineBits, b: LineBits) -> LineBits {
    std::array::from_fn(|k| a[k] & b[k])
}

/// Returns the number of rays and lines in a set.
pub fn count(bits: LineBits) -> u32 {
    bits.iter().map(|b| b.count_ones()).sum()
}
