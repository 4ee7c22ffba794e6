//! The settings of a plan.

/// The destination of the values in the written file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ValueTarget {
    /// A texture, as `occlusionTexture` of the materials.
    #[default]
    Texture,
    /// The vertices, as `_OCCLUSION` and `COLOR_0`.
    Vertices,
}

/// The resolution of the texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TextureSize {
    /// The side of a texel, in units of the scene.
    Texel(f64),
    /// The side of the image, in texels.
    Resolution(u32),
}

/// The source of the texture coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TexCoordSource {
    /// `TEXCOORD_1` if the coordinates of all primitives are usable, otherwise new coordinates for all
    /// primitives.
    #[default]
    Any,
    /// `TEXCOORD_1`, or an error if the coordinates of a primitive are unusable.
    Keep,
    /// New coordinates, even if the file has usable coordinates.
    Unwrap,
}

/// The number of bits of a value in the image or in a vertex colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BitDepth {
    /// Eight bits: 256 values.
    #[default]
    Eight,
    /// Sixteen bits: 65 536 values.
    Sixteen,
}

impl BitDepth {
    /// Returns the largest integer with this number of bits.
    pub(crate) fn largest(self) -> f64 {
        match self {
            Self::Eight => 255.0,
            Self::Sixteen => 65535.0,
        }
    }
}

/// The settings of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The destination of the values.
    pub target: ValueTarget,
    /// The resolution of the texture. Not used for vertices.
    pub size: TextureSize,
    /// The source of the texture coordinates. Not used for vertices.
    pub coordinates: TexCoordSource,
    /// The number of bits of a value.
    pub bits: BitDepth,
}

impl Default for Settings {
    /// Returns the settings of a texture with a side of 1024 texels and 8 bits per value.
    fn default() -> Self {
        Self {
            target: ValueTarget::default(),
            size: TextureSize::Resolution(1024),
            coordinates: TexCoordSource::default(),
            bits: BitDepth::default(),
        }
    }
}
