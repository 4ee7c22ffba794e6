//! How much of a region an occluder blocks, and joining it with its neighbours for as long as that blocks more.
//!
//! What lines pass in the same direction has one silhouette (thesis §2.4), so triangles that hang together block together.

use crate::cone::Region;
use crate::local::{Constraints, Edge, Local, lines_of, triangles};
use crate::occluder::Occluders;
use crate::rows::{both, count};

/// Most occluders that are joined to one for the sake of a region.
const MOST_MEMBERS: usize = 12;

impl Local<'_> {
    /// Goes on to another region: what follows is about its rays.
    pub fn begin(&mut self, region: &Region) {
        self.rows.begin(&self.space, region);
    }

    /// Which way a line passes an occluder: all edges agree, but for rounding.
    pub fn passes_negatively(&self, known: usize, line: &[f64; 6]) -> bool {
        let side = |line_of: &(crate::vector::Id, bool, u16)| {
            let s = crate::vector::klein(line, self.space.rounded(line_of.0));
            if line_of.1 { -s } else { s }
        };
        self.known[known].lines.iter().map(side).sum::<f64>() < 0.0
    }

    /// How many rays of the region an occluder blocks, rounded.
    pub fn held(&mut self, known: usize, negative: bool) -> u32 {
        let mut rays = self.rows.all();
        for (line, flipped, _) in &self.known[known].lines {
            rays = both(rays, self.rows.side(&self.space, *line, *flipped != negative));
        }
        count(rays)
    }

    /// An occluder's constraints, first those that most of the region's rays are outside of: the sooner much is cut off, the less
    /// is cut again.
    pub fn order(&mut self, known: usize, negative: bool) -> Vec<usize> {
        let mut order: Vec<(u32, usize)> = Vec::with_capacity(self.known[known].lines.len());
        for (k, (line, flipped, _)) in self.known[known].lines.iter().enumerate() {
            order.push((count(self.rows.side(&self.space, *line, *flipped != negative)), k));
        }
        order.sort_unstable();
        order.into_iter().map(|(_, k)| k).collect()
    }

    /// Adds neighbours to an occluder for as long as that makes it block more of the region. None if there is nothing to add.
    pub fn grow(&mut self, scene: &Occluders, (known, negative, held): (usize, bool, u32)) -> Option<usize> {
        let every = self.rows.all();
        let all = count(every);
        if !self.known[known].between || held == all {
            return None;
        }
        let (mut best, mut most) = (known, held);
        while self.known[best].members.len() < MOST_MEMBERS {
            let mut next: Option<(u32, u32, bool)> = None;
            for at in 0..self.known[best].edges.len() {
                let e = self.known[best].edges[at];
                // Only over edges that part of the region passes outside of.
                if self.rows.side(&self.space, e.line, e.flipped != negative) == every {
                    continue;
                }
                // Its border must run the other way along the edge, so it is turned round where it runs the same way.
                for (o, same_way) in scene.at_edge(e.corners) {
                    if self.known[best].members.iter().any(|m| m.0 == o) {
                        continue;
                    }
                    let Some(with) = self.constraints(scene, o).filter(|k| self.known[*k].between) else {
                        continue;
                    };
                    let count = self.held_with(best, (with, same_way), negative);
                    if count > most && next.is_none_or(|(c, _, _)| count > c) {
                        next = Some((count, o, same_way));
                    }
                }
            }
            let Some((count, o, turned)) = next else { break };
            let mut members = self.known[best].members.clone();
            members.push((o, turned));
            members.sort_unstable();
            let Some(patch) = self.patch(scene, members) else { break };
            (best, most) = (patch, count);
            if most == all {
                break;
            }
        }
        (best != known).then_some(best)
    }

    /// How many rays an occluder would block together with another, perhaps turned round: inside all edges but those along which
    /// the two run in opposite directions. None if no edge remains: two sides of one sheet block nothing together.
    fn held_with(&mut self, known: usize, (with, turned): (usize, bool), negative: bool) -> u32 {
        let (own, others) = (&self.known[known].edges, &self.known[with].edges);
        let back = |e: &Edge| if turned { e.corners } else { [e.corners[1], e.corners[0]] };
        let mut rays = self.rows.all();
        let mut border = false;
        for e in own.iter().filter(|e| !others.iter().any(|o| back(o) == e.corners)) {
            rays = both(rays, self.rows.side(&self.space, e.line, e.flipped != negative));
            border = true;
        }
        for o in others.iter().filter(|o| !own.iter().any(|e| back(o) == e.corners)) {
            rays = both(rays, self.rows.side(&self.space, o.line, (o.flipped != turned) != negative));
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
        let lines = lines_of(&edges);
        let at = (!lines.is_empty()).then(|| {
            self.known.push(Constraints { members: members.clone(), between: true, lines, edges });
            self.known.len() - 1
        });
        self.patches.insert(members, at);
        at
    }
}
