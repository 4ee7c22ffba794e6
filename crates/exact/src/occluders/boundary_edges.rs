//! The boundary edges of all occluders, numbered occluder by occluder, grouped by their two corners.

use rayon::prelude::*;

use super::occluder::{Occluder, OccluderId};

/// Maximum number of occluders considered at one edge.
const MOST_AT_EDGE: usize = 8;

/// The boundary edges of all occluders.
pub struct BoundaryEdges {
    /// The number of each occluder's first edge.
    first: Vec<u32>,
    /// The group of each edge, by number. A group holds the edges between the same two corners.
    group: Vec<u32>,
    /// The start of each group in `sharing`, followed by the end of the last.
    groups: Vec<u32>,
    /// The occluders with an edge of a group, and whether their border runs from the greater corner to the
    /// lesser.
    sharing: Vec<(OccluderId, bool)>,
}

impl BoundaryEdges {
    /// Numbers the edges of some occluders.
    pub fn new(occluders: &[Occluder]) -> Self {
        let mut first = Vec::with_capacity(occluders.len());
        // Lesser and greater corner, occluder, direction, number.
        let mut edges: Vec<([u32; 2], OccluderId, bool, u32)> = Vec::new();
        for (id, o) in occluders.iter().enumerate() {
            first.push(edges.len() as u32);
            for [a, b] in &o.edges {
                edges.push((
                    [*a.min(b), *a.max(b)],
                    OccluderId(id as u32),
                    a > b,
                    edges.len() as u32,
                ));
            }
        }
        edges.par_sort_unstable();
        let mut group = vec![0; edges.len()];
        let (mut groups, mut sharing) = (Vec::new(), Vec::with_capacity(edges.len()));
        for same in edges.chunk_by(|a, b| a.0 == b.0) {
            for (_, id, back, number) in same {
                group[*number as usize] = groups.len() as u32;
                sharing.push((*id, *back));
            }
            groups.push((sharing.len() - same.len()) as u32);
        }
        groups.push(sharing.len() as u32);
        Self {
            first,
            group,
            groups,
            sharing,
        }
    }

    /// The number of an occluder's first edge; the others follow in the order of its border.
    pub fn first(&self, occluder: OccluderId) -> u32 {
        self.first[occluder.0 as usize]
    }

    /// The occluders with this edge, at most eight of them, each with whether its border runs along the edge
    /// from the greater corner to the lesser.
    pub fn sharing(&self, edge: u32) -> &[(OccluderId, bool)] {
        let group = self.group[edge as usize] as usize;
        let all = &self.sharing[self.groups[group] as usize..self.groups[group + 1] as usize];
        &all[..all.len().min(MOST_AT_EDGE)]
    }
}
