//! The positions of the scene's triangles in the image, and the changes of the primitives' texture
//! coordinates.

use crate::overlap::FlatTriangle;

/// The layout of the image: its size, the triangles in the image, and the changes of texture coordinates.
#[derive(Clone, Debug)]
pub(crate) struct Atlas {
    /// The width and height in texels.
    pub size: [u32; 2],
    /// The corners of each triangle of the scene in texels, from the upper left corner of the image.
    pub triangles: Vec<FlatTriangle>,
    /// The change of the texture coordinates of each primitive, in the order of `PrimitiveInstances::all`.
    pub layouts: Vec<AtlasLayout>,
    /// The number of charts of new coordinates, or 0 if `TEXCOORD_1` is used.
    pub charts: u32,
    /// The number of empty texels around each packed chart or primitive, or 0 if nothing was packed.
    pub gap: u32,
}

/// The change of the texture coordinates of a primitive.
#[derive(Clone, Debug)]
pub(crate) enum AtlasLayout {
    /// Unchanged `TEXCOORD_1`.
    Kept,
    /// `TEXCOORD_1` times a factor, plus an offset, so that primitives do not overlap in the image.
    Moved {
        /// The factors for u and v.
        scale: [f64; 2],
        /// The offsets for u and v.
        offset: [f64; 2],
    },
    /// New coordinates for copied vertices.
    New {
        /// For each new vertex, the index of the vertex that it copies, and its coordinates from 0 to 1.
        vertices: Vec<(u32, [f32; 2])>,
        /// The corners of each triangle, as indices into `vertices`.
        corners: Vec<[u32; 3]>,
    },
}

impl AtlasLayout {
    /// Returns the coordinates `uv` times `scale` plus `offset`, clamped to 0…1.
    pub(crate) fn moved(scale: [f64; 2], offset: [f64; 2], uv: [f64; 2]) -> [f32; 2] {
        [0, 1].map(|k| (uv[k] * scale[k] + offset[k]).clamp(0.0, 1.0) as f32)
    }
}

/// Converts texture coordinates from 0 to 1 to a position in an image of `size` texels, in texels.
pub(crate) fn in_texels(uv: [f32; 2], size: [u32; 2]) -> [f64; 2] {
    [0, 1].map(|k| f64::from(uv[k]) * f64::from(size[k]))
}
