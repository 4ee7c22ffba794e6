//! Corners of the scene as points of the space of one pair, and on which sides of the two polygons' planes
//! they lie.

use std::cmp::Ordering;

use glam::Vec3;
use rustc_hash::FxHashMap;

use crate::line_space::space::Space;
use crate::line_space::stabbing_polyhedron::Pair;
use crate::search::maps::with_room;

/// Corners by their numbers in the scene.
pub struct Corners {
    /// The point of the space, and its sides of A's plane and of B's once they are computed.
    known: FxHashMap<u32, (u32, Option<[Ordering; 2]>)>,
}

impl Corners {
    /// An empty table.
    pub fn new() -> Self {
        Self {
            known: with_room(64),
        }
    }

    /// A corner at a world position as a point of the space.
    pub fn point(&mut self, space: &mut Space, number: u32, at: Vec3) -> u32 {
        if let Some((point, _)) = self.known.get(&number) {
            return *point;
        }
        let point = space.frame().given(at.as_dvec3());
        let point = space.point(point);
        self.known.insert(number, (point, None));
        point
    }

    /// On which sides of A's plane and of B's a corner lies.
    pub fn sides(
        &mut self,
        space: &mut Space,
        pair: &Pair,
        number: u32,
        at: Vec3,
    ) -> [Ordering; 2] {
        let point = self.point(space, number, at);
        if let Some((_, Some(sides))) = self.known.get(&number) {
            return *sides;
        }
        let planes = [&pair.a, &pair.b].map(|p| [p[0], p[1], p[2]]);
        let sides = planes.map(|[a, b, c]| space.orient(a, b, c, point));
        self.known.insert(number, (point, Some(sides)));
        sides
    }
}
