//! How much of a region an occluder blocks, and the subtraction of that part.

use std::cmp::Ordering;

use crate::line_space::cone::Region;
use crate::occluders::{OccluderId, Occluders};
use crate::search::local::{Constraint, Local};
use crate::search::side_bitsets::{both, count};

impl Local<'_> {
    /// Goes on to another region, of which [`crate::line_space::klein::contents`] has left the forms: what
    /// follows is about its rays, and real lines in it.
    pub fn begin(&mut self) {
        let many = self.forms.sample();
        self.side_bitsets.begin(many);
    }

    /// How much of the region an occluder blocks of lines that pass it one way: how many of its rays and of
    /// the lines in it, rounded.
    pub fn held(&mut self, scene: &Occluders, id: OccluderId, negative: bool) -> u32 {
        let mut rays = self.side_bitsets.all();
        for at in self.side_bitsets.shape(scene, self.space.frame(), id) {
            let edge = self.side_bitsets.edges(at..at + 1)[0];
            rays = both(rays, self.side_bitsets.inside(&self.forms, edge, negative));
        }
        count(rays)
    }

    /// An occluder's constraints, first those that most of the region is outside of: the sooner much is cut
    /// off, the less is cut again.
    pub fn order(&mut self, known: usize, negative: bool) -> Vec<usize> {
        let mut order: Vec<(u32, usize)> = Vec::with_capacity(self.known[known].lines.len());
        for (k, c) in self.known[known].lines.iter().enumerate() {
            let inside = match c.row {
                Some((row, back)) => self.side_bitsets.row(&self.forms, row)[usize::from(back != negative)],
                None => {
                    let sides = self.side_bitsets.sides_of(&self.forms, self.space.rounded(c.line));
                    sides[usize::from(c.flipped != negative)]
                }
            };
            order.push((count(inside), k));
        }
        order.sort_unstable();
        order.into_iter().map(|(_, k)| k).collect()
    }

    /// Takes away from a region what an occluder blocks of it: the cuts made and the parts left outside each.
    /// Nothing when the occluder takes nothing away.
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
            let Constraint { line, flipped, number, .. } = self.known[known].lines[k];
            let rest = inside.as_ref().unwrap_or(region);
            rest.sides(&mut self.space, line, &mut sides);
            let inner = if flipped != negative { Ordering::Less } else { Ordering::Greater };
            if !sides.contains(&inner) {
                return None;
            }
            if !sides.contains(&inner.reverse()) {
                continue;
            }
            let [less, greater] = rest.split(&mut self.space, line, &sides).ok()?;
            let (inner, out) = if inner == Ordering::Less { (less, greater) } else { (greater, less) };
            inside = Some(inner);
            cuts.push(number);
            outside.push(out);
        }
        self.sides = sides;
        Some((cuts, outside))
    }
}
