//! The parameters and the result of a point query.

/// The precision of a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// Exact sets: all visible triangles and no other triangles.
    Exact,
    /// Aggressive sets: the search drops beams narrower than this angle, in radians, above 0 and at most π.
    ///
    /// Visible triangles can be missing.
    Aggressive(f64),
    /// Conservative sets: the search does not cut beams whose corners are all closer together than this
    /// angle, in radians, above 0 and at most π.
    ///
    /// Hidden triangles can be included.
    Conservative(f64),
}

/// The algorithm of a query.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// Search through the cells between the surfaces, front to back.
    Cells,
    /// Search through a hierarchy of boxes, nearest first.
    #[default]
    Boxes,
}

/// A box whose visible fraction is computed, in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// The smallest coordinates.
    pub low: [f64; 3],
    /// The largest coordinates.
    pub high: [f64; 3],
}

/// The parameters of a point query.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// The axis of the view's round cone, of any length. Without an axis the view contains all directions.
    pub direction: Option<[f64; 3]>,
    /// The full angle of the cone in radians: at least 0.0001 degrees and at most 2π. Not used without a
    /// direction.
    pub angle: f64,
    /// The distance from the viewpoint at which visibility ends, in world units. Without a distance,
    /// visibility does not end.
    pub distance: Option<f64>,
    /// True if the query computes a direction to each visible triangle.
    pub witnesses: bool,
    /// The algorithm of the query.
    pub engine: Engine,
}

/// The result of a point query.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VisibleTriangles {
    /// The ids of the visible triangles, ascending.
    pub visible: Vec<u32>,
    /// The visible solid angle of each triangle in `visible`, in steradians.
    ///
    /// If coplanar triangles overlap, the triangle with the smallest id gets the solid angle of the overlap.
    /// See-through triangles have the solid angle 0, because the direction continues to the triangle behind.
    pub areas: Vec<f64>,
    /// A witness direction for each triangle in `visible`: a vector whose component of the largest magnitude
    /// is in [1, 2).
    ///
    /// No blocking triangle is nearer than the visible triangle in this direction. An entry is `None` if the
    /// triangle contains the viewpoint, if no direction in doubles is certainly in the triangle's visible
    /// part, or if the middle of the part is outside of the view. The list is empty unless
    /// [`View::witnesses`] is set.
    pub witnesses: Vec<Option<[f64; 3]>>,
    /// The solid angle of directions in which no blocking triangle is within the view's distance, in
    /// steradians.
    pub sky: f64,
    /// The solid angle of directions in which the first triangle blocks but does not show, in steradians.
    pub unseen: f64,
    /// The undecided solid angle, in steradians.
    ///
    /// Dropped beams are undecided. In the conservative mode, a beam is undecided if no triangle covers the
    /// whole beam, or if a triangle may be in front of the covering triangle.
    pub dropped: f64,
    /// The number of boxes or cells that beams entered. A cell counts once for a beam and all parts of the
    /// beam.
    pub cells: u64,
    /// The number of beams that ended, which were not divided further.
    pub beams: u64,
    /// The number of signs of determinants that the query decided.
    pub decided: u64,
    /// The number of signs and directions that needed integers.
    pub integers: u64,
}
