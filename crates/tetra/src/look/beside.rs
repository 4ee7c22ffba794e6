//! Which triangles one of their own edges divides from a ring, in plain doubles with one bound for each edge.
//!
//! Most triangles that are compared with a beam are beside it and share a point or an edge with what is seen
//! in it. What is answered is certain; what is left open is decided by [`super::outline`].

use sightline_geometry::rounding::UNIT as U;
use sightline_geometry::vector::{cross, dot};

use super::beam::Edge;
use super::eye::Eye;
use super::rounded::{LEAST, RoundedNumber, V, size};

/// The edges of a triangle, as seen from the viewpoint.
pub(super) struct Edges {
    points: [u32; 3],
    /// Normals of the planes through the viewpoint and an edge, inner side positive.
    normals: [V; 3],
    /// For each edge the product of the sizes of two vectors, whose cross product the normal is.
    sizes: [f64; 3],
}

impl Edges {
    /// The edges of three points; nothing if it is open from which side they are seen.
    ///
    /// With a and e the sizes of a way and of an edge's vector, both of which are rounded once, a component
    /// of their cross product is at most 2ae and errs by at most 10uae, up to second order: 4uae from the
    /// vectors, and 6uae from products and a difference. Its scalar product with a vector of size d that is
    /// rounded once too errs by at most 3 · 10uaed + 3 · 2uaed from these, and by 5u · 6aed from products and
    /// sums: 128uaed is more. What underflows loses less than [`LEAST`] each time.
    #[inline]
    pub fn of(eye: &Eye<'_>, points: [u32; 3]) -> Option<Self> {
        let places = points.map(|p| eye.point(p));
        let minus = |p: V, q: V| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
        let along = [
            minus(places[1], places[0]),
            minus(places[2], places[1]),
            minus(places[0], places[2]),
        ];
        let ways = places.map(|p| minus(p, eye.x));
        let mut normals = [
            cross(ways[0], along[0]),
            cross(ways[1], along[1]),
            cross(ways[2], along[2]),
        ];
        let sizes = [0, 1, 2].map(|k| size(ways[k]) * size(along[k]));
        // The way to the third point is the way to the first one and the vector from there, and the normal is
        // perpendicular to the first.
        let turn = -dot(normals[0], along[2]);
        let reach = size(along[2]);
        let error = 128.0 * U * sizes[0] * reach + 8.0 * LEAST * (reach + 1.0);
        match (RoundedNumber { value: turn, error }).sign()? {
            1 => {}
            _ => normals = normals.map(|n| n.map(|c| -c)),
        }
        Some(Self {
            points,
            normals,
            sizes,
        })
    }

    /// Whether it is certain that no direction of a ring's interior is in the triangle, because one of its
    /// edges divides them.
    ///
    /// A corner's components are below 2, so its scalar product with a normal errs by at most 3 · 2 · 10uae +
    /// 3 · 2ae · ε + 5u · 12ae, with ε the corner's own bound. A corner in the direction of one of the edge's
    /// points is in the edge's plane.
    #[inline]
    pub fn are_beside(&self, ring: &[Edge]) -> bool {
        (0..3).any(|k| {
            let (a, b) = (self.points[k], self.points[if k == 2 { 0 } else { k + 1 }]);
            let (normal, size) = (self.normals[k], self.sizes[k]);
            ring.iter().all(|edge| {
                let corner = &edge.corner;
                let error = size * (7.0 * corner.way.error + 128.0 * U) + 16.0 * LEAST;
                dot(normal, corner.way.v) < -error || corner.point == a || corner.point == b
            })
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "these are tests")]
mod tests {
    use proptest::prelude::*;

    use super::super::beam::{self, Place};
    use super::super::outline::Outline;
    use super::super::planes::Planes;
    use super::super::rings::Rings;
    use super::*;
    use crate::look::eye::unit_of;

    /// Points of a coarse lattice, so that many are in line and in one plane, moved and scaled.
    fn lattice() -> impl Strategy<Value = Vec<[f32; 3]>> {
        let point = [-3i8..4, -3i8..4, -3i8..4];
        (prop::collection::vec(point, 6), -60i32..60, 0u8..3).prop_map(|(points, power, moved)| {
            let place = |p: [i8; 3]| p.map(|c| f32::from(c) * f32::powi(2.0, power));
            points
                .into_iter()
                .map(place)
                .map(|p| if moved == 0 { p } else { p.map(|c| c + 0.3) })
                .collect()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100_000))]

        #[test]
        fn what_is_beside_is_so_exactly(
            points in lattice(),
            x in [(-12i8..13, -2i8..3), (-12i8..13, -2i8..3), (-12i8..13, -2i8..3)],
            octant in 0u32..8,
        ) {
            // Near to where planes through points and the viewpoint meet in one line, and a hair beside.
            let size = points.iter().flatten().fold(0.0f32, |m, c| m.max(c.abs()));
            let unit = f64::from(size) / 12.0;
            let x = x.map(|(c, hair)| (f64::from(c) + f64::from(hair) * 4.0 * f64::EPSILON) * unit);
            let eye = Eye::new(x, &points, &[], unit_of(points.iter().flatten().map(|c| f64::from(*c))));
            let (mut planes, mut rings, mut ring) = (Planes::default(), Rings::default(), Vec::new());
            beam::octant(&mut planes, &eye, octant, &mut ring);
            // A ring whose corners are directions to points.
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let side = planes.add_edge(&eye, a, b);
                if beam::place(&mut planes, &eye, &ring, side, &mut rings.signs) == Place::Both {
                    let Rings { signs, next, far, .. } = &mut rings;
                    beam::cut(&mut planes, &eye, &ring, side, signs, next, far);
                    std::mem::swap(&mut ring, next);
                }
            }
            for triangle in [[3, 4, 5], [0, 3, 4], [0, 1, 3], [1, 0, 4], [2, 1, 5]] {
                if let Some(edges) = Edges::of(&eye, triangle) {
                    let outline = Outline::of(&eye, triangle);
                    prop_assert!(outline.is_some(), "its plane holds the viewpoint");
                    let exactly = outline.unwrap().is_beside(&mut planes, &eye, &ring);
                    prop_assert!(exactly || !edges.are_beside(&ring));
                }
            }
        }
    }

    #[test]
    fn a_triangle_across_an_edge_is_beside() {
        let points = [
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [0.0, 1.0, 1.0],
            [1.0, -1.0, 1.0],
        ];
        let eye = Eye::new([-0.1, -0.2, 0.0], &points, &[], 0);
        let (mut planes, mut rings, mut ring) = (Planes::default(), Rings::default(), Vec::new());
        beam::octant(&mut planes, &eye, 0, &mut ring);
        assert!(
            Outline::of(&eye, [0, 1, 2])
                .unwrap()
                .clip(&mut planes, &eye, &ring, &mut rings)
        );
        for (triangle, beside) in [([1, 0, 3], true), ([0, 1, 2], false), ([0, 2, 3], false)] {
            assert_eq!(
                Edges::of(&eye, triangle).unwrap().are_beside(&rings.inside),
                beside,
                "{triangle:?}"
            );
        }
    }
}
