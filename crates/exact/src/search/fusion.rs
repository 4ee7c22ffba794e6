//! Occluder fusion: joining an occluder with its neighbours while the union blocks more of a region.
//!
//! Connected triangles crossed in the same direction act as one occluder, bounded by their silhouette
//! (Nirenstein 2003, section 2.4).

use crate::occluders::{OccluderId, Occluders, OrientedOccluder};
use crate::search::local::{Constraints, Local, lines_of, triangles};
use crate::search::side_bitsets::{Limit, both, count};

/// Maximum number of occluders in a fused occluder.
const MOST_MEMBERS: usize = 256;
/// Consecutive members without effect after which fusion ends, or the number of members so far if that is
/// greater.
const IN_VAIN: usize = 8;

impl Local<'_> {
    /// Adds neighbours to an occluder, always across the edge with the largest part of the region outside it,
    /// until further neighbours have no effect. Returns an index into `known`, or None if no neighbours make
    /// it block more of the region.
    ///
    /// One neighbour often has no effect where several have: most facets of a curved surface are needed to
    /// block the lines around one of them.
    pub fn fuse(
        &mut self,
        scene: &Occluders,
        (id, negative, held): (OccluderId, bool, u32),
    ) -> Option<usize> {
        let every = self.side_bitsets.all();
        let all = count(every);
        if held == all || !self.is_between(scene, id) {
            return None;
        }
        let mut border = std::mem::take(&mut self.border);
        border.clear();
        let first = OrientedOccluder {
            id,
            reversed: false,
        };
        let mut members = vec![first];
        self.join(scene, &mut border, first, negative);
        let (mut most, mut best) = (held, 1);
        while most < all && members.len() < MOST_MEMBERS.min(best + best.max(IN_VAIN)) {
            let Some(next) = self.beyond(scene, &mut border, &members, all) else {
                break;
            };
            members.push(next);
            self.join(scene, &mut border, next, negative);
            let held = count(
                border
                    .iter()
                    .fold(every, |all, limit| both(all, limit.inside)),
            );
            // Two sides of one sheet have no border and block nothing together.
            if held > most && !border.is_empty() {
                (most, best) = (held, members.len());
            }
        }
        self.border = border;
        members.truncate(best);
        if best == 1 {
            return None;
        }
        members.sort_unstable();
        self.patch(scene, members)
    }

    /// Adds an occluder, perhaps reversed, to a border: edges along which the two run in opposite directions
    /// are removed.
    fn join(
        &mut self,
        scene: &Occluders,
        border: &mut Vec<Limit>,
        OrientedOccluder { id, reversed }: OrientedOccluder,
        negative: bool,
    ) {
        for at in self.side_bitsets.shape(scene, self.space.frame(), id) {
            let edge = self.side_bitsets.edges(at..at + 1)[0];
            let edge = if reversed { edge.reversed() } else { edge };
            let [from, to] = edge.corners;
            if let Some(other) = border.iter().position(|l| l.edge.corners == [to, from]) {
                border.remove(other);
            } else {
                let inside = self.side_bitsets.inside(&self.forms, edge, negative);
                border.push(Limit {
                    edge,
                    inside,
                    count: count(inside),
                    last: false,
                });
            }
        }
    }

    /// The next occluder to add, across the edge with the largest part of the region outside it, and whether
    /// the occluder must be reversed.
    fn beyond(
        &mut self,
        scene: &Occluders,
        border: &mut [Limit],
        members: &[OrientedOccluder],
        all: u32,
    ) -> Option<OrientedOccluder> {
        loop {
            let limit = border
                .iter_mut()
                .filter(|l| !l.last && l.count < all)
                .min_by_key(|l| l.count)?;
            for (id, back) in scene.boundary_edges().sharing(limit.edge.number) {
                if !members.iter().any(|m| m.id == *id) && self.is_between(scene, *id) {
                    // The borders must run along the edge in opposite directions, so an occluder that runs
                    // the same way is reversed.
                    return Some(OrientedOccluder {
                        id: *id,
                        reversed: *back == limit.edge.back(),
                    });
                }
            }
            limit.last = true;
        }
    }

    /// Fuses occluders that all lie between the polygons. Returns an index into `known`, or None if the union
    /// has no border.
    fn patch(&mut self, scene: &Occluders, members: Vec<OrientedOccluder>) -> Option<usize> {
        if let Some(at) = self.patches.get(&members) {
            return *at;
        }
        let (edges, border) = scene.border(&triangles(scene, &members));
        let lines = self.border_lines(&edges, &border);
        let lines = lines_of(&lines, &edges, &self.side_bitsets);
        let at = (!lines.is_empty()).then(|| {
            self.known.push(Constraints {
                members: members.clone(),
                lines,
            });
            self.known.len() - 1
        });
        self.patches.insert(members, at);
        at
    }
}
