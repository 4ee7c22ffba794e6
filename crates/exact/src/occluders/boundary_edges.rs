//! The boundary edges of all occluders, numbered occluder by occluder, grouped by their two corners.

use rayon::prelude::*;

use super::occluder::{Occluder, OccluderId};

/// The maximum number of occluders that [`BoundaryEdges::sharing`] returns for one edge.
const MOST_AT_EDGE: usize = 8;

/// The boundary edges of all occluders.
pub struct BoundaryEdges {
    /// For each occluder, the number of its first boundary edge. The number of an edge is an index into
    /// `group`.
    first: Vec<u32>,
    /// For each edge, the index of its group. A group contains the edges between the same two corners.
    group: Vec<u32>,
    /// For each group, the index of its first entry in `sharing`, followed by the length of `sharing`.
    groups: Vec<u32>,
    /// The occluders with an edge between the two corners of a group, group by group.
    ///
    /// The flag is true if the occluder's border runs from the higher corner number to the lower.
    sharing: Vec<(OccluderId, bool)>,
}

impl BoundaryEdges {
    /// Numbers and groups the boundary edges of `occluders`. The index of an occluder in the list is its
    /// [`OccluderId`].
    pub fn new(occluders: &[Occluder]) -> Self {
        let mut first = Vec::with_capacity(occluders.len());
        // Each element contains the lower and the higher corner number, the occluder, true if the edge runs
        // from the higher corner number to the lower, and the edge's number.
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

    /// Returns the number of an occluder's first edge. The other edges follow in the order of its border.
    pub fn first(&self, occluder: OccluderId) -> u32 {
        self.first[occluder.0 as usize]
    }

    /// Returns at most eight occluders with this edge.
    ///
    /// The flag of an occluder is true if its border runs along the edge from the higher corner number to the
    /// lower.
    pub fn sharing(&self, edge: u32) -> &[(OccluderId, bool)] {
        let group = self.group[edge as usize] as usize;
        let all = &self.sharing[self.groups[group] as usize..self.groups[group + 1] as usize];
        &all[..all.len().min(MOST_AT_EDGE)]
    }
}
