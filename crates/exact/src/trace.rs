//! What one sight line meets, decided exactly.

use std::cmp::Ordering;

use glam::DVec3;

use crate::local::Local;
use crate::occluder::Occluders;
use crate::prism::Pair;
use crate::vector::Space;

/// What a segment from a point of A to a point of B meets in between.
#[derive(Debug, PartialEq, Eq)]
pub enum Met {
    /// No triangle at all: a witness.
    Nothing,
    /// It passes through the inside of these triangles.
    Blocked(Vec<u32>),
    /// It touches a triangle's border, and passes through none.
    Grazing,
}

impl Local<'_> {
    /// Follows the segment from `p` to `q`, points of the space inside A and B and close to the doubles given.
    ///
    /// Triangles in the plane of A or of B do not count, and neither does what the segment reaches only at its ends.
    pub fn trace(&mut self, scene: &Occluders, (p, q): (u32, u32), (near_p, near_q): (DVec3, DVec3)) -> Met {
        let mut candidates = std::mem::take(&mut self.candidates);
        candidates.clear();
        scene.along(near_p, near_q, self.pair.size, &mut candidates);
        let mut blocked = Vec::new();
        let mut grazing = false;
        for id in &candidates {
            let corners = self.corner_points(scene, *id);
            match touch(&mut self.space, &mut self.pair, (p, q), *id, corners) {
                Touch::Through => blocked.push(*id),
                Touch::Border => grazing = true,
                Touch::Not => {}
            }
        }
        self.candidates = candidates;
        match (blocked.is_empty(), grazing) {
            (false, _) => Met::Blocked(blocked),
            (true, true) => Met::Grazing,
            (true, false) => Met::Nothing,
        }
    }
}

enum Touch {
    Not,
    Border,
    Through,
}

/// How the segment meets one triangle.
fn touch(space: &mut Space, pair: &mut Pair, (p, q): (u32, u32), id: u32, corners: [u32; 3]) -> Touch {
    if pair.flat.get(&id).is_some_and(|f| f.contains(&true)) {
        return Touch::Not;
    }
    let [a, b, c] = corners;
    let (sp, sq) = (space.filtered_orient(a, b, c, p), space.filtered_orient(a, b, c, q));
    if sp.is_some() && sp == sq {
        return Touch::Not;
    }
    let sides = [space.orient(p, q, a, b), space.orient(p, q, b, c), space.orient(p, q, c, a)];
    if sides.contains(&Ordering::Greater) && sides.contains(&Ordering::Less) {
        return Touch::Not;
    }
    let (at_a, at_b) = match (sp, sq) {
        (Some(_), Some(_)) => (false, false),
        _ => {
            // An end may be on the triangle's plane, for one because the triangle is in A's plane or in B's.
            if in_planes(space, pair, id, &corners).contains(&true) {
                return Touch::Not;
            }
            let (sp, sq) = (space.orient(a, b, c, p), space.orient(a, b, c, q));
            if sp == sq && sp != Ordering::Equal {
                return Touch::Not;
            }
            (sp == Ordering::Equal, sq == Ordering::Equal)
        }
    };
    if at_a || at_b || sides.contains(&Ordering::Equal) { Touch::Border } else { Touch::Through }
}

/// Whether a triangle lies in A's plane, and whether in B's: what does is not in between.
fn in_planes(space: &mut Space, pair: &mut Pair, id: u32, corners: &[u32; 3]) -> [bool; 2] {
    if let Some(known) = pair.flat.get(&id) {
        return *known;
    }
    let flat = [&pair.a, &pair.b]
        .map(|of| corners.iter().all(|t| space.orient(of[0], of[1], of[2], *t) == Ordering::Equal));
    pair.flat.insert(id, flat);
    flat
}
