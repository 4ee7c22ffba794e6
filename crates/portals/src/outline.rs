//! Convex regions in doubles, each with a bound on how far the true region reaches beyond it.
//!
//! If a portal is clipped repeatedly, its exact corners need ever longer numbers. So this module represents a
//! region R by corners in doubles and a slack s: each point of R is within s of the hull of the corners. A
//! box that contains R without slack complements them. Let h be a function of at most unit slope. A point of
//! R with h ≥ 0 is within s of a point of the hull with h ≥ −s. So the part of the hull with h ≥ −s and the
//! same slack represents R ∩ {h ≥ 0}.
//!
//! A polygon is clipped only along its border. Its corners are within some distance d of its plane, and it is
//! convex up to such a distance. R is in the plane, within e of the corners' projections, with e + d ≤ s. A
//! point of R with h ≥ 0 is then within e of a point of the projected polygon with h ≥ −e. Between corners,
//! the heights of the border differ from the projected heights by at most d, so the part below −s is not
//! needed. Clipping at a level that is lower by the error of h adds the rounding of the new corners to d and
//! to the slack. Clipping never removes a point of R with h ≥ 0. Slacks stay near the resolution of doubles
//! at the scene's largest coordinate.

use glam::{DVec2, DVec3};
use sightline_exact::{PointOrigin, Polygon, polygon};
use sightline_geometry::rounding::UNIT as U;

use crate::plane::{Plane, PlaneId};

/// The maximum number of corners. A polygon that would get more corners is not clipped.
const MOST_CORNERS: usize = 16;
/// The maximum length of a normal.
const LENGTH: f64 = 1.01;

/// Bounds on the rounding errors of computations with points of a scene in doubles.
#[derive(Clone, Copy, Debug)]
pub struct ErrorBounds {
    /// The largest magnitude of a coordinate.
    size: f64,
}

impl ErrorBounds {
    /// Creates the error bounds for points with coordinates of magnitude at most `size`.
    pub fn new(size: f64) -> Self {
        Self { size }
    }

    /// Returns the largest error of the height of a point above a half-space's border.
    ///
    /// The height is the product of a normal of length at most `LENGTH` and a point (three products and three
    /// sums), less a level of at most twice their size. Each of the seven roundings is at most u of
    /// 1.01·√3·size or of twice that.
    pub fn height(self) -> f64 {
        32.0 * U * self.size
    }

    /// Returns the largest distance of a new corner, computed on the edge between two corners, from the exact
    /// point on that edge.
    ///
    /// Each coordinate has three roundings of at most 2u of the size.
    pub fn corner(self) -> f64 {
        16.0 * U * self.size
    }
}

/// A closed half-space n·x ≥ level, exact for these doubles.
#[derive(Clone, Copy, Debug)]
pub struct HalfSpace {
    /// The normal n, which points inside and has at most the length `LENGTH`.
    normal: DVec3,
    level: f64,
    /// The axis along which the normal is ±1, and true if it is +1.
    across: Option<(usize, bool)>,
}

impl HalfSpace {
    /// Creates a half-space from its normal and level.
    ///
    /// The result is `None` unless the squared length of the normal is from 0.99 to 1.001 and the level is
    /// finite.
    pub fn new(normal: DVec3, level: f64) -> Option<Self> {
        let length = normal.length_squared();
        let is_fine = (0.99..=1.0 + 1e-3).contains(&length) && level.is_finite();
        is_fine.then_some(Self {
            normal,
            level,
            across: None,
        })
    }

    /// Creates the half-space of the points whose coordinate along an axis is bounded by `at`.
    ///
    /// The coordinate is at least `at` if `is_up` is true, and at most `at` otherwise.
    pub fn across(axis: usize, is_up: bool, at: f64) -> Self {
        let mut normal = DVec3::ZERO;
        normal[axis] = if is_up { 1.0 } else { -1.0 };
        Self {
            normal,
            level: if is_up { at } else { -at },
            across: Some((axis, is_up)),
        }
    }

    /// Creates the half-space above (`is_above` is true) or below a plane, or a slightly larger half-space
    /// that contains it. The result is `None` if doubles cannot represent the half-space.
    pub fn beside(plane: &Plane, is_above: bool, errors: ErrorBounds) -> Option<Self> {
        let axis = plane.axis();
        let up = plane.normal()[axis] > 0.0;
        if let Some(level) = plane.across() {
            return Some(Self::across(axis, up == is_above, level));
        }
        // Scale the coefficients first, so that no square overflows.
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

    /// Returns the normal, which points inside.
    pub fn normal(&self) -> DVec3 {
        self.normal
    }

    /// Computes the rounded height of a point above the half-space's border; the height is negative outside.
    pub fn height(&self, at: DVec3) -> f64 {
        self.normal.dot(at) - self.level
    }
}

/// A convex region: the hull of some points, with slack.
#[derive(Clone, Debug)]
pub struct Hull {
    /// The corners.
    pub corners: Vec<DVec3>,
    /// The maximum distance of the region's points from the corners' hull.
    pub slack: f64,
    /// A box that contains the region without slack.
    pub bounds: [DVec3; 2],
}

impl Hull {
    /// Computes the hull of points that are given exactly.
    pub fn from_points(points: &mut dyn Iterator<Item = &PointOrigin>) -> Self {
        let mut hull = Self {
            corners: Vec::new(),
            slack: 0.0,
            bounds: [DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY)],
        };
        for point in points {
            let at = polygon::rounded(point);
            // A rounded coordinate is off by at most 3u of itself; an exact coordinate has no error.
            let error = polygon::is_rounded(point).map(|is| if is { 1.0 } else { 0.0 });
            let error = DVec3::from(error) * at.abs() * (4.0 * U);
            // The sum is off by u of itself, which the factor 4u instead of 3u covers.
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

    /// Returns true if the region certainly does not reach into the interior of a half-space.
    fn is_outside(&self, half_space: &HalfSpace, errors: ErrorBounds) -> bool {
        if let Some((axis, is_up)) = half_space.across {
            let far = if is_up {
                self.bounds[1][axis]
            } else {
                -self.bounds[0][axis]
            };
            if far <= half_space.level {
                return true;
            }
        }
        let least = self.slack * LENGTH + errors.height();
        self.corners.iter().all(|c| half_space.height(*c) < -least)
    }

    /// Returns true if the region certainly is inside a half-space.
    pub fn is_inside(&self, half_space: &HalfSpace, errors: ErrorBounds) -> bool {
        if let Some((axis, is_up)) = half_space.across {
            let near = if is_up {
                self.bounds[0][axis]
            } else {
                -self.bounds[1][axis]
            };
            if near >= half_space.level {
                return true;
            }
        }
        let least = self.slack * LENGTH + errors.height();
        self.corners.iter().all(|c| half_space.height(*c) >= least)
    }
}

/// A convex polygon with slack, in a plane.
#[derive(Clone, Debug)]
pub struct Outline {
    /// The corners in order, and the slack.
    pub hull: Hull,
    /// The axis of the projection, along which the normal is longest.
    axis: usize,
    /// The maximum distance of a corner from the plane.
    off: f64,
    /// The plane of the polygon, if it is a plane of the scene.
    pub plane: Option<PlaneId>,
}

impl Outline {
    /// Creates the outline of a polygon.
    pub fn around(polygon: &Polygon, normal: DVec3, plane: Option<PlaneId>) -> Self {
        let n = normal.abs();
        let axis = (1..3).fold(0, |best, k| if n[k] > n[best] { k } else { best });
        let hull = Hull::from_points(&mut polygon.points().iter());
        Self {
            off: hull.slack,
            hull,
            axis,
            plane,
        }
    }

    /// Returns an outline of the part inside all half-spaces of `beam`, or `None` if this part certainly has
    /// no area.
    pub fn within(&self, beam: &[HalfSpace], errors: ErrorBounds) -> Option<Self> {
        // Most polygons are outside of one half-space. This test finds that half-space without a cut.
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

    /// Returns an outline of the part inside a half-space. The outline must not be certainly outside of the
    /// half-space.
    ///
    /// The result is `None` if the function does not cut the outline, because no corner is certainly outside
    /// or the outline has too many corners.
    fn cut_by(&self, half_space: &HalfSpace, errors: ErrorBounds) -> Option<Self> {
        let hull = &self.hull;
        let n = hull.corners.len();
        if n >= MOST_CORNERS || hull.is_inside(half_space, errors) {
            return None;
        }
        let level = -(hull.slack * LENGTH + 2.0 * errors.height());
        let heights: Vec<f64> = hull
            .corners
            .iter()
            .map(|c| half_space.height(*c) - level)
            .collect();
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
                    half_space,
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
        if let Some((axis, is_up)) = half_space.across {
            let end = usize::from(!is_up);
            let at = if is_up {
                half_space.level
            } else {
                -half_space.level
            };
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

    /// Returns this outline with additional slack, so that [`Self::holds`] can return true for other outlines
    /// inside it.
    #[must_use]
    pub fn widened(mut self, errors: ErrorBounds) -> Self {
        self.hull.slack += 4.0 * self.off + 128.0 * errors.corner();
        self
    }

    /// Returns true if both outlines are in the same plane of the scene.
    pub fn is_beside(&self, other: &Self) -> bool {
        self.plane.is_some() && self.plane == other.plane
    }

    /// Returns true if another outline in the same plane is certainly inside this outline. False means that
    /// this is unknown.
    ///
    /// The function compares both in the projection. The longest component of a unit normal is at least 1/√3,
    /// so a point that is off by t in the projection is off by √3t in the plane. Corners that are off the
    /// plane by d and d' are apart by at most √3(d + d') within the plane. The code uses 2 instead of √3.
    pub fn holds(&self, other: &Self, errors: ErrorBounds) -> bool {
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

    /// Computes an outline that contains this outline and another outline in the same plane, with slack for
    /// the errors that [`Self::holds`] explains.
    #[must_use]
    pub fn joined(&self, other: &Self, errors: ErrorBounds) -> Self {
        let (own, its) = (&self.hull, &other.hull);
        let near = errors.corner();
        let all: Vec<DVec3> = own.corners.iter().chain(&its.corners).copied().collect();
        // Each dropped corner is within two roundings of an edge of the corners that remained at that time.
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

    /// Returns the corners of the convex hull of points in the outline's plane (Andrew 1979).
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

/// Returns true if a point is certainly inside a convex polygon, or within `near` of an edge.
///
/// Both tests are correct up to the rounding of the polygon's corners.
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

/// Computes a point on an edge whose height is at most `level`.
///
/// The end `p` of the edge is inside and `q` outside; `at_p` and `at_q` are their heights above the level.
fn cut(half_space: &HalfSpace, level: f64, [p, q]: [DVec3; 2], [at_p, at_q]: [f64; 2]) -> DVec3 {
    let mut t = at_p / (at_p - at_q);
    for _ in 0..3 {
        let at = p + (q - p) * t;
        if t < 1.0 && half_space.height(at) <= level {
            return at;
        }
        t += (1.0 - t) * 1e-6 + 1e-12;
    }
    q
}
