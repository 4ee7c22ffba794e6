//! What can go wrong while measuring.

use std::path::PathBuf;

/// Why nothing was measured.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The caller did not want to go on.
    #[error("interrupted after {done} of {total} frames")]
    Stopped {
        /// Frames that are done.
        done: u64,
        /// All frames.
        total: u64,
    },
    /// The camera path cannot be read.
    #[error("cannot read the camera path at line {line}: {source}")]
    Read {
        /// From 1.
        line: u64,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line of the camera path is not a viewpoint.
    #[error(
        "line {line} of the camera path is not a viewpoint: {reason}; write `x y z` or \
            {{\"position\":[x,y,z]}}"
    )]
    Line {
        /// From 1.
        line: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// A viewpoint of the path has no cell.
    #[error(
        "line {line} of the camera path, {point:?}, is outside the view box {min:?} … {max:?}; move it \
            inside, or bake with a larger --view-box"
    )]
    PathOutside {
        /// From 1.
        line: u64,
        /// The viewpoint, world space.
        point: [f32; 3],
        /// Least corner of the view box.
        min: [f32; 3],
        /// Greatest corner of the view box.
        max: [f32; 3],
    },
    /// A viewpoint handed in has no cell.
    #[error("viewpoint {frame}, {point:?}, is outside the view box of the result")]
    Outside {
        /// Index of the viewpoint.
        frame: usize,
        /// The viewpoint, world space.
        point: [f32; 3],
    },
    /// There is nothing to measure from.
    #[error("there are no viewpoints; ask for one at least, or give a path that has some")]
    NoViewpoints,
    /// The renderer shows a triangle that the result does not know.
    #[error(
        "the scene shows triangle {id}, the result is of a scene with {triangles}; measure with the scene \
            that was baked"
    )]
    OtherScene {
        /// Seen.
        id: u32,
        /// N of the result.
        triangles: u32,
    },
    /// The renderer's image is not six square faces.
    #[error("the renderer gave {pixels} pixels for six faces of {resolution}²")]
    ImageSize {
        /// Side of a face.
        resolution: u32,
        /// Given.
        pixels: usize,
    },
    /// Rendering failed.
    #[error(transparent)]
    Backend(#[from] sightline_trace::BackendError),
    /// A viewpoint is out of range.
    #[error(transparent)]
    Look(#[from] sightline_tetra::LookError),
    /// The result cannot be decoded.
    #[error(transparent)]
    Pvs(#[from] sightline_pvs::PvsError),
    /// An image cannot be made.
    #[error("the picture cannot be encoded: {reason}")]
    Encode {
        /// What the encoder said.
        reason: String,
    },
    /// An image cannot be written.
    #[error("cannot write {path}: {reason}")]
    Image {
        /// The file or folder.
        path: PathBuf,
        /// What the system or the encoder said.
        reason: String,
    },
}
