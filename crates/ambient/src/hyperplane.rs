//! Hyperplanes of edges, told for all corners of a source and whole items at once.

use glam::DVec3;
use sightline_geometry::rounding::UNIT as U;

use crate::hull::Hull;
use crate::polygon::Plane;
use crate::receivers::Source;

/// On which side of a hyperplane the rays to an item pass.
pub enum Passes {
    /// Inside of it.
    Inside,
    /// Outside.
    Outside,
    /// On both sides, or doubles cannot tell.
    Both,
}

/// Corners of a source that are told together: it has one, two, four or eight.
const LANES: usize = 4;

/// The planes through some corners of a source and a line, lane by lane.
#[derive(Clone, Copy, Debug, Default)]
struct Planes {
    /// The normals' coordinates.
    m: [[f64; LANES]; 3],
    /// Where the corners are along the normals.
    from: [f64; LANES],
    /// Bounds of the errors.
    error: [f64; LANES],
}

/// A hyperplane, prepared for the corners of the source.
pub struct Hyperplane {
    planes: [Planes; 2],
    /// How many of them there are.
    count: usize,
    /// Bound on what the source's slack can change, by the sum of two lengths.
    slack: f64,
    /// Largest distance of the source from the line's points.
    far: f64,
}

/// The sum of the absolute values.
pub fn l1(v: DVec3) -> f64 {
    v.x.abs() + v.y.abs() + v.z.abs()
}

/// The plane through a point `x` and the line from `a` to `b`. A difference is off by a rounding, and by the
/// point's own error; a product of two and the sum of three add three roundings, and m·v as many.
pub fn plane(a: DVec3, b: DVec3, x: DVec3) -> Plane {
    let (p, q) = (a - x, b - x);
    Plane {
        m: p.cross(q),
        error: 8.0 * U * l1(p) * l1(q),
    }
}

impl Hyperplane {
    /// The hyperplane of the line from `a` to `b`, no point of which is farther than `far` from the source.
    pub fn new(source: &Source, a: DVec3, b: DVec3, far: f64) -> Self {
        let mut planes = [Planes::default(); 2];
        let groups = source.corners.chunks(LANES);
        let count = groups.len();
        for (planes, corners) in planes.iter_mut().zip(groups) {
            for lane in 0..LANES {
                // Lanes without a corner of their own repeat the first.
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

    /// How rays to a hull pass, no corner of which is farther than `far` from the source.
    pub fn passes(&self, hull: Hull<'_>, far: f64) -> Passes {
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
                return Passes::Both;
            }
        }
        if inside {
            Passes::Inside
        } else {
            Passes::Outside
        }
    }
}
