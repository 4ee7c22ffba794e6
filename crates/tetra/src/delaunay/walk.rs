//! Walks to the tetrahedron that contains a viewpoint, and the front-to-back order of tetrahedra from the
//! viewpoint.

use std::cmp::Ordering;

use super::build::Delaunay;
use super::mesh::NONE;
use super::predicates::side;

impl Delaunay {
    /// Finds a tetrahedron that contains the point `x`, by a walk from the tetrahedron `hint`, and returns
    /// its number.
    ///
    /// Any number is a valid hint; the previous result is a good hint. Returns `None` if `x` is outside of
    /// the box or not finite. If several tetrahedra contain `x` on their border, the result is any of these.
    ///
    /// The walk is exact and always ends: each step leads to a tetrahedron with a smaller power of `x`.
    pub fn locate(&self, x: [f64; 3], hint: u32) -> Option<u32> {
        let [lower, upper] = self.bounds();
        if !(0..3).all(|k| f64::from(lower[k]) <= x[k] && x[k] <= f64::from(upper[k])) {
            return None;
        }
        let mut at = if (hint as usize) < self.tetrahedra.len() {
            hint
        } else {
            0
        };
        let mut from = NONE;
        'walk: loop {
            for (k, &next) in self.neighbours[at as usize].iter().enumerate() {
                if next != from && next != NONE && self.side(at, k, x) == Ordering::Less {
                    (at, from) = (next, at);
                    continue 'walk;
                }
            }
            return Some(at);
        }
    }

    /// Returns the corners of the box with the smallest and with the largest coordinates.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        // The constructor appends the 8 corners to the points. A caller can create a value without them.
        let corner = |from_end: usize| {
            self.points
                .len()
                .checked_sub(from_end)
                .and_then(|k| self.points.get(k))
                .copied()
                .unwrap_or([0.0; 3])
        };
        [corner(8), corner(1)]
    }

    /// Returns the side of the face opposite corner `k` of tetrahedron `t` on which `x` is.
    ///
    /// The point `x` must be finite.
    ///
    /// The result is exact: `Greater` on the tetrahedron's side, `Equal` on the face's plane. Seen from `x`,
    /// the tetrahedron is before its neighbour across the face for `Greater`, and behind the neighbour for
    /// `Less`. These relations of all faces contain no cycle.
    pub fn side(&self, t: u32, k: usize, x: [f64; 3]) -> Ordering {
        let corners = self.tetrahedra[t as usize].map(|c| self.points[c as usize]);
        let [a, b, c, d] = corners;
        // An even permutation of the corners moves `x` from index k to the front.
        match k {
            0 => side([b, c, d], x),
            1 => side([a, d, c], x),
            2 => side([a, b, d], x),
            _ => side([a, c, b], x),
        }
    }

    /// Computes the power of the point `x` to the circumsphere of tetrahedron `t`, rounded.
    ///
    /// The power is the squared distance to the sphere's centre minus the squared radius, in squared units of
    /// the points. Tetrahedra ordered by power are nearly in front-to-back order. Use the power only to order
    /// work: powers of tetrahedra on one sphere are equal except for rounding. For a tetrahedron whose volume
    /// rounds to 0, the result is the squared distance to its first corner. For the exact order of two
    /// neighbours, use [`Self::side`].
    pub fn power(&self, t: u32, x: [f64; 3]) -> f64 {
        let corners = self.tetrahedra[t as usize].map(|c| self.points[c as usize].map(f64::from));
        let minus = |p: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| p[k] - corners[0][k]) };
        let [b, c, d] = [minus(corners[1]), minus(corners[2]), minus(corners[3])];
        let y = minus(x);
        let cross = |p: [f64; 3], q: [f64; 3]| {
            [
                p[1] * q[2] - p[2] * q[1],
                p[2] * q[0] - p[0] * q[2],
                p[0] * q[1] - p[1] * q[0],
            ]
        };
        let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        // Relative to corner a the sphere passes through the origin, and the power is y·y − y·(2 centre) with
        // 2 centre = (b² c×d + c² d×b + d² b×c) / (b×c·d).
        let (cd, db, bc) = (cross(c, d), cross(d, b), cross(b, c));
        let volume = dot(b, cd);
        let (b2, c2, d2) = (dot(b, b), dot(c, c), dot(d, d));
        if volume <= 0.0 {
            return dot(y, y);
        }
        let twice_centre: [f64; 3] =
            std::array::from_fn(|k| (b2 * cd[k] + c2 * db[k] + d2 * bc[k]) / volume);
        dot(y, std::array::from_fn(|k| y[k] - twice_centre[k]))
    }
}
