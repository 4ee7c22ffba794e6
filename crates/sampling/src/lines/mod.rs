//! The default sampler: sight lines shared by all the cells they cross.
//!
//! A maximal free segment runs from one triangle to another (or to the sky) and shows both its ends to every cell it
//! crosses (Bittner et al. 2009, "Adaptive Global Visibility Sampling"). The cells of a block share one table of what is
//! seen from where ([`bits`]); lines are traced in packets ([`packet`]), coherent where they run alike, and walked through the cells
//! ([`grid`]). Four kinds of lines ([`Kind`]) find what is missing, in rounds ([`block`]), until a cell's own estimate of
//! what it misses is small enough; [`bound`] then says how far that can be trusted.
//!
//! Results do not depend on threads: every decision reads what was known at the last barrier, or the cell's own finds.

mod adaptive;
pub mod bits;
pub mod block;
pub mod bound;
mod candidates;
mod cubes;
mod flood;
pub mod grid;
mod guided;
pub mod packet;
mod seeds;
pub mod sequence;
pub mod surface;
mod tile;
mod yields;

pub use adaptive::MOST_DEPTH;
pub use tile::run;

/// The kinds of sight lines, in the order of [`CellStats::rays`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Evenly over directions and the cell: what they miss is an estimate of what is missing.
    Uniform,
    /// From where a new triangle was seen to its unseen neighbours.
    Flood,
    /// To what the next cell sees and this one does not.
    Candidate,
    /// Held-out lines of a bound.
    Check,
}

/// How a cell came to its set. Everything here is the same on every run; times are not, and are kept with the tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellStats {
    /// Rays cast from the cell by [`Kind`].
    pub rays: [u64; 4],
    /// Triangles they were first to show to the cell, as of the last barrier before each; of held-out lines, how many met
    /// something new.
    pub finds: [u64; 4],
    /// Rounds it took part in.
    pub rounds: u32,
    /// Uniform rays of its last round.
    pub last_rays: u64,
    /// Those that met a triangle not yet in the set.
    pub last_misses: u64,
    /// Held-out lines of the last look, 0 without a bound.
    pub bound_lines: u64,
    /// Those that met a triangle not in the set.
    pub bound_misses: u64,
    /// Which look that was, from 1.
    pub bound_look: u32,
    /// Whether the time or the rounds ended before the cell was done.
    pub unfinished: bool,
    /// Whether it was done with more expected to be missing than the target, because it took far more work than the others
    /// ([`block::Hard`]).
    pub spared: bool,
}

impl CellStats {
    /// Names of [`CellStats::numbers`], as results and tables have them.
    pub const NAMES: [&'static str; 16] = [
        "rays_uniform",
        "rays_flood",
        "rays_candidate",
        "rays_check",
        "finds_uniform",
        "finds_flood",
        "finds_candidate",
        "finds_check",
        "rounds",
        "last_rays",
        "last_misses",
        "bound_lines",
        "bound_misses",
        "bound_look",
        "unfinished",
        "spared",
    ];

    /// Of a cell made of two, each of which was sampled by itself.
    pub fn joined(&self, other: &Self) -> Self {
        let sums = |a: [u64; 4], b: [u64; 4]| std::array::from_fn(|k| a[k] + b[k]);
        Self {
            rays: sums(self.rays, other.rays),
            finds: sums(self.finds, other.finds),
            rounds: self.rounds.max(other.rounds),
            last_rays: self.last_rays + other.last_rays,
            last_misses: self.last_misses + other.last_misses,
            // A bound is of one cell.
            bound_lines: 0,
            bound_misses: 0,
            bound_look: 0,
            unfinished: self.unfinished || other.unfinished,
            spared: self.spared || other.spared,
        }
    }

    /// All of it, in the order of [`CellStats::NAMES`].
    pub fn numbers(&self) -> [u64; Self::NAMES.len()] {
        let ([a, b, c, d], [e, f, g, h]) = (self.rays, self.finds);
        let [i, j, k] = [u64::from(self.rounds), self.last_rays, self.last_misses];
        let [l, m, n] = [self.bound_lines, self.bound_misses, u64::from(self.bound_look)];
        let [o, p] = [self.unfinished, self.spared].map(u64::from);
        [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p]
    }

    /// Back from [`CellStats::numbers`]; `None` where one is beyond its range.
    pub fn from_numbers(
        [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p]: [u64; Self::NAMES.len()],
    ) -> Option<Self> {
        let flag = |number: u64| (number < 2).then_some(number == 1);
        Some(Self {
            rays: [a, b, c, d],
            finds: [e, f, g, h],
            rounds: i.try_into().ok()?,
            last_rays: j,
            last_misses: k,
            bound_lines: l,
            bound_misses: m,
            bound_look: n.try_into().ok()?,
            unfinished: flag(o)?,
            spared: flag(p)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_their_names_and_come_back() {
        let numbers: [u64; CellStats::NAMES.len()] =
            std::array::from_fn(|i| if i >= 14 { 15 - i as u64 } else { i as u64 + 10 });
        let stats = CellStats::from_numbers(numbers).unwrap();
        assert_eq!(stats.numbers(), numbers);
        let of = |name: &str| numbers[CellStats::NAMES.iter().position(|n| *n == name).unwrap()];
        assert_eq!(
            [of("rays_uniform"), of("rays_flood"), of("rays_candidate"), of("rays_check")],
            stats.rays
        );
        assert_eq!(
            [of("finds_uniform"), of("finds_flood"), of("finds_candidate"), of("finds_check")],
            stats.finds
        );
        assert_eq!([of("rounds"), of("bound_look")], [u64::from(stats.rounds), u64::from(stats.bound_look)]);
        assert_eq!([of("last_rays"), of("last_misses")], [stats.last_rays, stats.last_misses]);
        assert_eq!([of("bound_lines"), of("bound_misses")], [stats.bound_lines, stats.bound_misses]);
        assert!(of("unfinished") == 1 && stats.unfinished && of("spared") == 0 && !stats.spared);
        // Beyond their ranges.
        for i in [8, 13, 14, 15] {
            let mut wrong = numbers;
            wrong[i] = u64::MAX;
            assert_eq!(CellStats::from_numbers(wrong), None);
        }
    }
}
