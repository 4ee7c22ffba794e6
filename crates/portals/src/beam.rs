//! The space that is lit from a convex body through a polygon: bounds by separating planes (Teller 1992,
//! section 8.3.5).
//!
//! A plane with the body on one side and the polygon on the other keeps every line from the body through the
//! polygon on the polygon's side from there on: the height above it does not fall from the body to the
//! polygon, so it does not fall beyond. Planes through an edge of one and a corner of the other bound most.
//! Doubles do not hold such a plane exactly, so it is turned away from both by more than their slack and its
//! own rounding, and counts only if both are then certainly on their sides.

use glam::DVec3;
use sightline_numbers::Aabb;

use crate::outline::{Errors, HalfSpace, Hull};
use crate::solids::Solid;

/// Planes whose normals and levels differ by less than this are taken for one. Fewer planes hide less.
const ALIKE: f64 = 1e-9;
/// A plane is turned by at most this angle; farther apart, both have touched nearly.
const MOST_TURN: f64 = 1e-4;

/// The pairs of corners of a box that its edges join; corner k has the greater coordinate along axis i where
/// bit i of k is set.
const EDGES: [[usize; 2]; 12] = [
    [0, 1],
    [2, 3],
    [4, 5],
    [6, 7],
    [0, 2],
    [1, 3],
    [4, 6],
    [5, 7],
    [0, 4],
    [1, 5],
    [2, 6],
    [3, 7],
];

/// A convex body from which lines come.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its corners.
    pub hull: Hull,
    /// For each edge the corners that it joins, and one that is off its line.
    edges: Vec<([usize; 2], DVec3)>,
}

impl Body {
    /// The part of a box around some solids; `None` around none.
    pub fn around(solids: &mut dyn Iterator<Item = &Solid>, within: Aabb) -> Option<Self> {
        let faces = solids.flat_map(|solid| &solid.faces);
        let hull = Hull::of(&mut faces.flat_map(|face| face.polygon().points()));
        let [min, max] = [within.min, within.max].map(|p| p.as_dvec3());
        (!hull.corners.is_empty()).then(|| Self::of_box(hull.bounds.map(|p| p.clamp(min, max))))
    }

    /// A box.
    pub fn of_box(bounds: [DVec3; 2]) -> Self {
        let corner = |k: usize| DVec3::from([0, 1, 2].map(|i| bounds[k >> i & 1][i]));
        Self::of(
            Hull {
                corners: (0..8).map(corner).collect(),
                slack: 0.0,
                bounds,
            },
            EDGES.into_iter(),
        )
    }

    /// A polygon, by its corners in order.
    pub fn of_polygon(hull: &Hull) -> Self {
        let n = hull.corners.len();
        Self::of(hull.clone(), (0..n).map(|k| [k, (k + 1) % n]))
    }

    fn of(hull: Hull, edges: impl Iterator<Item = [usize; 2]>) -> Self {
        let corners = &hull.corners;
        let off =
            |edge: [usize; 2]| farthest(edge.map(|k| corners[k]), corners).map(|off| (edge, off));
        Self {
            edges: edges.filter_map(off).collect(),
            hull,
        }
    }
}

/// Adds the half-spaces that hold all lines from a body through a polygon, beyond the polygon.
pub fn separators(body: &Body, polygon: &Hull, errors: Errors, out: &mut Vec<HalfSpace>) {
    for axis in 0..3 {
        let [[b_lo, b_hi], [p_lo, p_hi]] =
            [&body.hull, polygon].map(|h| [h.bounds[0][axis], h.bounds[1][axis]]);
        if b_hi <= p_lo {
            out.push(HalfSpace::across(axis, true, p_lo));
        }
        if b_lo >= p_hi {
            out.push(HalfSpace::across(axis, false, p_hi));
        }
    }
    let mut planes = BeamPlanes {
        body: &body.hull,
        polygon,
        errors,
        out,
    };
    let through = &polygon.corners;
    // Of the planes through an edge, only the one that touches the other has it on one side.
    for (edge, inner) in &body.edges {
        // The body is on one side of it, and the polygon must be on the other.
        let edge = edge.map(|k| body.hull.corners[k]);
        planes.add(edge, touching(edge, through, *inner), 1.0);
    }
    let n = through.len();
    for k in 0..n {
        let edge = [through[k], through[(k + 1) % n]];
        let Some(inner) = farthest(edge, through) else {
            continue;
        };
        planes.add(edge, touching(edge, &body.hull.corners, inner), -1.0);
    }
}

/// The corner that is farthest from a line.
fn farthest([a, b]: [DVec3; 2], corners: &[DVec3]) -> Option<DVec3> {
    let edge = b - a;
    let far = |c: &DVec3| edge.cross(*c - a).length_squared();
    corners
        .iter()
        .copied()
        .max_by(|p, q| far(p).total_cmp(&far(q)))
}

/// The corner through which a plane through an edge has no corner on the side of `inner`, if there is one.
fn touching([a, b]: [DVec3; 2], corners: &[DVec3], inner: DVec3) -> DVec3 {
    let edge = b - a;
    let mut best = corners[0];
    for c in &corners[1..] {
        let normal = edge.cross(best - a);
        if normal.dot(*c - a) * normal.dot(inner - a) > 0.0 {
            best = *c;
        }
    }
    best
}

struct BeamPlanes<'a> {
    body: &'a Hull,
    polygon: &'a Hull,
    errors: Errors,
    out: &'a mut Vec<HalfSpace>,
}

impl BeamPlanes<'_> {
    /// Adds the plane through an edge of one and a corner of the other, if it has them on its two sides.
    /// `up` is 1 when the corner is the polygon's, −1 when it is the body's.
    fn add(&mut self, [a, b]: [DVec3; 2], c: DVec3, up: f64) {
        let (edge, towards) = (b - a, c - a);
        let across = edge.cross(towards);
        let (length, edge_length) = (across.length(), edge.length());
        let apart = length / edge_length;
        let own = self.errors.height();
        // Twice what is needed, so that rounding leaves enough.
        let gap = 2.0 * ((self.body.slack + self.polygon.slack) * 1.01 + 2.0 * own);
        let turn = gap / apart;
        // Also false for points on a line, and for none apart.
        if !(turn < MOST_TURN && length > 0.0) {
            return;
        }
        let normal = across / length;
        let mut heights = [f64::INFINITY, f64::NEG_INFINITY];
        for p in &self.polygon.corners {
            let height = normal.dot(*p - a);
            heights = [heights[0].min(height), heights[1].max(height)];
            if heights[0] < -gap && heights[1] > gap {
                return;
            }
        }
        // The polygon goes on the upper side.
        let side = if heights[1] > -heights[0] { 1.0 } else { -1.0 };
        let along = edge / edge_length;
        let out = (towards - along * towards.dot(along)) / apart;
        for side in if heights[1] - heights[0] <= 2.0 * gap {
            [side, -side]
        } else {
            [side, side]
        } {
            let normal = normal * side + out * (turn * up);
            if self.take(normal) {
                return;
            }
        }
    }

    fn take(&mut self, normal: DVec3) -> bool {
        let own = self.errors.height();
        let below = self
            .body
            .corners
            .iter()
            .map(|p| normal.dot(*p))
            .fold(f64::NEG_INFINITY, f64::max);
        let above = self
            .polygon
            .corners
            .iter()
            .map(|p| normal.dot(*p))
            .fold(f64::INFINITY, f64::min);
        let level = above - self.polygon.slack * 1.01 - own;
        // The body is on the other side for certain.
        let is_apart = below + self.body.slack * 1.01 + own <= level;
        if !is_apart {
            return false;
        }
        let Some(half) = HalfSpace::new(normal, level) else {
            return false;
        };
        if !self
            .out
            .iter()
            .any(|known| (known.normal() - normal).abs().max_element() < ALIKE)
        {
            self.out.push(half);
        }
        true
    }
}
