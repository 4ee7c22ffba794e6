//! Bounds on the space that is lit from a convex body through a polygon, as separating planes (Teller 1992,
//! section 8.3.5).
//!
//! A separating plane has the body on one side and the polygon on the other. Beyond the polygon, every line
//! from the body through the polygon stays on the polygon's side: the height above the plane does not fall
//! between body and polygon, so it does not fall later. The tightest bounds are planes through an edge of one
//! and a corner of the other. Doubles do not represent such a plane exactly. So this module turns the plane
//! away from body and polygon by more than their slack and the plane's own rounding. It uses the plane only
//! if body and polygon are then certainly on different sides.

use glam::DVec3;
use sightline_numbers::Aabb;

use crate::outline::{ErrorBounds, HalfSpace, Hull};
use crate::solids::Solid;

/// The maximum difference between components of two unit normals at which the planes count as one.
///
/// Dropping a plane only makes the set larger.
const ALIKE: f64 = 1e-9;
/// The maximum angle by which the module turns a plane, in radians.
///
/// A larger angle would be needed only if the body and the polygon nearly touch; the plane is then not used.
const MOST_TURN: f64 = 1e-4;

/// The pairs of corners of a box that its edges join.
///
/// Corner k has the larger coordinate along axis i if bit i of k is set.
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

/// A convex body from which lines start.
#[derive(Clone, Debug)]
pub struct LineSource {
    /// The corners of the body.
    pub hull: Hull,
    /// For each edge, the indices of the corners that the edge joins, and a corner off the edge's line.
    edges: Vec<([usize; 2], DVec3)>,
}

impl LineSource {
    /// Creates a body from the bounding box of some solids, restricted to the box `within`. Returns `None` if
    /// `solids` is empty.
    pub fn around(solids: &mut dyn Iterator<Item = &Solid>, within: Aabb) -> Option<Self> {
        let faces = solids.flat_map(|solid| &solid.faces);
        let hull = Hull::from_points(&mut faces.flat_map(|face| face.polygon().points()));
        let [min, max] = [within.min, within.max].map(|p| p.as_dvec3());
        (!hull.corners.is_empty()).then(|| Self::of_box(hull.bounds.map(|p| p.clamp(min, max))))
    }

    /// Creates a body from a box, given by its lowest and highest corner.
    pub fn of_box(bounds: [DVec3; 2]) -> Self {
        let corner = |k: usize| DVec3::from([0, 1, 2].map(|i| bounds[k >> i & 1][i]));
        Self::from_edges(
            Hull {
                corners: (0..8).map(corner).collect(),
                slack: 0.0,
                bounds,
            },
            EDGES.into_iter(),
        )
    }

    /// Creates a body from a polygon whose corners are in order.
    pub fn of_polygon(hull: &Hull) -> Self {
        let n = hull.corners.len();
        Self::from_edges(hull.clone(), (0..n).map(|k| [k, (k + 1) % n]))
    }

    /// Creates a body from a hull and its edges, each given by the indices of the corners that the edge
    /// joins.
    fn from_edges(hull: Hull, edges: impl Iterator<Item = [usize; 2]>) -> Self {
        let corners = &hull.corners;
        let off =
            |edge: [usize; 2]| farthest(edge.map(|k| corners[k]), corners).map(|off| (edge, off));
        Self {
            edges: edges.filter_map(off).collect(),
            hull,
        }
    }
}

/// Appends the half-spaces that contain all lines from a body through a polygon, beyond the polygon.
pub fn separators(
    body: &LineSource,
    polygon: &Hull,
    errors: ErrorBounds,
    out: &mut Vec<HalfSpace>,
) {
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
    // Of all planes through an edge of one body, only the planes that touch the other body can be tight.
    for (edge, inner) in &body.edges {
        // The body is on one side of this plane, and the polygon must be on the other side.
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

/// Returns the corner that is farthest from the line through two points, or `None` if `corners` is empty.
fn farthest([a, b]: [DVec3; 2], corners: &[DVec3]) -> Option<DVec3> {
    let edge = b - a;
    let far = |c: &DVec3| edge.cross(*c - a).length_squared();
    corners
        .iter()
        .copied()
        .max_by(|p, q| far(p).total_cmp(&far(q)))
}

/// Returns the corner c for which the plane through an edge and c has no other corner on the side of `inner`.
///
/// If no such corner exists, the result is an arbitrary corner, so the caller must check the plane.
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

/// The half-spaces found so far between a body and a polygon.
struct BeamPlanes<'a> {
    body: &'a Hull,
    polygon: &'a Hull,
    errors: ErrorBounds,
    out: &'a mut Vec<HalfSpace>,
}

impl BeamPlanes<'_> {
    /// Adds the plane through an edge of one body and a corner of the other, if the plane separates them.
    ///
    /// `up` is 1 if `c` is a corner of the polygon, and −1 if `c` is a corner of the body.
    fn add(&mut self, [a, b]: [DVec3; 2], c: DVec3, up: f64) {
        let (edge, towards) = (b - a, c - a);
        let across = edge.cross(towards);
        let (length, edge_length) = (across.length(), edge.length());
        let apart = length / edge_length;
        let own = self.errors.height();
        // The gap is twice the required gap, so that rounding leaves enough.
        let gap = 2.0 * ((self.body.slack + self.polygon.slack) * 1.01 + 2.0 * own);
        let turn = gap / apart;
        // The condition is also false for points on a line, and if the edge and the corner coincide.
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
        // The polygon belongs on the upper side.
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

    /// Adds the half-space with the given normal that contains the polygon. Returns false, without adding the
    /// half-space, if the body is not certainly on the other side.
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
        // The body is certainly on the other side.
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
