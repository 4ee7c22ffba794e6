//! How much of a region an occluder blocks, and joining it with its neighbours for as long as that blocks more.
//!
//! What lines pass in the same direction has one silhouette (thesis §2.4), so triangles that hang together block together.

use crate::cone::Region;
use crate::local::{Constraints, Local, lines_of, triangles};
use crate::occluder::{MOST_EDGES, Occluders};
use crate::rows::{RimEdge, both, count};

/// Most occluders that are joined to one for the sake of a region.
const MOST_MEMBERS: usize = 12;

impl Local<'_> {
    /// Goes on to another region: what follows is about its rays, as [`crate::klein::contents`] has left them.
    pub fn begin(&mut self, region: &Region) {
        self.rows.begin(region.rays.len());
    }

    /// Which way a line passes an occluder, and how many rays of the region that blocks, rounded.
    pub fn held(&mut self, scene: &Occluders, id: u32, line: &[f64; 6]) -> (bool, u32) {
        let shape = self.rows.shape(scene, self.space.frame(), id);
        let negative = self.rows.passes_negatively(self.rows.edges(shape.clone()), line);
        let mut rays = self.rows.all();
        for at in shape {
            let edge = self.rows.edges(at..at + 1)[0];
            rays = both(rays, self.rows.inside(&self.forms, edge, negative));
        }
        (negative, count(rays))
    }

    /// An occluder's constraints, first those that most of the region's rays are outside of: the sooner much is cut off, the less
    /// is cut again.
    pub fn order(&mut self, known: usize, negative: bool) -> Vec<usize> {
        let mut order: Vec<(u32, usize)> = Vec::with_capacity(self.known[known].lines.len());
        for (k, c) in self.known[known].lines.iter().enumerate() {
            let inside = match c.row {
                Some((row, back)) => self.rows.row(&self.forms, row)[usize::from(back != negative)],
                None => {
                    let sides = self.rows.sides_of(&self.forms, self.space.rounded(c.line));
                    sides[usize::from(c.flipped != negative)]
                }
            };
            order.push((count(inside), k));
        }
        order.sort_unstable();
        order.into_iter().map(|(_, k)| k).collect()
    }

    /// Adds neighbours to an occluder for as long as that makes it block more of the region; an index into `known`. None if there
    /// is nothing to add.
    pub fn grow(&mut self, scene: &Occluders, (id, negative, held): (u32, bool, u32)) -> Option<usize> {
        let every = self.rows.all();
        let all = count(every);
        if held == all || !self.is_between(scene, id) {
            return None;
        }
        let shape = self.rows.shape(scene, self.space.frame(), id);
        let mut edges = self.rows.edges(shape).to_vec();
        let mut members = vec![(id, false)];
        let mut most = held;
        while members.len() < MOST_MEMBERS && most < all {
            let mut next: Option<(u32, u32, bool)> = None;
            for e in &edges {
                // Only over edges that part of the region passes outside of.
                if self.rows.inside(&self.forms, *e, negative) == every {
                    continue;
                }
                // Its border must run the other way along the edge, so it is turned round where it runs the same way.
                for (o, back) in scene.rims().sharing(e.number) {
                    if members.iter().any(|m| m.0 == *o) {
                        continue;
                    }
                    let turned = *back == e.back();
                    let count = self.held_with(scene, &edges, (*o, turned), negative);
                    if count > next.map_or(most, |n| n.0) && self.is_between(scene, *o) {
                        next = Some((count, *o, turned));
                    }
                }
            }
            let Some((count, o, turned)) = next else { break };
            let shape = self.rows.shape(scene, self.space.frame(), o);
            edges = joined(&edges, self.rows.edges(shape), turned).collect();
            members.push((o, turned));
            most = count;
        }
        if members.len() == 1 {
            return None;
        }
        members.sort_unstable();
        self.patch(scene, members)
    }

    /// How many rays an occluder would block together with another, perhaps turned round: inside all edges but those along which
    /// the two run in opposite directions. 0 if no edge remains: two sides of one sheet block nothing together.
    fn held_with(
        &mut self,
        scene: &Occluders,
        edges: &[RimEdge],
        (with, turned): (u32, bool),
        negative: bool,
    ) -> u32 {
        let shape = self.rows.shape(scene, self.space.frame(), with);
        let mut others = [RimEdge::default(); MOST_EDGES];
        let n = shape.len().min(MOST_EDGES);
        others[..n].copy_from_slice(&self.rows.edges(shape)[..n]);
        let mut rays = self.rows.all();
        let mut border = false;
        for e in joined(edges, &others[..n], turned) {
            rays = both(rays, self.rows.inside(&self.forms, e, negative));
            border = true;
        }
        if border { count(rays) } else { 0 }
    }

    /// Several occluders that are all between the polygons, as one; an index into `known`. None if they have no border.
    fn patch(&mut self, scene: &Occluders, members: Vec<(u32, bool)>) -> Option<usize> {
        if let Some(at) = self.patches.get(&members) {
            return *at;
        }
        let (rim, border) = scene.border(&triangles(scene, &members));
        let edges = self.edges(&rim, &border);
        let lines = lines_of(&edges, &rim, &self.rows);
        let at = (!lines.is_empty()).then(|| {
            self.known.push(Constraints { members: members.clone(), lines });
            self.known.len() - 1
        });
        self.patches.insert(members, at);
        at
    }
}

/// The edges of two borders, the second perhaps turned round, but for those along which they run in opposite directions.
fn joined<'a>(
    own: &'a [RimEdge],
    others: &'a [RimEdge],
    turned: bool,
) -> impl Iterator<Item = RimEdge> + use<'a> {
    let turn = move |e: &RimEdge| if turned { e.reversed() } else { *e };
    let opposite = |a: &RimEdge, b: &RimEdge| a.corners == [b.corners[1], b.corners[0]];
    own.iter()
        .filter(move |e| !others.iter().any(|o| opposite(e, &turn(o))))
        .copied()
        .chain(others.iter().map(turn).filter(move |o| !own.iter().any(|e| opposite(e, o))))
}
