//! How much of a region an occluder blocks, and the subtraction of that part.

use std::cmp::Ordering;

use crate::line_space::cone::Region;
use crate::occluders::{OccluderId, Occluders};
use crate::search::local::{Constraint, Local};
use crate::search::side_bitsets::{both, count};

impl Local<'_> {
    /// Starts with the region whose forms [`crate::line_space::klein::contents`] computed last. Later calls
    /// use its rays and the real lines sampled here.
    pub fn begin(&mut self) {
        let many = self.forms.sample();
        self.side_bitsets.begin(many);
    }

    /// How much of the region an occluder blocks among the lines that pass it in one direction: the number of
    /// blocked rays and sampled lines, by rounded signs.
    pub fn held(&mut self, scene: &Occluders, id: OccluderId, negative: bool) -> u32 {
        let mut rays = self.side_bitsets.all();
        for at in self.side_bitsets.shape(scene, self.space.frame(), id) {
            let edge = self.side_bitsets.edges(at..at + 1)[0];
            rays = both(rays, self.side_bitsets.inside(&self.forms, edge, negative));
        }
        count(rays)
    }

    /// An occluder's constraints; those with the largest part of the region outside come first, since large
    /// early cuts leave less to cut later.
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

    /// Subtracts from a region the part that an occluder blocks. Returns the cuts made and the part outside
    /// each cut; None if the occluder blocks nothing or a part becomes too complex.
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
