//! The corners of the scene as points of the space of one pair, with their sides of the two polygons' planes.

use std::cmp::Ordering;

use glam::Vec3;
use rustc_hash::FxHashMap;

use crate::line_space::space::Space;
use crate::line_space::stabbing_polyhedron::Pair;
use crate::search::maps::with_room;

/// The corners of the scene that are points of the space, keyed by corner number.
pub struct Corners {
    /// For each corner, the index of its point in the space, and its sides of A's plane and of B's plane once
    /// they are computed.
    known: FxHashMap<u32, (u32, Option<[Ordering; 2]>)>,
}

impl Corners {
    /// Creates an empty table.
    pub fn new() -> Self {
        Self {
            known: with_room(64),
        }
    }

    /// Returns the index of a corner's point in the space, and adds the point on the first call. `number` is
    /// the corner number, and `at` the position in world space.
    pub fn point(&mut self, space: &mut Space, number: u32, at: Vec3) -> u32 {
        if let Some((point, _)) = self.known.get(&number) {
            return *point;
        }
        let point = space.frame().given(at.as_dvec3());
        let point = space.point(point);
        self.known.insert(number, (point, None));
        point
    }

    /// Returns the side of A's plane and the side of B's plane on which a corner lies.
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
