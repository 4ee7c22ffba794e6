//! Convex regions in doubles, each with a bound on how far the true region reaches beyond it.
//!
//! A portal that is clipped again and again would need ever longer exact numbers. Here every region R is
//! known by corners in doubles and a slack s, so that each point of R is within s of the hull of the corners,
//! and by a box that holds R without slack. Let h be a function of at most unit slope. A point of R with
//! h ≥ 0 is within s of a point of the hull with h ≥ −s, so R ∩ {h ≥ 0} is known by the part of the hull with
//! h ≥ −s and the same slack.
//!
//! A polygon is clipped along its border alone. Its corners are within some d of its plane, and it is convex
//! up to such a distance; R is in the plane, within e of the corners' projections, with e + d ≤ s. A point of
//! R with h ≥ 0 is then within e of a point of the projected polygon with h ≥ −e, and the border between
//! corners has heights that differ from the projected ones by at most d: what is dropped below −s is not
//! needed. Clipping there, at a level below by the error of h, adds the rounding of the new corners to d and
//! to the slack. Nothing is ever cut off that is lit; slacks stay near the resolution of doubles at the
//! scene's greatest coordinate.

use glam::{DVec2, DVec3};
use sightline_exact::{Polygon, Source, polygon};
use sightline_geometry::rounding::UNIT as U;

use crate::plane::{Plane, PlaneId};

/// Most corners; what would have more is not clipped.
const MOST_CORNERS: usize = 16;
/// Normals are at most this long.
const LENGTH: f64 = 1.01;

/// The errors of doubles in a scene.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// The greatest magnitude of a coordinate.
    size: f64,
}

impl Errors {
    /// For points with coordinates of at most `size`.
    pub fn new(size: f64) -> Self {
        Self { size }
    }

    /// The greatest error of a height: a normal of at most `LENGTH` times a point, three products and three
    /// sums, less a level of at most twice their size. Each of the seven roundings is at most u of
    /// 1.01·√3·size or of twice that.
    pub fn height(self) -> f64 {
        32.0 * U * self.size
    }

    /// How far a new corner is from the place between two others that it stands for: each coordinate has
    /// three roundings of at most 2u of the size.
    pub fn corner(self) -> f64 {
        16.0 * U * self.size
    }
}

/// A closed half-space n·x ≥ level, exact for these doubles.
#[derive(Clone, Copy, Debug)]
pub struct HalfSpace {
    /// At most `LENGTH` long.
    normal: DVec3,
    level: f64,
    /// The axis along which the normal is ±1, and whether it is +1.
    across: Option<(usize, bool)>,
}

impl HalfSpace {
    /// The half-space; `None` when the normal is too long, or not finite.
    pub fn new(normal: DVec3, level: f64) -> Option<Self> {
        let length = normal.length_squared();
        let is_fine = (0.99..=1.0 + 1e-3).contains(&length) && level.is_finite();
        is_fine.then_some(Self {
            normal,
            level,
            across: None,
        })
    }

    /// The points whose coordinate along an axis is at least (`is_up`) or at most `at`.
    pub fn across(axis: usize, is_up: bool, at: f64) -> Self {
        let mut normal = DVec3::ZERO;
        normal[axis] = if is_up { 1.0 } else { -1.0 };
        Self {
            normal,
            level: if is_up { at } else { -at },
            across: Some((axis, is_up)),
        }
    }

    /// The half-space on one side of a plane, or one that holds it.
    pub fn beside(plane: &Plane, is_above: bool, errors: Errors) -> Option<Self> {
        let axis = plane.axis();
        let up = plane.normal()[axis] > 0.0;
        if let Some(level) = plane.across() {
            return Some(Self::across(axis, up == is_above, level));
        }
        // Scaled first, so that no square overflows.
        let coefficients = plane.rounded();
        let most = coefficients[axis].abs();
        let [a, b, c, k] = coefficients.map(|x| x / most);
        let length = DVec3::new(a, b, c).length();
        let turn = if is_above { 1.0 } else { -1.0 };
        // The coefficients are off by u of themselves, and the quotients by 3u more.
        Self::new(
            DVec3::new(a, b, c) / length * turn,
            k / length * turn - errors.height(),
        )
    }

    /// The normal; it points inside.
    pub fn normal(&self) -> DVec3 {
        self.normal
    }

    /// The height of a point above the border, rounded.
    pub fn height(&self, at: DVec3) -> f64 {
        self.normal.dot(at) - self.level
    }
}

/// A convex region: the hull of some points, with slack.
#[derive(Clone, Debug)]
pub struct Hull {
    /// The corners.
    pub corners: Vec<DVec3>,
    /// How far the region may reach beyond the corners' hull.
    pub slack: f64,
    /// A box that holds the region.
    pub bounds: [DVec3; 2],
}

impl Hull {
    /// The hull of points, given exactly.
    pub fn of(points: &mut dyn Iterator<Item = &Source>) -> Self {
        let mut hull = Self {
            corners: Vec::new(),
            slack: 0.0,
            bounds: [DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY)],
        };
        for point in points {
            let at = polygon::rounded(point);
            // A rounded coordinate is off by at most 3u of itself; one that is exact has no error.
            let error = polygon::is_rounded(point).map(|is| if is { 1.0 } else { 0.0 });
            let error = DVec3::from(error) * at.abs() * (4.0 * U);
            // A sum is off by u of itself, which 4u instead of 3u covers.
            hull.bounds = [
                hull.bounds[0].min(at - error),
                hull.bounds[1].max(at + error),
            ];
            hull.slack = hull.slack.max(2.0 * error.max_element());
            if !hull.corners.contains(&at) {
                hull.corners.push(at);
            }
        }
        hull
    }

    /// Whether the region certainly has no inside in a half-space.
    fn is_outside(&self, of: &HalfSpace, errors: Errors) -> bool {
        if let Some((axis, is_up)) = of.across {
            let far = if is_up {
                self.bounds[1][axis]
            } else {
                -self.bounds[0][axis]
            };
            if far <= of.level {
                return true;
            }
        }
        let least = self.slack * LENGTH + errors.height();
        self.corners.iter().all(|c| of.height(*c) < -least)
    }

    /// Whether the region certainly is in a half-space.
    pub fn is_inside(&self, of: &HalfSpace, errors: Errors) -> bool {
        if let Some((axis, is_up)) = of.across {
            let near = if is_up {
                self.bounds[0][axis]
            } else {
                -self.bounds[1][axis]
            };
            if near >= of.level {
                return true;
            }
        }
        let least = self.slack * LENGTH + errors.height();
        self.corners.iter().all(|c| of.height(*c) >= least)
    }
}

/// A convex polygon with slack, in a plane.
#[derive(Clone, Debug)]
pub struct Outline {
    /// The corners in order, and the slack.
    pub hull: Hull,
    /// The axis along which it is projected: that along which the normal is longest.
    axis: usize,
    /// How far a corner may be off the plane.
    off: f64,
    /// The plane that it is in, if it is one of the scene's.
    pub plane: Option<PlaneId>,
}

impl Outline {
    /// The outline of a polygon.
    pub fn around(polygon: &Polygon, normal: DVec3, plane: Option<PlaneId>) -> Self {
        let n = normal.abs();
        let axis = (1..3).fold(0, |best, k| if n[k] > n[best] { k } else { best });
        let hull = Hull::of(&mut polygon.points().iter());
        Self {
            off: hull.slack,
            hull,
            axis,
            plane,
        }
    }

    /// The part inside some half-spaces; `None` when there is certainly none with an area.
    pub fn within(&self, beam: &[HalfSpace], errors: Errors) -> Option<Self> {
        // Most polygons are outside of one of them, which is found without any cut.
        if beam.iter().any(|half| self.hull.is_outside(half, errors)) {
            return None;
        }
        let mut part: Option<Self> = None;
        for half in beam {
            let at = part.as_ref().unwrap_or(self);
            if at.hull.is_outside(half, errors) {
                return None;
            }
            if let Some(cut) = at.cut_by(half, errors) {
                part = Some(cut);
            }
        }
        Some(part.unwrap_or_else(|| self.clone()))
    }

    /// The part inside a half-space that it is not outside of; `None` when that is all of it, or is not
    /// known.
    fn cut_by(&self, of: &HalfSpace, errors: Errors) -> Option<Self> {
        let hull = &self.hull;
        let n = hull.corners.len();
        if n >= MOST_CORNERS || hull.is_inside(of, errors) {
            return None;
        }
        let level = -(hull.slack * LENGTH + 2.0 * errors.height());
        let heights: Vec<f64> = hull.corners.iter().map(|c| of.height(*c) - level).collect();
        if heights.iter().all(|h| *h >= 0.0) {
            return None;
        }
        let mut corners = Vec::with_capacity(n + 1);
        for i in 0..n {
            let j = (i + 1) % n;
            if heights[i] >= 0.0 {
                corners.push(hull.corners[i]);
            }
            if (heights[i] >= 0.0) != (heights[j] >= 0.0) {
                let (inside, outside) = if heights[i] >= 0.0 { (i, j) } else { (j, i) };
                corners.push(cut(
                    of,
                    level,
                    [hull.corners[inside], hull.corners[outside]],
                    [heights[inside], heights[outside]],
                ));
            }
        }
        corners.dedup();
        let slack = hull.slack + errors.corner();
        // The region is in the old box, and within the slack of the new corners.
        let around = |[lo, hi]: [DVec3; 2], c: &DVec3| [lo.min(*c), hi.max(*c)];
        let [lo, hi] = corners
            .iter()
            .fold([DVec3::INFINITY, DVec3::NEG_INFINITY], around);
        let wide = DVec3::splat(slack + errors.corner());
        let mut bounds = [hull.bounds[0].max(lo - wide), hull.bounds[1].min(hi + wide)];
        if let Some((axis, is_up)) = of.across {
            let end = usize::from(!is_up);
            let at = if is_up { of.level } else { -of.level };
            bounds[end][axis] = if is_up {
                bounds[end][axis].max(at)
            } else {
                bounds[end][axis].min(at)
            };
        }
        let off = self.off + errors.corner();
        Some(Self {
            hull: Hull {
                corners,
                slack,
                bounds,
            },
            off,
            ..*self
        })
    }

    /// The same outline with slack for [`Self::holds`] to find that others are inside.
    #[must_use]
    pub fn widened(mut self, errors: Errors) -> Self {
        self.hull.slack += 4.0 * self.off + 128.0 * errors.corner();
        self
    }

    /// Whether both are in the same plane of the scene.
    pub fn is_beside(&self, other: &Self) -> bool {
        self.plane.is_some() && self.plane == other.plane
    }

    /// Whether another part of the same plane is certainly inside this one.
    ///
    /// Both are compared in the projection. The longest component of a unit normal is at least 1/√3, so a
    /// place that is off by t in the projection is off by √3t in the plane, and corners that are off the
    /// plane by d and d' are apart by at most √3(d + d') beside. 2 stands for √3.
    pub fn holds(&self, other: &Self, errors: Errors) -> bool {
        let (own, its) = (&self.hull, &other.hull);
        let near = errors.corner();
        let apart = 2.0 * (2.0 * near + self.off + other.off);
        let is_around =
            own.bounds[0].cmple(its.bounds[0]).all() && own.bounds[1].cmpge(its.bounds[1]).all();
        if is_around
            && own.corners == its.corners
            && its.slack <= own.slack
            && other.off <= self.off
        {
            return true;
        }
        if !is_around || its.slack + apart > own.slack {
            return false;
        }
        let flat: Vec<DVec2> = own.corners.iter().map(|c| self.flat(*c)).collect();
        its.corners
            .iter()
            .all(|c| is_within(&flat, self.flat(*c), near))
    }

    /// The hull with another part of the same plane, up to the errors that [`Self::holds`] explains.
    #[must_use]
    pub fn joined(&self, other: &Self, errors: Errors) -> Self {
        let (own, its) = (&self.hull, &other.hull);
        let near = errors.corner();
        let all: Vec<DVec3> = own.corners.iter().chain(&its.corners).copied().collect();
        // Each corner that is dropped is within two roundings of an edge of those that are left then.
        let dropped = 2.0 * (2.0 * near * all.len() as f64 + self.off + other.off);
        let hull = Hull {
            corners: self.around_all(all),
            slack: own.slack.max(its.slack) + dropped,
            bounds: [
                own.bounds[0].min(its.bounds[0]),
                own.bounds[1].max(its.bounds[1]),
            ],
        };
        Self {
            hull,
            off: self.off.max(other.off),
            ..*self
        }
    }

    /// The corners of the convex hull of points in the outline's plane (Andrew 1979).
    fn around_all(&self, mut all: Vec<DVec3>) -> Vec<DVec3> {
        all.sort_by(|a, b| {
            let (a, b) = (self.flat(*a), self.flat(*b));
            a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y))
        });
        all.dedup_by(|a, b| self.flat(*a) == self.flat(*b));
        let half = |points: &mut dyn Iterator<Item = DVec3>| {
            let mut chain: Vec<DVec3> = Vec::new();
            for p in points {
                while let [.., a, b] = chain[..] {
                    let (a, b) = (self.flat(a), self.flat(b));
                    if (b - a).perp_dot(self.flat(p) - a) > 0.0 {
                        break;
                    }
                    chain.pop();
                }
                chain.push(p);
            }
            chain.pop();
            chain
        };
        let mut found = half(&mut all.iter().copied());
        found.extend(half(&mut all.iter().rev().copied()));
        if found.is_empty() { all } else { found }
    }

    fn flat(&self, p: DVec3) -> DVec2 {
        DVec2::new(p[(self.axis + 1) % 3], p[(self.axis + 2) % 3])
    }
}

/// Whether a point is certainly inside a convex polygon, or within `near` of one of its edges, up to their
/// rounding.
fn is_within(polygon: &[DVec2], p: DVec2, near: f64) -> bool {
    let n = polygon.len();
    let edges = || (0..n).map(|k| (polygon[k], polygon[(k + 1) % n]));
    let turns = edges().map(|(a, b)| (b - a).perp_dot(p - a) / (b - a).length());
    let is_inside = |least: f64, most: f64| least > near || most < -near;
    let (least, most) = turns.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), t| {
        (l.min(t), m.max(t))
    });
    let from_edge = |(a, b): (DVec2, DVec2)| {
        let along = b - a;
        let t = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        (p - a - along * t).length()
    };
    is_inside(least, most) || edges().any(|edge| from_edge(edge) <= near)
}

/// A place on an edge at or below a level, given the ends and their heights above it: inside, then outside.
fn cut(of: &HalfSpace, level: f64, [p, q]: [DVec3; 2], [at_p, at_q]: [f64; 2]) -> DVec3 {
    let mut t = at_p / (at_p - at_q);
    for _ in 0..3 {
        let at = p + (q - p) * t;
        if t < 1.0 && of.height(at) <= level {
            return at;
        }
        t += (1.0 - t) * 1e-6 + 1e-12;
    }
    q
}
