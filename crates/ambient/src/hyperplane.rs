//! The hyperplanes of occluders' edges, and a test of the side on which all rays from a source to an item
//! pass an edge.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::hull::Hull;
use crate::polygon::Plane;
use crate::receivers::ReceiverHull;

/// The side of a hyperplane on which the rays to an item pass.
pub enum PassingSide {
    /// All rays pass inside the hyperplane.
    Inside,
    /// All rays pass outside the hyperplane.
    Outside,
    /// Rays pass on both sides, or doubles cannot decide.
    Both,
}

/// The number of source corners that are tested together. A source has one, two, four or eight corners.
const LANES: usize = 4;

/// The planes through a line and the corners of a source, one plane per corner. Each lane has one plane.
#[derive(Clone, Copy, Debug, Default)]
struct Planes {
    /// The x, y and z coordinates of the planes' normals.
    m: [[f64; LANES]; 3],
    /// The dot product of each corner and the normal of its plane.
    from: [f64; LANES],
    /// A bound on the error of each plane's dot products, divided by the length of the other vector.
    error: [f64; LANES],
}

/// A hyperplane, prepared for the corners of the source.
pub struct Hyperplane {
    planes: [Planes; 2],
    /// The number of used entries of `planes`.
    count: usize,
    /// A bound on the effect of the source's slack, divided by the sum of two distances from the source: of
    /// the line and of an item.
    slack: f64,
    /// Maximum distance between the source and a point of the line.
    far: f64,
}

/// Returns the sum of the absolute values of the coordinates.
pub fn l1(v: DVec3) -> f64 {
    v.x.abs() + v.y.abs() + v.z.abs()
}

/// Computes the plane through a point `x` and the line from `a` to `b`.
///
/// A difference has one rounding error and the error of the point. A product of two factors and a sum of
/// three terms add three roundings, and m·v adds as many.
pub fn plane(a: DVec3, b: DVec3, x: DVec3) -> Plane {
    let (p, q) = (a - x, b - x);
    Plane {
        m: p.cross(q),
        error: 8.0 * U * l1(p) * l1(q),
    }
}

impl Hyperplane {
    /// Creates the hyperplane of the line from `a` to `b`. All points of the line are at most `far` from the
    /// source.
    pub fn new(source: &ReceiverHull, a: DVec3, b: DVec3, far: f64) -> Self {
        let mut planes = [Planes::default(); 2];
        let groups = source.corners.chunks(LANES);
        let count = groups.len();
        for (planes, corners) in planes.iter_mut().zip(groups) {
            for lane in 0..LANES {
                // Lanes without a corner repeat the first corner.
                let s = corners.get(lane).unwrap_or(&corners[0]);
                let Plane { m, error } = plane(a, b, *s);
                (0..3).for_each(|k| planes.m[k][lane] = m[k]);
                (planes.from[lane], planes.error[lane]) = (m.dot(*s), 2.0 * error);
            }
        }
        Self {
            planes,
            count,
            slack: source.slack * l1(b - a),
            far,
        }
    }

    /// Returns the side on which rays from the source to a hull pass. All corners of the hull are at most
    /// `far` from the source.
    pub fn passes(&self, hull: Hull<'_>, far: f64) -> PassingSide {
        let (mut inside, mut outside) = (true, true);
        let slack = self.slack * (far + self.far);
        for planes in &self.planes[..self.count] {
            let (least, most) = hull.extents(&planes.m);
            for k in 0..LANES {
                let bound = planes.error[k] * far + slack;
                inside &= least[k] - planes.from[k] > bound;
                outside &= most[k] - planes.from[k] < -bound;
            }
            if !inside && !outside {
                return PassingSide::Both;
            }
        }
        if inside {
            PassingSide::Inside
        } else {
            PassingSide::Outside
        }
    }
}
