//! Statistics of a cell as named columns: how sampling and exact queries came to its set.
//!
//! Every number is the same on every run of a job. Times differ from run to run and are kept with the tile
//! instead. The names are those of a result's columns; a name in this file never changes its meaning.

/// The kinds of sight lines, in the order of [`CellStats::rays`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineKind {
    /// Spread evenly over directions and the cell: the fraction that meets something new estimates the
    /// missing part.
    Uniform,
    /// From the eye that saw a new triangle to the triangle's unseen neighbours.
    Flood,
    /// To a triangle that the next cell sees and this cell does not.
    Candidate,
    /// Held out from the search, for a bound.
    Check,
}

/// How sampling with sight lines came to a cell's set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellStats {
    /// Rays cast from the cell, by [`LineKind`].
    pub rays: [u64; 4],
    /// Triangles that these rays were the first to show to the cell, as of the last barrier before each ray;
    /// for held-out lines, the number of lines that met a triangle outside the set.
    pub finds: [u64; 4],
    /// Rounds in which the cell took part.
    pub rounds: u32,
    /// Uniform rays of its last round.
    pub last_rays: u64,
    /// Those of them that met a triangle outside the set.
    pub last_misses: u64,
    /// Held-out lines of the last check, 0 without a bound.
    pub bound_lines: u64,
    /// Those of them that met a triangle outside the set.
    pub bound_misses: u64,
    /// The number of that check, from 1.
    pub bound_look: u32,
    /// Held-out lines of the last check of the cells that this one sees, 0 without a bound.
    pub bound_cell_lines: u64,
    /// Those of them that crossed a cell that is no pair with this one.
    pub bound_cell_misses: u64,
    /// The number of that check, from 1.
    pub bound_cell_look: u32,
    /// Whether the time or the rounds ended before the cell reached the target.
    pub unfinished: bool,
    /// Whether the cell ended within a tolerance above the target, because it took several times the work of
    /// the average cell. The column's name is `spared`.
    pub raised_tolerance: bool,
}

impl CellStats {
    /// The columns' names, in the order of [`CellStats::numbers`].
    pub const NAMES: [&'static str; 19] = [
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
        "bound_cell_misses",
        "bound_cell_lines",
        "bound_cell_look",
    ];

    /// The statistics of a cell that was joined from two cells, each of which was sampled alone.
    pub fn joined(&self, other: &Self) -> Self {
        let sums = |a: [u64; 4], b: [u64; 4]| std::array::from_fn(|k| a[k] + b[k]);
        Self {
            rays: sums(self.rays, other.rays),
            finds: sums(self.finds, other.finds),
            rounds: self.rounds.max(other.rounds),
            last_rays: self.last_rays + other.last_rays,
            last_misses: self.last_misses + other.last_misses,
            // A bound belongs to one cell alone.
            bound_lines: 0,
            bound_misses: 0,
            bound_look: 0,
            bound_cell_lines: 0,
            bound_cell_misses: 0,
            bound_cell_look: 0,
            unfinished: self.unfinished || other.unfinished,
            raised_tolerance: self.raised_tolerance || other.raised_tolerance,
        }
    }

    /// All values, in the order of [`CellStats::NAMES`].
    pub fn numbers(&self) -> [u64; Self::NAMES.len()] {
        let ([a, b, c, d], [e, f, g, h]) = (self.rays, self.finds);
        let [i, j, k] = [u64::from(self.rounds), self.last_rays, self.last_misses];
        let [l, m, n] = [
            self.bound_lines,
            self.bound_misses,
            u64::from(self.bound_look),
        ];
        let [o, p] = [self.unfinished, self.raised_tolerance].map(u64::from);
        let [q, r, s] = [
            self.bound_cell_misses,
            self.bound_cell_lines,
            u64::from(self.bound_cell_look),
        ];
        [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s]
    }

    /// The inverse of [`CellStats::numbers`]; `None` when a number is outside its field's range.
    pub fn from_numbers(
        [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s]: [u64; Self::NAMES.len()],
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
            raised_tolerance: flag(p)?,
            bound_cell_misses: q,
            bound_cell_lines: r,
            bound_cell_look: s.try_into().ok()?,
        })
    }
}

/// Defines statistics whose columns are its fields.
macro_rules! columns {
    (
        $(#[$about:meta])*
        $statistics:ident { $( $(#[$doc:meta])+ $field:ident = $name:literal ),+ $(,)? }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct $statistics {
            $( $(#[$doc])+ pub $field: u64 ),+
        }

        impl $statistics {
            /// The columns' names, in the order of [`Self::numbers`].
            pub const NAMES: [&'static str; [$($name),+].len()] = [$($name),+];

            /// All values, in the order of [`Self::NAMES`].
            pub fn numbers(&self) -> [u64; Self::NAMES.len()] {
                [$(self.$field),+]
            }
        }
    };
}

columns! {
    /// How exact queries decided a cell. Queries about the box around a cell group count with the group's
    /// first cell.
    DecisionStats {
        /// Rays cast for witnesses.
        rays = "exact_rays",
        /// Boxes, polygons and triangles that were the target of a query.
        queries = "exact_queries",
        /// Boxes proved hidden as a whole.
        boxes = "exact_boxes_hidden",
        /// Triangles hidden by the closed surface they belong to, without those hidden from a cell group.
        enclosed = "exact_enclosed",
        /// All triangles proved hidden.
        hidden = "exact_hidden",
        /// Visible triangles that sampling had not shown.
        missed = "exact_missed",
        /// Hidden triangles that sampling had shown, through a seam.
        refuted = "exact_refuted",
        /// Undecided triangles whose query was stopped.
        undecided_stopped = "undecided_stopped",
        /// Undecided triangles whose query reached the limit of regions.
        undecided_regions = "undecided_regions",
        /// Undecided triangles whose query reached the limit of memory.
        undecided_memory = "undecided_memory",
        /// Undecided triangles whose polygons were divided too often.
        undecided_divisions = "undecided_halvings",
        /// Regions of line space that the queries examined.
        regions = "exact_regions",
        /// Sight lines that the queries traced.
        lines = "exact_lines",
        /// Occluders that the queries subtracted.
        occluders = "exact_occluders",
        /// Signs decided by the filter in doubles.
        signs_filtered = "signs_filtered",
        /// Signs decided in double-doubles.
        signs_refined = "signs_refined",
        /// Signs known from the lines that a ray lies on.
        signs_spanned = "signs_spanned",
        /// Signs decided in integers.
        signs_exact = "signs_exact",
        /// Greatest number of vectors of line space that a query held at once.
        vectors = "exact_vectors",
        /// Triangles hidden from the box around the cell's group.
        above = "exact_above",
    }
}

/// The number of a cell's columns: visibility cubes, [`CellStats`], [`DecisionStats`].
pub const COLUMNS: usize = 1 + CellStats::NAMES.len() + DecisionStats::NAMES.len();

/// The names of a cell's columns, in the order of [`crate::CellSet::row`].
pub fn column_names() -> impl Iterator<Item = &'static str> {
    ["samples"]
        .into_iter()
        .chain(CellStats::NAMES)
        .chain(DecisionStats::NAMES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_their_names_and_come_back() {
        let numbers: [u64; CellStats::NAMES.len()] = std::array::from_fn(|i| {
            if (14..16).contains(&i) {
                15 - i as u64
            } else {
                i as u64 + 10
            }
        });
        let stats = CellStats::from_numbers(numbers).unwrap();
        assert_eq!(stats.numbers(), numbers);
        let number_named =
            |name: &str| numbers[CellStats::NAMES.iter().position(|n| *n == name).unwrap()];
        assert_eq!(
            [
                number_named("rays_uniform"),
                number_named("rays_flood"),
                number_named("rays_candidate"),
                number_named("rays_check")
            ],
            stats.rays
        );
        assert_eq!(
            [
                number_named("finds_uniform"),
                number_named("finds_flood"),
                number_named("finds_candidate"),
                number_named("finds_check")
            ],
            stats.finds
        );
        assert_eq!(
            [number_named("rounds"), number_named("bound_look")],
            [u64::from(stats.rounds), u64::from(stats.bound_look)]
        );
        assert_eq!(
            [number_named("last_rays"), number_named("last_misses")],
            [stats.last_rays, stats.last_misses]
        );
        assert_eq!(
            [number_named("bound_lines"), number_named("bound_misses")],
            [stats.bound_lines, stats.bound_misses]
        );
        let cells = [
            number_named("bound_cell_lines"),
            number_named("bound_cell_misses"),
            number_named("bound_cell_look"),
        ];
        let own = [
            stats.bound_cell_lines,
            stats.bound_cell_misses,
            u64::from(stats.bound_cell_look),
        ];
        assert_eq!(cells, own);
        assert!(
            number_named("unfinished") == 1
                && stats.unfinished
                && number_named("spared") == 0
                && !stats.raised_tolerance
        );
        // Beyond their ranges.
        for i in [8, 13, 14, 15, 18] {
            let mut wrong = numbers;
            wrong[i] = u64::MAX;
            assert_eq!(CellStats::from_numbers(wrong), None);
        }
    }
}
