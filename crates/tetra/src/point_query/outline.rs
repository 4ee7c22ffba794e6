//! Outlines of triangles as seen from a viewpoint: the triangle's plane, and the planes through the viewpoint
//! and each edge.

use super::beam::{self, BeamSide, Edge};
use super::eye::Eye;
use super::planes::{EyePlane, Facing, Planes};
use super::rings::Rings;

/// The outline of a triangle whose plane does not contain the viewpoint.
#[derive(Clone, Copy)]
pub(super) struct Outline {
    /// The triangle's plane as seen from the viewpoint.
    pub facing: Facing,
    /// The planes of the edges in front order ([`Facing::points`]). The flag is true if the negative side of
    /// the plane is the triangle's side.
    edges: [(EyePlane, bool); 3],
}

impl Outline {
    /// Computes the outline of the triangle of three points, given by their numbers. Returns `None` if the
    /// plane of the points contains the viewpoint.
    pub fn new(eye: &Eye<'_>, points: [u32; 3]) -> Option<Self> {
        let facing = Facing::new(eye, points)?;
        let [a, b, c] = facing.points;
        Some(Self {
            facing,
            edges: [(a, b), (b, c), (c, a)].map(|(a, b)| (EyePlane::edge(eye, a, b), a > b)),
        })
    }

    /// Returns true if an edge of the triangle separates the triangle from a ring's interior.
    pub fn is_beside(&self, planes: &mut Planes, eye: &Eye<'_>, ring: &[Edge]) -> bool {
        self.edges.iter().any(|(plane, negative)| {
            let outside = if *negative { 1 } else { -1 };
            ring.iter()
                .all(|edge| planes.sign_of(eye, &edge.corner, plane) != -outside)
        })
    }

    /// Clips a ring by the triangle's edges, and stores the part in the triangle in `rings.inside`.
    ///
    /// Adds the planes of the edges to `planes`. Returns true if the part is not empty.
    pub fn clip(
        &self,
        planes: &mut Planes,
        eye: &Eye<'_>,
        ring: &[Edge],
        rings: &mut Rings,
    ) -> bool {
        rings.inside.clear();
        rings.inside.extend_from_slice(ring);
        for (plane, negative) in &self.edges {
            let side = planes.add(*plane);
            let side = if *negative { side.other() } else { side };
            match beam::place(planes, eye, &rings.inside, side, &mut rings.signs) {
                BeamSide::Inside => {}
                BeamSide::Outside => return false,
                BeamSide::Both => {
                    let Rings {
                        inside,
                        next,
                        far,
                        signs,
                        ..
                    } = rings;
                    beam::cut(planes, eye, inside, side, signs, next, far);
                    std::mem::swap(inside, next);
                }
            }
        }
        true
    }
}

/// Number of cache entries for outlines, a power of two.
const SLOTS: usize = 1 << 12;

/// A cache of the outlines that a query computed last.
///
/// Most triangles are compared with many beams.
#[derive(Default)]
pub(super) struct Outlines {
    /// The id of the triangle, the number of the query that computed the outline, and the outline.
    slots: Vec<(u32, u64, Option<Outline>)>,
    /// The number of the current query.
    query: u64,
}

impl Outlines {
    /// Begins a query. Outlines of previous queries become invalid.
    pub fn begin(&mut self) {
        self.query += 1;
        self.slots.resize(SLOTS, (0, 0, None));
    }

    /// Returns the outline of a triangle with these points, or `None` if its plane contains the viewpoint.
    #[inline]
    pub fn find_outline(
        &mut self,
        eye: &Eye<'_>,
        triangle: u32,
        points: [u32; 3],
    ) -> Option<Outline> {
        let slot = &mut self.slots[triangle as usize & (SLOTS - 1)];
        if (slot.0, slot.1) != (triangle, self.query) {
            *slot = (triangle, self.query, Outline::new(eye, points));
        }
        slot.2
    }
}

/// The position of a triangle relative to a patch that covers the beam.
pub(super) enum Order {
    /// No part of the triangle is in front of the patch within the beam.
    Hidden,
    /// A part of the triangle is in front of the patch.
    Nearer,
    /// The triangle lies in the plane of a piece and overlaps the piece.
    Level,
    /// The triangle crosses the plane of a piece. The planes of both meet in a line, and this plane goes
    /// through the viewpoint and the line.
    Crosses(EyePlane),
}

/// Returns the position of the triangle `outline` relative to the plane of `face`, within a ring that `face`
/// covers.
///
/// The function removes the planes that it adds.
pub(super) fn order(
    planes: &mut Planes,
    eye: &Eye<'_>,
    ring: &[Edge],
    face: &Facing,
    outline: &Outline,
    rings: &mut Rings,
) -> Order {
    let facing = &outline.facing;
    let level = face.has_points_of(facing);
    let is_behind = |p: &u32| face.points.contains(p) || face.hides(&[eye.to(*p)]);
    if !level && facing.points.iter().all(is_behind) || outline.is_beside(planes, eye, ring) {
        return Order::Hidden;
    }
    // Two faces in one plane do not define a plane in which they meet.
    let may_be_none = |meet: &EyePlane| meet.normal.size() <= meet.normal.error;
    let meet = (!level)
        .then(|| face.meet(facing))
        .filter(|meet| !may_be_none(meet) || !face.is_level_with(eye, facing));
    if let Some(meet) = &meet {
        // The triangle's plane is farther away in the whole ring, so the triangle is behind the face.
        let mut farther = false;
        let not_nearer = ring.iter().all(|edge| {
            let sign = planes.sign_of(eye, &edge.corner, meet);
            farther |= sign < 0;
            sign <= 0
        });
        if not_nearer && farther {
            return Order::Hidden;
        }
    }
    let made = planes.list.len();
    let order = if !outline.clip(planes, eye, ring, rings) {
        Order::Hidden
    } else if let Some(meet) = meet {
        let side = planes.add(meet);
        match beam::place(planes, eye, &rings.inside, side, &mut rings.signs) {
            BeamSide::Outside => Order::Hidden,
            BeamSide::Inside if rings.signs.iter().all(|s| *s == 0) => Order::Level,
            BeamSide::Inside => Order::Nearer,
            BeamSide::Both => Order::Crosses(meet),
        }
    } else {
        Order::Level
    };
    planes.list.truncate(made);
    order
}
