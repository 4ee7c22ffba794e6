//! What a user may choose about where values go.

/// Where the values go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Target {
    /// Into a texture, as `occlusionTexture` of the materials.
    #[default]
    Texture,
    /// To the vertices, as `_OCCLUSION` and `COLOR_0`.
    Vertices,
}

/// How fine the texture is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Size {
    /// The side of a texel, in units of the scene.
    Texel(f64),
    /// The side of the image, in texels.
    Resolution(u32),
}

/// Which texture coordinates the texture has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coordinates {
    /// `TEXCOORD_1` where all of the file can be used, else new ones.
    #[default]
    Any,
    /// `TEXCOORD_1`, or an error.
    Keep,
    /// New ones.
    Unwrap,
}

/// Bits of a value in the image or in a vertex colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bits {
    /// 256 values.
    #[default]
    Eight,
    /// 65 536 values.
    Sixteen,
}

impl Bits {
    /// The largest value.
    pub(crate) fn largest(self) -> f64 {
        match self {
            Self::Eight => 255.0,
            Self::Sixteen => 65535.0,
        }
    }
}

/// All choices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Where the values go.
    pub target: Target,
    /// How fine the texture is. Not used for vertices.
    pub size: Size,
    /// Which texture coordinates the texture has. Not used for vertices.
    pub coordinates: Coordinates,
    /// Bits of a value.
    pub bits: Bits,
}

impl Default for Settings {
    /// A texture of 1024 texels a side and 8 bits.
    fn default() -> Self {
        Self {
            target: Target::default(),
            size: Size::Resolution(1024),
            coordinates: Coordinates::default(),
            bits: Bits::default(),
        }
    }
}
