//! The types of an accessor's components.

/// The type of a component (glTF 2.0, section 3.6.2.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    pub(super) fn from_number(n: u32) -> Option<Self> {
        Some(match n {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    pub(super) fn size(self) -> u64 {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// Returns the unsigned integer in the first bytes of `b`, or 0 if the type is not an unsigned integer.
    pub(super) fn unsigned(self, b: &[u8]) -> u64 {
        match (self, b) {
            (Self::U8, &[a, ..]) => u64::from(a),
            (Self::U16, &[a, b, ..]) => u64::from(u16::from_le_bytes([a, b])),
            (Self::U32, &[a, b, c, d, ..]) => u64::from(u32::from_le_bytes([a, b, c, d])),
            _ => 0,
        }
    }

    /// Returns component `i` of the element in the bytes `b`. Normalised integers are mapped to 0…1 or −1…1,
    /// as in glTF 2.0, section 3.6.2.2.
    pub(super) fn number(self, b: &[u8], i: usize, normalized: bool) -> f64 {
        let b = b.get(i * self.size() as usize..).unwrap_or_default();
        let scaled = |v: f64, max: f64| if normalized { (v / max).max(-1.0) } else { v };
        match (self, b) {
            (Self::I8, &[a, ..]) => scaled(f64::from(a as i8), 127.0),
            (Self::U8, &[a, ..]) => scaled(f64::from(a), 255.0),
            (Self::I16, &[a, b, ..]) => scaled(f64::from(i16::from_le_bytes([a, b])), 32767.0),
            (Self::U16, &[a, b, ..]) => scaled(f64::from(u16::from_le_bytes([a, b])), 65535.0),
            (Self::F32, &[a, b, c, d, ..]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            // `CheckedAccessor::new` rejects other types of positions, and elements shorter than their type.
            _ => f64::NAN,
        }
    }
}
