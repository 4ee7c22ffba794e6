//! Errors of measurements.

use std::path::PathBuf;

/// The reason why a measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The caller stopped the measurement.
    #[error("interrupted after {done} of {total} frames")]
    Stopped {
        /// The number of finished frames.
        done: u64,
        /// The number of all frames.
        total: u64,
    },
    /// The camera path cannot be read.
    #[error("cannot read the camera path at line {line}: {source}")]
    Read {
        /// The line number, starting at 1.
        line: u64,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A line of the camera path is not a viewpoint.
    #[error(
        "line {line} of the camera path is not a viewpoint: {reason}; write `x y z` or \
            {{\"position\":[x,y,z]}}"
    )]
    Line {
        /// The line number, starting at 1.
        line: u64,
        /// A description of the fault.
        reason: String,
    },
    /// A viewpoint of the path has no cell.
    #[error(
        "line {line} of the camera path, {point:?}, is outside the view box {min:?} … {max:?}; move the \
            viewpoint inside, or bake with a larger --view-box"
    )]
    PathOutside {
        /// The line number, starting at 1.
        line: u64,
        /// The viewpoint, in world space.
        point: [f32; 3],
        /// The lowest corner of the view box.
        min: [f32; 3],
        /// The highest corner of the view box.
        max: [f32; 3],
    },
    /// A viewpoint that the caller passed has no cell.
    #[error(
        "viewpoint {frame}, {point:?}, is outside the view box of the result; move the viewpoint inside"
    )]
    Outside {
        /// The index of the viewpoint, starting at 0.
        frame: usize,
        /// The viewpoint, in world space.
        point: [f32; 3],
    },
    /// The list of viewpoints is empty.
    #[error("there are no viewpoints; request at least one, or give a camera path with viewpoints")]
    NoViewpoints,
    /// The renderer shows a triangle that the result does not contain.
    #[error(
        "the scene shows triangle {id}, but the result is of a scene with {triangles} triangles; measure \
            with the scene that was baked"
    )]
    OtherScene {
        /// The triangle in the image.
        id: u32,
        /// The number of triangles of the result.
        triangles: u32,
    },
    /// The renderer's image does not consist of six square faces.
    #[error("the renderer returned {pixels} pixels in place of six faces of {resolution}² pixels")]
    ImageSize {
        /// The side of a face, in pixels.
        resolution: u32,
        /// The number of pixels that the renderer returned.
        pixels: usize,
    },
    /// Rendering failed.
    #[error(transparent)]
    Backend(#[from] sightline_trace::TracerError),
    /// A viewpoint is out of range.
    #[error(transparent)]
    Look(#[from] sightline_tetra::LookError),
    /// The result cannot be decoded.
    #[error(transparent)]
    Pvs(#[from] sightline_pvs::PvsError),
    /// An image cannot be encoded.
    #[error("the picture cannot be encoded: {reason}")]
    Encode {
        /// The message of the encoder.
        reason: String,
    },
    /// An image cannot be written.
    #[error("cannot write {path}: {reason}")]
    Image {
        /// The path of the file or folder.
        path: PathBuf,
        /// The message of the operating system or of the encoder.
        reason: String,
    },
}
