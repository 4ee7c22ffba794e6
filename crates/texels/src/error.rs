//! The errors of this crate. Each names the element at fault, the reason and a remedy.

/// Maximum side of an image, in texels.
pub(crate) const MOST_SIDE: u32 = 16384;
/// Maximum number of receivers of a plan.
///
/// A job accepts no more receivers: 52 bytes each in at most 2 GiB (`docs/formats/ambient.md`).
pub(crate) const MOST_RECEIVERS: usize = 40_000_000;

/// The reason why values cannot be added to a file.
#[derive(Debug, thiserror::Error)]
pub enum TexelsError {
    /// A file that violates the glTF specification.
    #[error("{file}: {element}: {reason}; export the file again from the program that made it")]
    Broken {
        /// The name of the file as the user gave it.
        file: String,
        /// The element at fault, such as `accessor 3`.
        element: String,
        /// The fault of the element.
        reason: String,
    },
    /// An unreadable file that the glTF file references.
    #[error(transparent)]
    Beside(#[from] sightline_scene::SceneError),
    /// Compressed geometry.
    #[error(
        "{file}: {element}: data compressed with {extension} cannot be written; export it uncompressed"
    )]
    Compressed {
        /// The name of the file as the user gave it.
        file: String,
        /// The compressed element, such as `buffer view 3`.
        element: String,
        /// The name of the glTF extension.
        extension: &'static str,
    },
    /// A scene that does not belong to the file.
    #[error("{file}: {element}: {reason}; load the scene from this file again")]
    OtherScene {
        /// The name of the file as the user gave it.
        file: String,
        /// The element whose triangles differ.
        element: String,
        /// The difference between scene and file.
        reason: String,
    },
    /// A file without any triangle that has an area.
    #[error("{file}: no triangle has an area; export meshes that have surfaces")]
    NoTriangles {
        /// The name of the file as the user gave it.
        file: String,
    },
    /// Missing or unusable texture coordinates that the user wants to keep.
    #[error(
        "{file}: {element}: {reason}; repair TEXCOORD_1, or omit --uv keep to get new coordinates"
    )]
    NotUsable {
        /// The name of the file as the user gave it.
        file: String,
        /// The primitive, and the indices of its triangles if triangles are at fault.
        element: String,
        /// The fault of the texture coordinates.
        reason: String,
    },
    /// An image that is too large.
    #[error(
        "{file}: the surface needs about {texels:.3e} texels, but an image has at most \
         16384 x 16384; use a larger --texel, or use --resolution"
    )]
    TooManyTexels {
        /// The name of the file as the user gave it.
        file: String,
        /// The approximate number of texels that the surface needs, without gaps between charts.
        texels: f64,
    },
    /// A plan with too many receivers for a texture, or with too many vertices.
    #[error(
        "{file}: more than 40000000 surface points or 268435456 vertices need a value; use a larger \
         --texel or a smaller --resolution, or split the file"
    )]
    TooManyPoints {
        /// The name of the file as the user gave it.
        file: String,
    },
    /// Charts that do not fit into the image.
    #[error(
        "{file}: {charts} charts, with gaps between them, do not fit into {side} x {side} texels; use a \
         larger --resolution, or use --texel"
    )]
    TooManyCharts {
        /// The name of the file as the user gave it.
        file: String,
        /// The number of charts.
        charts: u32,
        /// The side of the image in texels.
        side: u32,
    },
    /// A setting that is out of its range.
    #[error("{option} is {value}: {rule}")]
    Setting {
        /// The command-line option of the setting.
        option: &'static str,
        /// The value of the setting.
        value: String,
        /// The range of valid values.
        rule: &'static str,
    },
    /// Values that do not match the plan's receivers.
    #[error(
        "{values} usable values for {receivers} receivers; give each receiver one finite value \
         from 0 to 1"
    )]
    Values {
        /// The number of given values that are finite and from 0 to 1, or whose receivers are inside solids.
        values: usize,
        /// The number of receivers.
        receivers: usize,
    },
    /// A result that exceeds the 32-bit size of a GLB.
    #[error(
        "{file}: the written GLB would exceed its limit of 4 GiB; use a larger --texel or split the file"
    )]
    TooLarge {
        /// The name of the file as the user gave it.
        file: String,
    },
    /// An image that cannot be encoded.
    #[error("the image cannot be encoded: {0}; report this with the scene")]
    Png(#[from] png::EncodingError),
    /// A glTF structure that cannot be encoded.
    #[error("the glTF structure cannot be encoded: {0}; report this with the scene")]
    Json(#[from] serde_json::Error),
}
