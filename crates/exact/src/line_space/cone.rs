//! Regions of line space: convex cones in six dimensions, stored as extreme rays, each with the half-spaces
//! tight at it.
//!
//! The module uses the double description method (Motzkin et al. 1953; Fukuda and Prodon 1996). A half-space
//! splits a cone by keeping the rays on its side and adding one ray on every edge that it crosses. Two rays
//! share an edge exactly if no third ray is tight in all half-spaces that are tight at both. Faces of other
//! dimensions are not stored (Haumont et al. 2005). Signs are exact, so tight sets are exact too.

use std::cmp::Ordering;
use std::rc::Rc;

use crate::line_space::space::{Space, Tight, VectorId};

/// The maximum number of half-spaces of a region.
///
/// [`Region::split`] removes redundant half-spaces before it returns an error.
pub const MOST_HALVES: usize = 128;

/// A pointed cone with interior points. Its vectors need not be real lines.
#[derive(Clone, Debug)]
pub struct Region {
    /// The extreme rays, each with the half-spaces that are tight at it.
    pub rays: Vec<(VectorId, Tight)>,
    /// The lines whose hyperplanes bound the region. A bit of [`Tight`] is an index into this list.
    pub halves: Rc<[VectorId]>,
}

/// The error that a region has [`MOST_HALVES`] facets, so that another half-space has no bit in [`Tight`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooComplex;

impl Region {
    /// Computes the side of a line's hyperplane on which each ray lies, and writes the sides to `out` in the
    /// order of the rays.
    pub fn sides(&self, space: &mut Space, line: VectorId, out: &mut Vec<Ordering>) {
        out.clear();
        let known = self
            .halves
            .iter()
            .position(|h| *h == line)
            .map_or(0, |i| 1u128 << i);
        let mut sure = 0;
        for (ray, tight) in &self.rays {
            out.push(if tight & known != 0 {
                Ordering::Equal
            } else if let Some(side) = space.filtered_side(*ray, line) {
                sure += 1;
                side
            } else {
                space.unfiltered_ray_side(*ray, line, self.tight(*tight))
            });
        }
        space.decisions.filtered += sure;
    }

    /// Returns the lines whose hyperplanes bound the half-spaces of a set.
    pub fn tight(&self, set: Tight) -> impl Iterator<Item = VectorId> {
        Self::lines(&self.halves, set)
    }

    fn lines(halves: &[VectorId], set: Tight) -> impl Iterator<Item = VectorId> {
        halves
            .iter()
            .enumerate()
            .filter(move |(k, _)| set >> k & 1 == 1)
            .map(|(_, h)| *h)
    }

    /// Splits the region into the parts on the negative and on the positive side of a line.
    ///
    /// `sides` contains the side of each ray; both sides must occur.
    ///
    /// # Errors
    /// [`TooComplex`] if the region has [`MOST_HALVES`] facets, also without redundant half-spaces.
    pub fn split(
        &self,
        space: &mut Space,
        line: VectorId,
        sides: &[Ordering],
    ) -> Result<[Self; 2], TooComplex> {
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
        let mut halves = Vec::with_capacity(base.halves.len() + 1);
        halves.extend_from_slice(&base.halves);
        halves.push(line);
        let halves: Rc<[VectorId]> = halves.into();
        let kept = |keep: Ordering| sides.iter().filter(|s| **s != keep.reverse()).count();
        let mut parts = [Ordering::Less, Ordering::Greater].map(|keep| {
            // The capacity has room for two cuts per removed ray.
            let most = 2 * sides.len() - kept(keep);
            let mut rays: Vec<(VectorId, Tight)> = Vec::with_capacity(most);
            rays.extend(
                base.rays
                    .iter()
                    .zip(sides)
                    .filter(|(_, s)| **s != keep.reverse())
                    .map(|((r, t), s)| (*r, if *s == Ordering::Equal { t | bit } else { *t })),
            );
            Self {
                rays,
                halves: halves.clone(),
            }
        });
        let mut cut = |i: usize, j: usize| {
            let ((p, tp), (n, tn)) = (base.rays[i], base.rays[j]);
            let common = tp & tn;
            let on = || Self::lines(&halves, common | bit).collect();
            let cut = space.cut([p, n], line, on);
            parts
                .iter_mut()
                .for_each(|part| part.rays.push((cut, common | bit)));
        };
        let edges = Edges::new(base);
        for i in (0..sides.len()).filter(|i| sides[*i] == Ordering::Greater) {
            edges.neighbours(base, i, |j| {
                if sides[j] == Ordering::Less {
                    cut(i, j);
                }
            });
        }
        Ok(parts)
    }

    /// Returns the region with the half-space of `line` added to its list. The half-space must contain the
    /// region.
    ///
    /// `sides` contains the side of each ray.
    pub fn within(&self, line: VectorId, sides: &[Ordering]) -> Self {
        let bit = 1u128 << self.halves.len();
        let tight = |side: &Ordering| if *side == Ordering::Equal { bit } else { 0 };
        let rays = self
            .rays
            .iter()
            .zip(sides)
            .map(|((r, t), side)| (*r, t | tight(side)))
            .collect();
        Self {
            rays,
            halves: self.halves.iter().copied().chain([line]).collect(),
        }
    }

    /// Returns the region without redundant half-spaces: a half-space that is tight at fewer than five rays
    /// bounds no facet.
    pub fn compact(&self) -> Self {
        let kept: Vec<usize> = (0..self.halves.len())
            .filter(|h| {
                self.rays
                    .iter()
                    .filter(|(_, t)| t >> h & 1 == 1)
                    .take(5)
                    .count()
                    == 5
            })
            .collect();
        let rays = self
            .rays
            .iter()
            .map(|(r, t)| {
                (
                    *r,
                    kept.iter()
                        .enumerate()
                        .fold(0, |bits, (new, old)| bits | (t >> old & 1) << new),
                )
            })
            .collect();
        Self {
            rays,
            halves: kept.iter().map(|h| self.halves[*h]).collect(),
        }
    }
}

/// The incidence of rays and half-spaces, which determines the rays that share an edge.
struct Edges {
    /// For each half-space, the set of rays at which it is tight, one bit per ray; `None` if the region has
    /// more than 128 rays.
    on: Option<Vec<u128>>,
}

impl Edges {
    fn new(region: &Region) -> Self {
        let on = (region.rays.len() <= 128).then(|| {
            let mut on = vec![0u128; region.halves.len()];
            for (i, (_, tight)) in region.rays.iter().enumerate() {
                let mut left = *tight;
                while left != 0 {
                    on[left.trailing_zeros() as usize] |= 1 << i;
                    left &= left - 1;
                }
            }
            on
        });
        Self { on }
    }

    /// Calls `found` with each ray that shares an edge with ray `i`.
    ///
    /// The tight half-spaces of an extreme ray have rank 5. If exactly five are tight, any four of them are
    /// tight along one edge and nowhere else. The only other ray at which these four are tight is the other
    /// end of the edge.
    fn neighbours(&self, region: &Region, i: usize, mut found: impl FnMut(usize)) {
        let tight = region.rays[i].1;
        match &self.on {
            Some(on) if tight.count_ones() == 5 => {
                let mut ray_sets = [0u128; 5];
                let mut left = tight;
                for set in &mut ray_sets {
                    *set = on[left.trailing_zeros() as usize];
                    left &= left - 1;
                }
                let [a, b, c, d, e] = ray_sets;
                let (ab, de) = (a & b, d & e);
                let abc = ab & c;
                let cde = c & de;
                for edge in [b & cde, a & cde, ab & de, abc & e, abc & d] {
                    let other = edge & !(1 << i);
                    if other.is_power_of_two() {
                        found(other.trailing_zeros() as usize);
                    }
                }
            }
            _ => {
                for j in (0..region.rays.len()).filter(|j| *j != i) {
                    if self.joined(region, [i, j], tight & region.rays[j].1) {
                        found(j);
                    }
                }
            }
        }
    }

    /// Returns true if two rays share an edge.
    ///
    /// This is the case if no third ray is tight in all of `common`, the half-spaces tight at both.
    fn joined(&self, region: &Region, [i, j]: [usize; 2], common: Tight) -> bool {
        // At least four half-spaces are tight along an edge, because an edge is a face of two of the six
        // dimensions.
        let mut left = common;
        for _ in 0..3 {
            left &= left.wrapping_sub(1);
        }
        if left == 0 {
            return false;
        }
        let Some(on) = &self.on else {
            let third =
                |(k, (_, t)): (usize, &(VectorId, Tight))| k != i && k != j && t & common == common;
            return !region.rays.iter().enumerate().any(third);
        };
        let two = 1u128 << i | 1u128 << j;
        let (mut rays, mut left) = (u128::MAX, common);
        while left != 0 && rays != two {
            rays &= on[left.trailing_zeros() as usize];
            left &= left - 1;
        }
        rays == two
    }
}

#[cfg(test)]
impl Region {
    /// Returns the rays that share an edge with ray `i`, computed in two ways.
    ///
    /// The first list is from [`Edges`]; the second is from tests of all pairs against all third rays.
    pub fn neighbours_twice(&self, i: usize) -> [Vec<usize>; 2] {
        let edges = Edges::new(self);
        let mut found = Vec::new();
        edges.neighbours(self, i, |j| found.push(j));
        found.sort_unstable();
        let tight = |j: usize| self.rays[j].1;
        let joined = |j: &usize| {
            let common = tight(i) & tight(*j);
            let third = |k: usize| k != i && k != *j && tight(k) & common == common;
            *j != i && common.count_ones() >= 4 && !(0..self.rays.len()).any(third)
        };
        [found, (0..self.rays.len()).filter(joined).collect()]
    }
}
