//! A triangle as a beam meets it: its plane and the planes of its edges.

use super::beam::{self, Edge, Place, Ring};
use super::eye::Eye;
use super::planes::{EyePlane, Facing, Planes};
use super::rings::Rings;

/// A triangle whose plane does not hold the viewpoint.
#[derive(Clone, Copy)]
pub(super) struct Outline {
    pub facing: Facing,
    /// The planes of the edges in front order, and whether the inner side is the negative one.
    edges: [(EyePlane, bool); 3],
}

impl Outline {
    /// The outline of three points.
    pub fn of(eye: &Eye<'_>, points: [u32; 3]) -> Option<Self> {
        let facing = Facing::of(eye, points)?;
        let [a, b, c] = facing.points;
        Some(Self {
            facing,
            edges: [(a, b), (b, c), (c, a)].map(|(a, b)| (EyePlane::edge(eye, a, b), a > b)),
        })
    }

    /// Whether no direction of a ring's interior is in the triangle because one of its edges divides them.
    pub fn is_beside(&self, planes: &mut Planes, eye: &Eye<'_>, ring: &[Edge]) -> bool {
        self.edges.iter().any(|(plane, negative)| {
            let outside = if *negative { 1 } else { -1 };
            ring.iter()
                .all(|edge| planes.sign_of(eye, &edge.corner, plane) != -outside)
        })
    }

    /// Cuts a ring to its part in the triangle, which is in `rings.inside` then; says whether there is one.
    /// The planes that it needs are added.
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
                Place::Inside => {}
                Place::Outside => return false,
                Place::Both => {
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

/// Slots for outlines, a power of two.
const SLOTS: usize = 1 << 12;

/// The outlines of a query that were made last, because most triangles are compared with many beams.
#[derive(Default)]
pub(super) struct Outlines {
    /// The triangle with its outline, and the query that made it.
    slots: Vec<(u32, u64, Option<Outline>)>,
    query: u64,
}

impl Outlines {
    /// Begins a query.
    pub fn begin(&mut self) {
        self.query += 1;
        self.slots.resize(SLOTS, (0, 0, None));
    }

    /// The outline of a triangle with these points, or nothing if its plane holds the viewpoint.
    #[inline]
    pub fn of(&mut self, eye: &Eye<'_>, triangle: u32, points: [u32; 3]) -> Option<Outline> {
        let slot = &mut self.slots[triangle as usize & (SLOTS - 1)];
        if (slot.0, slot.1) != (triangle, self.query) {
            *slot = (triangle, self.query, Outline::of(eye, points));
        }
        slot.2
    }
}

/// Where a triangle is relative to a patch that covers the beam.
pub(super) enum Order {
    /// Nothing of it is in front within the beam.
    Hidden,
    /// Some of it is.
    Nearer,
    /// It lies in the plane of a piece and overlaps it.
    Level,
    /// It goes through the plane of a piece, along this plane.
    Crosses(EyePlane),
}

/// Where a triangle is relative to a face in a ring that the face covers. Needs and forgets some planes.
pub(super) fn order(
    planes: &mut Planes,
    eye: &Eye<'_>,
    (ring, face): (&Ring, &Facing),
    outline: &Outline,
    rings: &mut Rings,
) -> Order {
    let facing = &outline.facing;
    let level = face.has_points_of(facing);
    let is_behind = |p: &u32| face.points.contains(p) || face.hides(&[eye.to(*p)]);
    if !level && facing.points.iter().all(is_behind) || outline.is_beside(planes, eye, ring) {
        return Order::Hidden;
    }
    // Two faces in one plane have no plane in which they meet.
    let may_be_none = |meet: &EyePlane| meet.normal.size() <= meet.normal.error;
    let meet = (!level)
        .then(|| face.meet(facing))
        .filter(|meet| !may_be_none(meet) || !face.is_level_with(eye, facing));
    if let Some(meet) = &meet {
        // Farther away in all of the ring, whatever part of it the triangle covers.
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
            Place::Outside => Order::Hidden,
            Place::Inside if rings.signs.iter().all(|s| *s == 0) => Order::Level,
            Place::Inside => Order::Nearer,
            Place::Both => Order::Crosses(meet),
        }
    } else {
        Order::Level
    };
    planes.list.truncate(made);
    order
}
