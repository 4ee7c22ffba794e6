//! How much of a region an occluder blocks, and joining it with neighbours until many of them add nothing.
//!
//! What lines pass in the same direction has one silhouette (thesis §2.4), so triangles that hang together block together.

use crate::local::{Constraints, Local, lines_of, triangles};
use crate::occluder::Occluders;
use crate::rows::{Bits, RimEdge, both, count};

/// Most occluders that are joined to one for the sake of a region.
const MOST_MEMBERS: usize = 256;
/// So many that add nothing are added one after the other before that is given up, or as many as there are already.
const IN_VAIN: usize = 8;

/// An edge of the border of what grows.
pub struct Limit {
    edge: RimEdge,
    /// What of the region is on its inner side, and how much.
    inside: Bits,
    count: u32,
    /// Whether nothing can be added over it.
    last: bool,
}

impl Local<'_> {
    /// Goes on to another region, of which [`crate::klein::contents`] has left the forms: what follows is about its rays, and
    /// real lines in it.
    pub fn begin(&mut self) {
        let many = self.forms.sample();
        self.rows.begin(many);
    }

    /// How much of the region an occluder blocks of lines that pass it one way: how many of its rays and of the lines in it,
    /// rounded.
    pub fn held(&mut self, scene: &Occluders, id: u32, negative: bool) -> u32 {
        let mut rays = self.rows.all();
        for at in self.rows.shape(scene, self.space.frame(), id) {
            let edge = self.rows.edges(at..at + 1)[0];
            rays = both(rays, self.rows.inside(&self.forms, edge, negative));
        }
        count(rays)
    }

    /// An occluder's constraints, first those that most of the region is outside of: the sooner much is cut off, the less
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

    /// Adds neighbours to an occluder, always over the edge that most of the region is outside of, until some more of them add nothing;
    /// an index into `known`. None if no neighbours make it block more of the region.
    ///
    /// One neighbour often adds nothing and a few do: it takes most of a curved surface's facets to block what one of them is amid.
    pub fn grow(&mut self, scene: &Occluders, (id, negative, held): (u32, bool, u32)) -> Option<usize> {
        let every = self.rows.all();
        let all = count(every);
        if held == all || !self.is_between(scene, id) {
            return None;
        }
        let mut border = std::mem::take(&mut self.border);
        border.clear();
        let mut members = vec![(id, false)];
        self.join(scene, &mut border, (id, false), negative);
        let (mut most, mut best) = (held, 1);
        while most < all && members.len() < MOST_MEMBERS.min(best + best.max(IN_VAIN)) {
            let Some(next) = self.beyond(scene, &mut border, &members, all) else { break };
            members.push(next);
            self.join(scene, &mut border, next, negative);
            let held = count(border.iter().fold(every, |all, limit| both(all, limit.inside)));
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

    /// Adds an occluder, perhaps turned round, to what has a border: the edges along which the two run in opposite directions go.
    fn join(
        &mut self,
        scene: &Occluders,
        border: &mut Vec<Limit>,
        (id, turned): (u32, bool),
        negative: bool,
    ) {
        for at in self.rows.shape(scene, self.space.frame(), id) {
            let edge = self.rows.edges(at..at + 1)[0];
            let edge = if turned { edge.reversed() } else { edge };
            let [from, to] = edge.corners;
            if let Some(other) = border.iter().position(|l| l.edge.corners == [to, from]) {
                border.remove(other);
            } else {
                let inside = self.rows.inside(&self.forms, edge, negative);
                border.push(Limit { edge, inside, count: count(inside), last: false });
            }
        }
    }

    /// What can be added over the edge that most of the region is outside of, and whether it is to be turned round.
    fn beyond(
        &mut self,
        scene: &Occluders,
        border: &mut [Limit],
        members: &[(u32, bool)],
        all: u32,
    ) -> Option<(u32, bool)> {
        loop {
            let limit = border.iter_mut().filter(|l| !l.last && l.count < all).min_by_key(|l| l.count)?;
            for (id, back) in scene.rims().sharing(limit.edge.number) {
                if !members.iter().any(|m| m.0 == *id) && self.is_between(scene, *id) {
                    // Its border must run the other way along the edge, so it is turned round where it runs the same way.
                    return Some((*id, *back == limit.edge.back()));
                }
            }
            limit.last = true;
        }
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
