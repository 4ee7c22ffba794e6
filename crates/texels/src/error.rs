//! Why values cannot be put into a file. Each error names the element at fault, the reason and a remedy.

/// Largest side of an image, in texels.
pub(crate) const MOST_SIDE: u32 = 16384;
/// Most receivers of a plan.
///
/// A job takes no more: 52 bytes each in at most 2 GiB (`docs/formats/ambient.md`).
pub(crate) const MOST_RECEIVERS: usize = 40_000_000;

/// Why values cannot be put into a file.
#[derive(Debug, thiserror::Error)]
pub enum TexelsError {
    /// The file violates glTF.
    #[error("{file}: {element}: {reason}; export the file again from the program that made it")]
    Broken {
        /// The file as the user named it.
        file: String,
        /// The element at fault, such as `accessor 3`.
        element: String,
        /// The fault.
        reason: String,
    },
    /// A file that belongs to it cannot be read.
    #[error(transparent)]
    Beside(#[from] sightline_scene::SceneError),
    /// The geometry is compressed.
    #[error(
        "{file}: {element}: it has {extension}, a compression that cannot be written; export without it"
    )]
    Compressed {
        /// The file as the user named it.
        file: String,
        /// The compressed element.
        element: String,
        /// The extension of glTF.
        extension: &'static str,
    },
    /// The scene is not that of the file.
    #[error("{file}: {element}: {reason}; load the scene from this file again")]
    OtherScene {
        /// The file as the user named it.
        file: String,
        /// The element at fault.
        element: String,
        /// The difference.
        reason: String,
    },
    /// Nothing has an area.
    #[error("{file}: none of its triangles has an area; export meshes that have surfaces")]
    NoTriangles {
        /// The file as the user named it.
        file: String,
    },
    /// Texture coordinates that the user wants to keep are missing or cannot be used.
    #[error(
        "{file}: {element}: {reason}; repair TEXCOORD_1, or leave out --uv keep to get new coordinates"
    )]
    NotUsable {
        /// The file as the user named it.
        file: String,
        /// The primitive, and the triangles where they are at fault.
        element: String,
        /// The fault.
        reason: String,
    },
    /// The image would be too large.
    #[error(
        "{file}: with texels of this size it takes {texels:.3e} texels, and 16384 x 16384 are the most; give \
         a larger --texel, or --resolution"
    )]
    TooManyTexels {
        /// The file as the user named it.
        file: String,
        /// How many texels it would take, about.
        texels: f64,
    },
    /// There would be too many receivers.
    #[error(
        "{file}: it takes more than 40000000 points of the surface; give a larger --texel or a smaller \
         --resolution, or split the file"
    )]
    TooManyPoints {
        /// The file as the user named it.
        file: String,
    },
    /// The charts do not fit into the image.
    #[error(
        "{file}: its {charts} charts, with gaps between them, do not fit into {side} x {side} texels; give a \
         larger --resolution, or --texel"
    )]
    TooManyCharts {
        /// The file as the user named it.
        file: String,
        /// How many charts there are.
        charts: u32,
        /// The side of the image.
        side: u32,
    },
    /// A choice of the user is out of its range.
    #[error("{option} is {value}: {rule}")]
    Setting {
        /// The option.
        option: &'static str,
        /// What was given.
        value: String,
        /// What it must be.
        rule: &'static str,
    },
    /// The values are not those of the plan's receivers.
    #[error(
        "there are {values} values for {receivers} receivers; give one finite value from 0 to 1 for each"
    )]
    Values {
        /// How many usable values were given.
        values: usize,
        /// How many there must be.
        receivers: usize,
    },
    /// A GLB counts its bytes in 32 bits.
    #[error(
        "{file}: the result takes more than the 4 GiB of a GLB; give a larger --texel or split it"
    )]
    TooLarge {
        /// The file as the user named it.
        file: String,
    },
    /// The image cannot be encoded.
    #[error("the image cannot be encoded: {0}; report this with the scene")]
    Png(#[from] png::EncodingError),
    /// The structure cannot be encoded.
    #[error("the glTF structure cannot be encoded: {0}; report this with the scene")]
    Json(#[from] serde_json::Error),
}
