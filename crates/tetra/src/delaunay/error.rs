//! Errors of the Delaunay construction.

use thiserror::Error;

/// The reason why the Delaunay construction rejects points.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DelaunayError {
    /// A coordinate is NaN or infinite.
    #[error("point {index} is {point:?}: coordinates must be finite; repair or remove the point")]
    NotFinite {
        /// The index of the point in the list of points.
        index: usize,
        /// The coordinates of the point.
        point: [f32; 3],
    },
    /// Two points are equal.
    #[error(
        "points {first} and {second} are both {point:?}: points must be distinct; keep one of them"
    )]
    Duplicate {
        /// The smaller of the two point indices.
        first: u32,
        /// The larger of the two point indices.
        second: u32,
        /// The coordinates of both points.
        point: [f32; 3],
    },
    /// A corner of the box around the points exceeds the range of `f32`.
    #[error(
        "a coordinate has the magnitude {reach:e}, so a box around the points would exceed the range of \
         f32; scale the points down"
    )]
    TooFar {
        /// The largest magnitude of a coordinate.
        reach: f32,
    },
    /// The number of points exceeds the maximum.
    #[error("the scene has {points} points, but at most {most} are possible; divide the scene")]
    TooManyPoints {
        /// The number of given points.
        points: usize,
        /// The maximum number of points.
        most: usize,
    },
    /// The number of tetrahedra exceeds 2³² − 2. N points on few curves can have about N² tetrahedra.
    #[error("the points have more than 4294967294 tetrahedra; divide the scene")]
    TooManyTetrahedra,
    /// The observer of the build rejected the memory use, with this message.
    #[error("{0}")]
    Memory(String),
}
