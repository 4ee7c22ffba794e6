//! Where each triangle of the scene is in the image, and how that gets into the file.

use crate::overlap::Flat;

/// The image's size, the triangles in it, and what becomes of the texture coordinates of the parts.
#[derive(Clone, Debug)]
pub(crate) struct Atlas {
    /// Texels across and down.
    pub size: [u32; 2],
    /// The corners of each triangle of the scene in texels, from the upper left corner of the image.
    pub triangles: Vec<Flat>,
    /// What becomes of the texture coordinates of each part.
    pub layouts: Vec<Layout>,
    /// Number of charts of new coordinates.
    pub charts: u32,
    /// Empty texels around each chart or part that was given a place.
    pub gap: u32,
}

/// What becomes of the texture coordinates of a part.
#[derive(Clone, Debug)]
pub(crate) enum Layout {
    /// `TEXCOORD_1` is as it was.
    Kept,
    /// `TEXCOORD_1` times a factor, plus an offset, so that parts do not lie upon each other.
    Moved {
        /// The factors.
        scale: [f64; 2],
        /// The offsets.
        offset: [f64; 2],
    },
    /// New coordinates for new vertices.
    New {
        /// For each vertex the one it is a copy of, and its coordinates.
        vertices: Vec<(u32, [f32; 2])>,
        /// The vertices of each triangle.
        corners: Vec<[u32; 3]>,
    },
}

impl Layout {
    /// Coordinates moved as this layout says.
    pub(crate) fn moved(scale: [f64; 2], offset: [f64; 2], uv: [f64; 2]) -> [f32; 2] {
        [0, 1].map(|k| (uv[k] * scale[k] + offset[k]).clamp(0.0, 1.0) as f32)
    }
}

/// Texture coordinates in texels.
pub(crate) fn in_texels(uv: [f32; 2], size: [u32; 2]) -> [f64; 2] {
    [0, 1].map(|k| f64::from(uv[k]) * f64::from(size[k]))
}
