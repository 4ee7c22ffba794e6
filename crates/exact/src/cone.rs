//! Regions of line space: convex cones in six dimensions, kept as rays with the half-spaces tight at each.
//!
//! The double description method (Motzkin et al. 1953; Fukuda & Prodon 1996): a half-space splits a cone by
//! keeping rays on its side and adding one ray on every edge it crosses. Two rays share an edge exactly when no third
//! is tight wherever both are. No faces in between are kept (Haumont 2005). Signs are exact, so tight sets are, too.

use std::cmp::Ordering;

use crate::vector::{Id, Space};

/// Set of half-spaces of a region, a bit each.
pub type Tight = u128;
/// Most half-spaces of a region, kept free of those that bound nothing.
pub const MOST_HALVES: usize = 128;

/// A pointed cone with inner points: a set of lines, real and not.
#[derive(Clone, Debug)]
pub struct Region {
    /// Extreme rays, and where each is tight.
    pub rays: Vec<(Id, Tight)>,
    /// The lines whose hyperplanes bound the region; a bit of [`Tight`] is an index here.
    pub halves: Vec<Id>,
}

/// A region has more facets than [`MOST_HALVES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooComplex;

impl Region {
    /// On which side of a line's hyperplane each ray is.
    pub fn sides(&self, space: &mut Space, line: Id, out: &mut Vec<Ordering>) {
        out.clear();
        let known = self.halves.iter().position(|h| *h == line).map_or(0, |i| 1u128 << i);
        for (ray, tight) in &self.rays {
            out.push(if tight & known != 0 {
                Ordering::Equal
            } else {
                space.ray_side(*ray, line, self.tight(*tight))
            });
        }
    }

    /// The lines of a set.
    pub fn tight(&self, set: Tight) -> impl Iterator<Item = Id> {
        self.halves.iter().enumerate().filter(move |(k, _)| set >> k & 1 == 1).map(|(_, h)| *h)
    }

    /// The parts on the negative and on the positive side of a line, given the sides of all rays, both of which
    /// must occur.
    ///
    /// # Errors
    /// [`TooComplex`] when the region has as many facets as there are bits.
    pub fn split(&self, space: &mut Space, line: Id, sides: &[Ordering]) -> Result<[Self; 2], TooComplex> {
        let mut base = self;
        let compacted;
        if self.halves.len() >= MOST_HALVES {
            compacted = self.compact();
            if compacted.halves.len() >= MOST_HALVES {
                return Err(TooComplex);
            }
            base = &compacted;
        }
        let bit = 1u128 << base.halves.len();
        let mut halves = base.halves.clone();
        halves.push(line);
        let mut parts = [Ordering::Less, Ordering::Greater].map(|keep| {
            let rays = base.rays.iter().zip(sides).filter(|(_, s)| **s != keep.reverse());
            let mut rays: Vec<(Id, Tight)> =
                rays.map(|((r, t), s)| (*r, if *s == Ordering::Equal { t | bit } else { *t })).collect();
            rays.reserve(8);
            Self { rays, halves: halves.clone() }
        });
        for (i, (p, tp)) in base.rays.iter().enumerate() {
            if sides[i] != Ordering::Greater {
                continue;
            }
            for (j, (n, tn)) in base.rays.iter().enumerate() {
                let common = tp & tn;
                // The border of an edge is four-dimensional: at least four half-spaces are tight along it.
                if sides[j] != Ordering::Less || common.count_ones() < 4 {
                    continue;
                }
                let third = |(k, (_, t)): (usize, &(Id, Tight))| k != i && k != j && t & common == common;
                if !base.rays.iter().enumerate().any(third) {
                    let cut = space.cut(*p, *n, line);
                    parts.iter_mut().for_each(|part| part.rays.push((cut, common | bit)));
                }
            }
        }
        Ok(parts)
    }

    /// Without the half-spaces that are tight at fewer than five rays and so bound nothing of full dimension.
    pub fn compact(&self) -> Self {
        let kept: Vec<usize> = (0..self.halves.len())
            .filter(|h| self.rays.iter().filter(|(_, t)| t >> h & 1 == 1).take(5).count() == 5)
            .collect();
        let rays = self
            .rays
            .iter()
            .map(|(r, t)| {
                (*r, kept.iter().enumerate().fold(0, |bits, (new, old)| bits | (t >> old & 1) << new))
            })
            .collect();
        Self { rays, halves: kept.iter().map(|h| self.halves[*h]).collect() }
    }
}
