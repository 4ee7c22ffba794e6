//! The measure of the part of a region that an occluder blocks, and the subtraction of that part.

use std::cmp::Ordering;

use crate::line_space::cone::Region;
use crate::occluders::{OccluderId, Occluders};
use crate::search::local::{Constraint, PairState};
use crate::search::side_bitsets::{both, count};

impl PairState<'_> {
    /// Prepares the ranking of occluders for the region that was last passed to
    /// [`crate::line_space::klein::contents`].
    ///
    /// Later calls use the rays of this region and the real lines that this function samples.
    pub fn begin(&mut self) {
        let many = self.forms.sample();
        self.side_bitsets.begin(many);
    }

    /// Estimates the part of the region that an occluder blocks, for lines that pass the occluder in one
    /// direction.
    ///
    /// The result is the number of blocked rays and sampled lines, by rounded signs.
    pub fn held(&mut self, scene: &Occluders, id: OccluderId, negative: bool) -> u32 {
        let mut rays = self.side_bitsets.all();
        for at in self.side_bitsets.shape(scene, self.space.frame(), id) {
            let edge = self.side_bitsets.edges(at..at + 1)[0];
            rays = both(rays, self.side_bitsets.inside(&self.forms, edge, negative));
        }
        count(rays)
    }

    /// Returns the order in which [`PairState::subtract`] cuts a region: indices into the constraints of the
    /// occluder `known`.
    ///
    /// Constraints with the largest part of the region outside come first, because large early cuts leave
    /// smaller parts for later cuts.
    pub fn order(&mut self, known: usize, negative: bool) -> Vec<usize> {
        let mut order: Vec<(u32, usize)> = Vec::with_capacity(self.known[known].lines.len());
        for (k, c) in self.known[known].lines.iter().enumerate() {
            let inside = match c.row {
                Some((row, back)) => {
                    self.side_bitsets.row(&self.forms, row)[usize::from(back != negative)]
                }
                None => {
                    let sides = self
                        .side_bitsets
                        .sides_of(&self.forms, self.space.rounded(c.line));
                    sides[usize::from(c.flipped != negative)]
                }
            };
            order.push((count(inside), k));
        }
        order.sort_unstable();
        order.into_iter().map(|(_, k)| k).collect()
    }

    /// Subtracts from a region the part that an occluder blocks. `known` is the occluder's index in the field
    /// `known`. `negative` is true if lines pass the occluder's edges on their negative side.
    ///
    /// The result contains the numbers of the half-spaces that cut the region, and for each cut the part of
    /// the region outside that half-space. It is `None` if the occluder does not block any part, or if a part
    /// becomes too complex.
    pub fn subtract(
        &mut self,
        region: &Region,
        known: usize,
        negative: bool,
    ) -> Option<(Vec<u16>, Vec<Region>)> {
        let mut cuts = Vec::new();
        let mut outside = Vec::new();
        let mut sides = std::mem::take(&mut self.sides);
        let mut inside: Option<Region> = None;
        for k in self.order(known, negative) {
            let Constraint {
                line,
                flipped,
                number,
                ..
            } = self.known[known].lines[k];
            let rest = inside.as_ref().unwrap_or(region);
            rest.sides(&mut self.space, line, &mut sides);
            let inner = if flipped != negative {
                Ordering::Less
            } else {
                Ordering::Greater
            };
            if !sides.contains(&inner) {
                return None;
            }
            if !sides.contains(&inner.reverse()) {
                continue;
            }
            let [less, greater] = rest.split(&mut self.space, line, &sides).ok()?;
            let (inner, out) = if inner == Ordering::Less {
                (less, greater)
            } else {
                (greater, less)
            };
            inside = Some(inner);
            cuts.push(number);
            outside.push(out);
        }
        self.sides = sides;
        Some((cuts, outside))
    }
}
