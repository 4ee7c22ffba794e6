//! What is asked about a point, and the answer.

/// How exactly a query decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// All that is visible and nothing else.
    Exact,
    /// Beams narrower than this angle, in radians, are dropped: some of what is visible is missing.
    Aggressive(f64),
    /// Beams whose corners are closer together than this angle, in radians, are not cut: more than what is
    /// visible.
    Conservative(f64),
}

/// Who answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// The cells between the surfaces, front to back.
    Cells,
    /// A hierarchy of boxes, nearest first.
    #[default]
    Boxes,
}

/// A box whose picture is asked for, in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Least coordinates.
    pub low: [f64; 3],
    /// Largest coordinates.
    pub high: [f64; 3],
}

/// What is asked about a point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// The axis of the round cone that counts, of any length; all directions count without one.
    pub direction: Option<[f64; 3]>,
    /// The cone's full angle in radians, in (0, 2π].
    pub angle: f64,
    /// What is at least this far away is not seen.
    pub distance: Option<f64>,
    /// Whether a direction to each visible triangle is wanted.
    pub witnesses: bool,
    /// Who answers.
    pub engine: Engine,
}

/// What is seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// The visible triangles, ascending.
    pub visible: Vec<u32>,
    /// Their solid angles in steradians. Of coplanar triangles that overlap the least id has it; what is
    /// see-through has none, for the direction goes on to what is behind.
    pub areas: Vec<f64>,
    /// For each a direction of largest magnitude in [1, 2) in which nothing is met before it: a blocking
    /// triangle or, for a see-through one, any blocking triangle. Nothing where the triangle holds the point,
    /// where no double is certainly in its part, or where the middle of its part is out of the view.
    pub witnesses: Vec<Option<[f64; 3]>>,
    /// Solid angle in which nothing is met.
    pub sky: f64,
    /// Solid angle in which the first triangle blocks and does not show.
    pub unseen: f64,
    /// Solid angle that was not decided: dropped beams, and in the conservative mode beams that nothing
    /// covers whole, or in which something may be in front of what does.
    pub dropped: f64,
    /// Cells that were entered, once for a beam and all its parts, or boxes.
    pub cells: u64,
    /// Beams that were ended.
    pub beams: u64,
    /// Signs that were decided.
    pub decided: u64,
    /// Those of them that needed integers, and directions that did.
    pub integers: u64,
}
