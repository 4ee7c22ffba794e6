//! Occluder fusion: the union of an occluder with its neighbours while the union blocks more of a region.
//!
//! Connected triangles that lines cross in the same direction act as one occluder, bounded by their
//! silhouette (Nirenstein 2003, section 2.4).

use crate::occluders::{OccluderId, Occluders, OrientedOccluder};
use crate::search::local::{Constraints, PairState, lines_of, triangles};
use crate::search::side_bitsets::{FusedEdge, both, count};

/// The maximum number of occluders in a fused occluder.
const MOST_MEMBERS: usize = 256;
/// The minimum number of consecutive members without effect after which fusion ends.
///
/// A member has an effect if the fused occluder blocks more rays and lines with this member. If the fused
/// occluder had more members than this at its last effect, fusion ends after that many members instead.
const IN_VAIN: usize = 8;

impl PairState<'_> {
    /// Fuses an occluder with neighbours until the union blocks the region or further neighbours have no
    /// effect.
    ///
    /// `held` is the number of the region's rays and sampled lines that the occluder blocks without
    /// neighbours. Each step adds the neighbour across the edge with the largest part of the region outside
    /// that edge. The result is an index into `known`. It is `None` if no union of neighbours blocks more
    /// than `held`, if the occluder already blocks all rays and lines, or if it is not wholly between the
    /// polygons.
    ///
    /// A single neighbour often has no effect although several together have one: to block the lines around a
    /// facet of a curved surface, the union needs most of the facets.
    pub fn fuse(
        &mut self,
        scene: &Occluders,
        id: OccluderId,
        negative: bool,
        held: u32,
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
            // An occluder and its own reverse side have no border, and together they block no lines.
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

    /// Adds the edges of an occluder, reversed if needed, to the border of the union.
    ///
    /// The function removes edges along which both borders run in opposite directions.
    fn join(
        &mut self,
        scene: &Occluders,
        border: &mut Vec<FusedEdge>,
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
                border.push(FusedEdge {
                    edge,
                    inside,
                    count: count(inside),
                    last: false,
                });
            }
        }
    }

    /// Chooses the next occluder to add, and determines whether it must be reversed.
    ///
    /// The occluder shares the edge of `border` with the largest part of the region outside that edge. The
    /// result is `None` if no edge has a suitable neighbour.
    fn beyond(
        &mut self,
        scene: &Occluders,
        border: &mut [FusedEdge],
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
                    // The borders must run along the edge in opposite directions, so an occluder that runs in
                    // the same direction is reversed.
                    return Some(OrientedOccluder {
                        id: *id,
                        reversed: *back == limit.edge.back(),
                    });
                }
            }
            limit.last = true;
        }
    }

    /// Adds the union of occluders to `known`. All members must lie between the polygons.
    ///
    /// The result is an index into `known`, or `None` if the union has no border.
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
