//! What can be wrong with points.

use thiserror::Error;

/// Why points have no Delaunay tetrahedra here.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DelaunayError {
    /// A coordinate is NaN or infinite.
    #[error("point {index} is {point:?}: coordinates must be finite; repair or remove the point")]
    NotFinite {
        /// The number of the point.
        index: usize,
        /// The point.
        point: [f32; 3],
    },
    /// Two points are equal.
    #[error(
        "points {first} and {second} are both {point:?}: points must be distinct; keep one of them"
    )]
    Duplicate {
        /// The smaller number.
        first: u32,
        /// The larger number.
        second: u32,
        /// The point that both are.
        point: [f32; 3],
    },
    /// No `f32` is left for a corner of the box around the points.
    #[error(
        "the points reach to {reach:e}, and a box around them would leave the range of f32; scale them down"
    )]
    TooFar {
        /// The largest magnitude of a coordinate.
        reach: f32,
    },
    /// More points than numbers.
    #[error("{points} points: at most {most} are possible; divide the scene")]
    TooManyPoints {
        /// How many points were given.
        points: usize,
        /// How many are possible.
        most: usize,
    },
    /// More tetrahedra than numbers. Points on few curves can have about the square of their number.
    #[error("the points have more than 4294967294 tetrahedra; divide the scene")]
    TooManyTetrahedra,
    /// There is not enough memory.
    #[error("{0}")]
    Memory(String),
}
