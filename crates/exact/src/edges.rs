//! The lines of occluders' edges in the space of a pair: one for all edges that run along it.
//!
//! Rays that are on an edge's line are then known to be on those of all edges along it.

use glam::Vec3;
use rustc_hash::FxHashMap;
use sightline_scene::exact::collinear;

use crate::local::{Edge, Local};
use crate::maps::with_room;
use crate::vector::Id;

/// Lines made so far.
pub struct EdgeLines {
    /// By the numbers of an edge's corners, the lesser first: its line, and whether that runs from the greater.
    edges: FxHashMap<[u32; 2], (Id, bool)>,
    /// By their fingerprints: what is the same line is in the same bucket, or the next. Each with two points it goes through.
    buckets: FxHashMap<i64, Vec<(Id, [Vec3; 2])>>,
}

impl EdgeLines {
    /// None yet.
    pub fn new() -> Self {
        Self { edges: with_room(64), buckets: with_room(64) }
    }
}

impl Local<'_> {
    /// The edges of a border, by numbers of corners and by their ends.
    pub fn edges(&mut self, rim: &[[u32; 2]], border: &[[Vec3; 2]]) -> Vec<Edge> {
        rim.iter().zip(border).map(|(corners, ends)| self.edge(*corners, *ends)).collect()
    }

    fn edge(&mut self, corners: [u32; 2], [p, q]: [Vec3; 2]) -> Edge {
        let back = corners[0] > corners[1];
        let key = if back { [corners[1], corners[0]] } else { corners };
        if let Some((line, flipped)) = self.lines.edges.get(&key) {
            return Edge { line: *line, flipped: *flipped != back };
        }
        let [a, b] = [self.corner(corners[0], p), self.corner(corners[1], q)];
        let new = self.space.join(a, b);
        let fingerprint = self.space.fingerprint(new);
        let same = (fingerprint - 1..=fingerprint + 1)
            .filter_map(|f| self.lines.buckets.get(&f))
            .flatten()
            .find(|(_, [r, s])| collinear(*r, *s, p) && collinear(*r, *s, q));
        let (line, flipped) = match same {
            Some((line, other)) => (*line, !same_way(*other, [p, q])),
            None => {
                self.lines.buckets.entry(fingerprint).or_default().push((new, [p, q]));
                (new, false)
            }
        };
        self.lines.edges.insert(key, (line, flipped != back));
        Edge { line, flipped }
    }
}

/// Whether two edges on one line run the same way.
fn same_way(e: [Vec3; 2], f: [Vec3; 2]) -> bool {
    (0..3).all(|k| (f[1][k] > f[0][k]) == (e[1][k] > e[0][k]) && (f[1][k] < f[0][k]) == (e[1][k] < e[0][k]))
}
