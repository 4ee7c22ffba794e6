//! The filters of mode ATTRIBUTES that positions, instances and vertex colours can have.

/// A filter that the decoder applies to decoded elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filter {
    None,
    Exponential,
    Quaternion,
    Color,
}

impl Filter {
    /// Returns the filter with the given name, for elements of `stride` bytes.
    ///
    /// # Errors
    /// A sentence that describes the fault of the view.
    pub(super) fn parse(name: Option<&str>, stride: usize) -> Result<Self, String> {
        let name = name.unwrap_or("NONE");
        let (filter, strides): (Self, &[usize]) = match name {
            "NONE" => return Ok(Self::None),
            "EXPONENTIAL" => return Ok(Self::Exponential),
            "QUATERNION" => (Self::Quaternion, &[8]),
            "COLOR" => (Self::Color, &[4, 8]),
            other => {
                let shown: String = other.chars().take(20).collect();
                return Err(format!(
                    "the filter {shown} is unknown or not for positions, rotations or colours"
                ));
            }
        };
        match strides.contains(&stride) {
            true => Ok(filter),
            false => Err(format!(
                "the filter {name} needs a stride of {strides:?} bytes, but the stride is {stride}"
            )),
        }
    }

    /// Applies the filter to elements of `stride` bytes.
    pub(super) fn apply(self, bytes: &mut [u8], stride: usize) {
        match self {
            Self::None => {}
            Self::Exponential => exponential(bytes),
            Self::Quaternion => bytes.chunks_exact_mut(8).for_each(quaternion),
            Self::Color if stride == 4 => bytes.chunks_exact_mut(4).for_each(|e| {
                let signed = |i: usize| i32::from(e[i] as i8);
                let rgba = color(
                    [i32::from(e[0]), signed(1), signed(2), i32::from(e[3])],
                    255.0,
                );
                e.copy_from_slice(&rgba.map(|c| c as u8));
            }),
            Self::Color => bytes.chunks_exact_mut(8).for_each(|e| {
                let word = |i: usize| u16::from_le_bytes([e[2 * i], e[2 * i + 1]]);
                let signed = |i: usize| i32::from(word(i) as i16);
                let rgba = color(
                    [i32::from(word(0)), signed(1), signed(2), i32::from(word(3))],
                    65535.0,
                );
                e.copy_from_slice(rgba.map(|c| (c as u16).to_le_bytes()).as_flattened());
            }),
        }
    }
}

/// Converts 32-bit words of a signed 8-bit exponent and a signed 24-bit mantissa to `f32`.
fn exponential(bytes: &mut [u8]) {
    for word in bytes.chunks_exact_mut(4) {
        let v = i32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        let (exponent, mantissa) = (v >> 24, v << 8 >> 8);
        // The value is exact in f64 and rounded once to f32. A value beyond its range becomes infinite, which
        // the reader of positions rejects.
        let value = f64::from(mantissa) * 2f64.powi(exponent);
        word.copy_from_slice(&(value as f32).to_le_bytes());
    }
}

/// Converts a filtered unit quaternion to four normalised 16-bit components. The input is three scaled
/// components and the index of the omitted largest component.
fn quaternion(bytes: &mut [u8]) {
    let word = |i: usize| i16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]]);
    // The last word is 1.0 in the same scale, except for its two lowest bits.
    let (one, largest) = (f32::from(word(3) | 3), usize::from(word(3) as u16 & 3));
    let [x, y, z] = [0, 1, 2].map(|i| f32::from(word(i)) / one * std::f32::consts::FRAC_1_SQRT_2);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    for (i, c) in [(1, x), (2, y), (3, z), (0, w)] {
        let at = (largest + i) % 4 * 2;
        bytes[at..at + 2].copy_from_slice(&((c * 32767.0).round() as i16).to_le_bytes());
    }
}

/// Converts luma, two signed chroma values and alpha to red, green, blue and alpha up to `full`. The highest
/// bit of the stored alpha determines the number of bits.
fn color([y, co, cg, alpha]: [i32; 4], full: f32) -> [f32; 4] {
    let bits = 32 - (alpha as u32).leading_zeros();
    let scale = (1i32 << bits) - 1;
    let a = alpha & (scale >> 1);
    // Malformed data without any bit result in zeros.
    let factor = if scale > 0 { full / scale as f32 } else { 0.0 };
    [y + co - cg, y + cg, y - co - cg, a << 1 | a & 1].map(|c| (c as f32 * factor).round())
}
