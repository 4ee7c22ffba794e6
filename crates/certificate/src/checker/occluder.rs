//! Occluders: triangles with windings, and the constraints on the lines that an occluder blocks.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use dashu_int::IBig;
use glam::Vec3;

use super::geometry::{Line, Plane, Point, height, join, meet, plane, point, sign};
use super::polygon::Side;
use super::vector::Vector;
use crate::proof::OccluderTriangle;

/// An occluder, derived only from its triangles.
pub(super) struct Occluder {
    corners: Vec<[Point; 3]>,
    /// The boundary edges, as constraints on lines.
    pub boundary: Vec<Constraint>,
    /// The plane of the occluder, if all triangles lie in one plane and face the same direction.
    plane: Option<Plane>,
}

impl Occluder {
    /// Creates an occluder. Returns `None` if a triangle is not in the scene, an edge has no length, or there
    /// is no boundary.
    pub fn new(scene: &[[Vec3; 3]], triangles: &[OccluderTriangle]) -> Option<Self> {
        let mut corners = Vec::with_capacity(triangles.len());
        for OccluderTriangle { triangle, reversed } in triangles {
            let [a, b, c] = *scene.get(*triangle as usize)?;
            let wound = if *reversed { [a, c, b] } else { [a, b, c] };
            corners.push(wound.map(|v| point(v.as_dvec3().to_array())));
        }
        let mut left: Vec<(&Point, &Point)> = Vec::new();
        for (k, OccluderTriangle { reversed, .. }) in triangles.iter().enumerate() {
            let [x, y, z] = &corners[k];
            // The numbers of constraints follow the order of a triangle's edges in the scene: from corner 0
            // to 1, 1 to 2, and 2 to 0.
            let edges = if *reversed {
                [(z, x), (y, z), (x, y)]
            } else {
                [(x, y), (y, z), (z, x)]
            };
            for (p, q) in edges {
                match left.iter().rposition(|(r, s)| *r == q && *s == p) {
                    Some(at) => {
                        left.remove(at);
                    }
                    None => left.push((p, q)),
                }
            }
        }
        // The argument needs at least one boundary edge, and each boundary edge needs a length.
        let boundary: Vec<Line> = left.iter().map(|(p, q)| join(p, q)).collect();
        if boundary.is_empty() || boundary.iter().any(|l| l.iter().all(IBig::is_zero)) {
            return None;
        }
        let numbered = boundary.into_iter().enumerate();
        let boundary = numbered
            .map(|(i, l)| Constraint {
                number: i,
                line: Vector::new(l),
            })
            .collect();
        // A line crosses all triangles from the same side only if all of them lie in one plane and face the
        // same direction. The boundary edges determine this side.
        let planes: Vec<Plane> = corners.iter().map(|[a, b, c]| plane([a, b, c])).collect();
        let flat = planes.first()?;
        let ahead = |p: &Plane| sign(&(0..3).map(|i| &p[i] * &flat[i]).sum()) == Ordering::Greater;
        let one =
            planes.iter().all(ahead) && corners.iter().flatten().all(|p| height(flat, p).is_zero());
        let flat = one.then(|| flat.clone());
        Some(Self {
            plane: flat,
            boundary,
            corners,
        })
    }
}

/// A half-space of line space. The lines that an occluder blocks are all on its positive side, or all on its
/// negative side.
#[derive(Clone)]
pub(super) struct Constraint {
    /// The number of the constraint in [`Step::Block`](crate::proof::Step::Block).
    pub number: usize,
    pub line: Vector,
}

/// For each occluder, the constraints by the planes of A and B, or the reason why it cannot block between
/// them.
pub(super) type OccluderConstraints = BTreeMap<usize, Result<Vec<Constraint>, &'static str>>;

impl Occluder {
    /// Computes the constraints that, in addition to the boundary, place a crossing between A and B. The
    /// error is the reason why the occluder cannot block between A and B.
    pub fn planes(&self, a: &Side, b: &Side) -> Result<Vec<Constraint>, &'static str> {
        let mut out = Vec::new();
        for (k, side) in [a, b].into_iter().enumerate() {
            let places: Vec<[Ordering; 3]> = self
                .corners
                .iter()
                .map(|t| t.each_ref().map(|p| sign(&height(&side.plane, p))))
                .collect();
            if places.contains(&[Ordering::Equal; 3]) {
                return Err(
                    "a triangle of the occluder lies in the plane of A or B, so it blocks no line",
                );
            }
            if places
                .iter()
                .flatten()
                .all(|place| *place != side.other.reverse())
            {
                continue;
            }
            let own = self
                .plane
                .as_ref()
                .ok_or("the occluder is not flat and reaches beyond the plane of A or B")?;
            let toward = if side.other == Ordering::Less {
                side.plane.clone().map(|c| -c)
            } else {
                side.plane.clone()
            };
            let number = self.boundary.len() + k;
            out.push(Constraint {
                number,
                line: Vector::new(meet(&toward, own)),
            });
        }
        Ok(out)
    }
}
