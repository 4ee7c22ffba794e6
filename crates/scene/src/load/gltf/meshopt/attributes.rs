//! Mode ATTRIBUTES of the meshopt extensions: deltas between elements, byte by byte.

/// The number of elements in a byte group.
const GROUP: usize = 16;
/// Maximum number of elements in a block.
const BLOCK: usize = 256;
/// Maximum number of decoded bytes per byte of compressed data: a control byte of version 1 can represent
/// four bytes of each element of a block.
pub(super) const DENSEST: u64 = 4 * BLOCK as u64;

/// The number of bits per delta of a byte group in version 0, by the two-bit code of the group.
const BITS_0: [u8; 4] = [0, 2, 4, 8];
/// The number of bits per delta of a byte group in version 1, for control modes 0 and 1, by the two-bit code
/// of the group.
const BITS_1: [[u8; 4]; 2] = [[0, 1, 2, 4], [1, 2, 4, 8]];

/// The relation between four bytes of an element and the same bytes of the previous element.
#[derive(Clone, Copy)]
enum Channel {
    /// The difference of bytes.
    Bytes,
    /// The difference of two 16-bit numbers.
    Words,
    /// The exclusive or of 32-bit numbers, rotated left by a number of bits.
    Xor(u32),
}

impl Channel {
    /// Returns the channel for a byte in the tail of version 1, or `None` if the byte is not valid.
    fn from_byte(byte: u8) -> Option<Self> {
        match (byte & 15, byte >> 4) {
            (0, 0) => Some(Self::Bytes),
            (1, 0) => Some(Self::Words),
            (2, rotation) => Some(Self::Xor(u32::from(rotation))),
            _ => None,
        }
    }

    /// Returns four bytes of an element, from four bytes of the previous element and the deltas.
    fn apply(self, previous: [u8; 4], delta: [u8; 4]) -> [u8; 4] {
        match self {
            Self::Bytes => std::array::from_fn(|i| {
                previous[i].wrapping_add((delta[i] >> 1) ^ (delta[i] & 1).wrapping_neg())
            }),
            Self::Words => {
                let word =
                    |bytes: [u8; 4], i: usize| u16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]]);
                let sum = |i| {
                    let d = word(delta, i);
                    word(previous, i)
                        .wrapping_add((d >> 1) ^ (d & 1).wrapping_neg())
                        .to_le_bytes()
                };
                let ([a, b], [c, d]) = (sum(0), sum(1));
                [a, b, c, d]
            }
            Self::Xor(rotation) => {
                let d = u32::from_le_bytes(delta).rotate_right(rotation);
                (u32::from_le_bytes(previous) ^ d).to_le_bytes()
            }
        }
    }
}

/// Decodes mode ATTRIBUTES, version 0 or 1, into `out`. Returns `None` if the data are malformed. `stride` is
/// a multiple of 4 in 4 ..= 256.
///
/// Elements come in blocks. A block has the first bytes of all its elements, then the second bytes and so on,
/// as deltas in groups of 16. The tail contains the element before the first one, and in version 1 the
/// channel of each four bytes. A block of version 1 begins with two bits of control for each byte of an
/// element.
pub(super) fn attributes(out: &mut [u8], stride: usize, data: &[u8]) -> Option<()> {
    let (&header, body) = data.split_first()?;
    let (of_channels, least) = match header {
        0xa0 => (0, 32),
        0xa1 => (stride / 4, 24),
        _ => return None,
    };
    let tail = stride + of_channels;
    let (mut rest, padded) = body.split_at_checked(body.len().checked_sub(tail.max(least))?)?;
    let (last, channels) = padded[padded.len() - tail..].split_at(stride);
    let mut channels = channels
        .iter()
        .map(|b| Channel::from_byte(*b))
        .collect::<Option<Vec<_>>>()?;
    channels.resize(stride / 4, Channel::Bytes);
    let mut last = last.to_vec();
    let block = ((8192 / stride) & !(GROUP - 1)).min(BLOCK);
    let mut deltas = [[0; BLOCK]; 4];
    for elements in out.chunks_mut(block * stride) {
        let count = elements.len() / stride;
        let (controls, after) = rest.split_at_checked(of_channels)?;
        rest = after;
        for (c, channel) in channels.iter().enumerate() {
            for (b, deltas) in deltas.iter_mut().enumerate() {
                let control = controls.get(c).map(|control| control >> (2 * b) & 3);
                plane(&mut rest, control, &mut deltas[..count])?;
            }
            let mut previous = [0, 1, 2, 3].map(|b| last[4 * c + b]);
            for (i, element) in elements.chunks_exact_mut(stride).enumerate() {
                previous = channel.apply(previous, [0, 1, 2, 3].map(|b| deltas[b][i]));
                element[4 * c..4 * c + 4].copy_from_slice(&previous);
            }
            last[4 * c..4 * c + 4].copy_from_slice(&previous);
        }
    }
    rest.is_empty().then_some(())
}

/// Reads the deltas of one byte of all elements of a block. `control` is the control mode of version 1.
fn plane(rest: &mut &[u8], control: Option<u8>, out: &mut [u8]) -> Option<()> {
    let bits = match control {
        None => BITS_0,
        Some(control @ (0 | 1)) => BITS_1[usize::from(control)],
        Some(2) => {
            out.fill(0);
            return Some(());
        }
        Some(_) => {
            out.copy_from_slice(take(rest, out.len())?);
            return Some(());
        }
    };
    let header = take(rest, out.len().div_ceil(GROUP).div_ceil(4))?;
    for (g, group) in out.chunks_mut(GROUP).enumerate() {
        let code = header[g / 4] >> (g % 4 * 2) & 3;
        // The last group has sixteen deltas, too. The deltas beyond the elements are not used.
        group.copy_from_slice(&byte_group(rest, bits[usize::from(code)])?[..group.len()]);
    }
    Some(())
}

/// Reads sixteen deltas. With 0 bits, all deltas are 0 and no byte is read. With 8 bits, each delta is a
/// byte.
///
/// With other numbers of bits, the deltas are packed, and the largest value represents a whole byte after the
/// packed values. Single bits are packed lowest first, larger values highest bits first.
fn byte_group(rest: &mut &[u8], bits: u8) -> Option<[u8; GROUP]> {
    let mut out = [0; GROUP];
    match usize::from(bits) {
        0 => {}
        8 => out.copy_from_slice(take(rest, GROUP)?),
        bits => {
            let escape = (1u8 << bits) - 1;
            let packed = take(rest, GROUP * bits / 8)?;
            for (i, value) in out.iter_mut().enumerate() {
                let at = i * bits;
                let shift = if bits == 1 { at % 8 } else { 8 - bits - at % 8 };
                *value = packed[at / 8] >> shift & escape;
                if *value == escape {
                    *value = take(rest, 1)?[0];
                }
            }
        }
    }
    Some(out)
}

/// Removes and returns `n` bytes from the front of `rest`.
fn take<'a>(rest: &mut &'a [u8], n: usize) -> Option<&'a [u8]> {
    let (head, tail) = rest.split_at_checked(n)?;
    *rest = tail;
    Some(head)
}
