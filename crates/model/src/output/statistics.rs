//! Statistics of a cell as named columns: the work of sampling and exact queries that led to the cell's set.
//!
//! Every number is the same in every run of a job. Times differ between runs and are stored with the tile
//! instead. The names equal the names of a result's columns. The meaning of a name in this file never
//! changes.

/// The kinds of sight lines, in the order of [`CellStats::rays`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineKind {
    /// Lines that are uniform over directions and the cell. The fraction that meets a new triangle estimates
    /// the missed fraction.
    Uniform,
    /// Lines from the origin that showed a new triangle to the triangle's unseen neighbours.
    Flood,
    /// Lines to a triangle that a neighbouring cell sees and this cell does not.
    Candidate,
    /// Lines that are held out from the search, for a bound.
    Check,
}

/// The statistics of the sampling of a cell with sight lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellStats {
    /// The number of rays cast from the cell, by [`LineKind`].
    pub rays: [u64; 4],
    /// The number of triangles that these rays were the first to show to the cell since the last barrier. For
    /// held-out lines, the number of lines that met a triangle outside the set.
    pub finds: [u64; 4],
    /// The number of rounds that sampled the cell.
    pub rounds: u32,
    /// The number of uniform rays of the cell's last round.
    pub last_rays: u64,
    /// The number of uniform rays of the last round that met a triangle outside the set.
    pub last_misses: u64,
    /// The number of held-out lines of the last look; 0 without a bound.
    pub bound_lines: u64,
    /// The number of held-out lines of the last look that met a triangle outside the set.
    pub bound_misses: u64,
    /// The number of the last look, starting at 1.
    pub bound_look: u32,
    /// The number of held-out lines of the last look at the cell's pairs; 0 without a bound.
    pub bound_cell_lines: u64,
    /// The number of these lines that crossed a cell that is not a pair with this cell.
    pub bound_cell_misses: u64,
    /// The number of the last look at the cell's pairs, starting at 1.
    pub bound_cell_look: u32,
    /// True if the time or the rounds ended before the cell reached the target.
    pub unfinished: bool,
    /// True if the cell ended within a tolerance above the target, because the cell cost several times the
    /// work of the average cell. The column's name is `spared`.
    pub raised_tolerance: bool,
}

impl CellStats {
    /// The names of the columns, in the order of [`CellStats::numbers`].
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

    /// Returns the statistics of a cell that joins two cells that were sampled separately.
    pub fn joined(&self, other: &Self) -> Self {
        let sums = |a: [u64; 4], b: [u64; 4]| std::array::from_fn(|k| a[k] + b[k]);
        Self {
            rays: sums(self.rays, other.rays),
            finds: sums(self.finds, other.finds),
            rounds: self.rounds.max(other.rounds),
            last_rays: self.last_rays + other.last_rays,
            last_misses: self.last_misses + other.last_misses,
            // A bound holds only for one cell.
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

    /// Returns all values, in the order of [`CellStats::NAMES`].
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

    /// Creates statistics from [`CellStats::numbers`]. Returns `None` if a number is outside its field's
    /// range.
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

/// Defines statistics whose columns are their fields.
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
            /// The names of the columns, in the order of [`Self::numbers`].
            pub const NAMES: [&'static str; [$($name),+].len()] = [$($name),+];

            /// Returns all values, in the order of [`Self::NAMES`].
            pub fn numbers(&self) -> [u64; Self::NAMES.len()] {
                [$(self.$field),+]
            }
        }
    };
}

columns! {
    /// The statistics of the exact queries of a cell. Queries about the box around a cell group count with
    /// the group's first cell.
    DecisionStats {
        /// The number of rays cast for witnesses.
        rays = "exact_rays",
        /// The number of queries, whose targets are boxes, polygons and triangles.
        queries = "exact_queries",
        /// The number of boxes proved hidden as a whole.
        boxes = "exact_boxes_hidden",
        /// The number of triangles hidden by their own closed surface, excluding triangles hidden from a
        /// whole cell group.
        enclosed = "exact_enclosed",
        /// The number of all triangles proved hidden.
        hidden = "exact_hidden",
        /// The number of visible triangles that sampling had not shown.
        missed = "exact_missed",
        /// The number of hidden triangles that sampling had shown, through a seam.
        refuted = "exact_refuted",
        /// The number of undecided triangles whose query was stopped.
        undecided_stopped = "undecided_stopped",
        /// The number of undecided triangles whose query reached the limit of regions.
        undecided_regions = "undecided_regions",
        /// The number of undecided triangles whose query reached the limit of memory.
        undecided_memory = "undecided_memory",
        /// The number of undecided triangles whose polygons were divided too often.
        undecided_divisions = "undecided_halvings",
        /// The number of regions of line space that the queries examined.
        regions = "exact_regions",
        /// The number of sight lines that the queries traced.
        lines = "exact_lines",
        /// The number of occluders that the queries subtracted.
        occluders = "exact_occluders",
        /// The number of signs of Klein forms decided by the filter in doubles.
        signs_filtered = "signs_filtered",
        /// The number of signs decided in double-doubles.
        signs_refined = "signs_refined",
        /// The number of spanned signs: known to be 0 without arithmetic.
        signs_spanned = "signs_spanned",
        /// The number of signs decided in integers.
        signs_exact = "signs_exact",
        /// The maximum number of vectors of line space that a query stored at once.
        vectors = "exact_vectors",
        /// The number of triangles hidden from the box around the cell's group, and so from the cell.
        above = "exact_above",
    }
}

/// The name of the column with the weight of each cell's viewpoints. Without this column, the weight of a
/// cell with viewpoints is proportional to its volume.
pub const VIEWPOINT_WEIGHT: &str = "viewpoint_weight";

/// The number of a cell's columns: visibility cubes, [`CellStats`], [`DecisionStats`].
pub const COLUMNS: usize = 1 + CellStats::NAMES.len() + DecisionStats::NAMES.len();

/// Returns the names of a cell's columns, in the order of [`crate::CellSet::row`].
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
    fn numbers_match_names_and_round_trip() {
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
        // Numbers outside the ranges of their fields.
        for i in [8, 13, 14, 15, 18] {
            let mut wrong = numbers;
            wrong[i] = u64::MAX;
            assert_eq!(CellStats::from_numbers(wrong), None);
        }
    }
}
