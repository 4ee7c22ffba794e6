//! Mode ATTRIBUTES of EXT_meshopt_compression, and the filter EXPONENTIAL.

/// Elements in a byte group.
const GROUP: usize = 16;

/// Decodes mode ATTRIBUTES, version 0, into `out`; `None` when the data are malformed. `stride` is a multiple
/// of 4 in 4 ..= 256. Elements come in blocks. A block has the first bytes of all its elements, then the
/// second bytes and so on, as zigzag deltas in groups of 16 with 0, 2, 4 or 8 bits a delta.
pub(super) fn attributes(out: &mut [u8], stride: usize, data: &[u8]) -> Option<()> {
    let (&0xa0, body) = data.split_first()? else { return None };
    // The tail has the element before the first one, padded in front.
    let (mut rest, tail) = body.split_at_checked(body.len().checked_sub(stride.max(32))?)?;
    let mut last = tail[tail.len() - stride..].to_vec();
    let block = ((8192 / stride) & !(GROUP - 1)).min(256);
    for elements in out.chunks_mut(block * stride) {
        let groups = (elements.len() / stride).div_ceil(GROUP);
        for (byte, previous) in last.iter_mut().enumerate() {
            let (header, after) = rest.split_at_checked(groups.div_ceil(4))?;
            rest = after;
            for g in 0..groups {
                let bits = header[g / 4] >> (g % 4 * 2) & 3;
                let deltas = byte_group(&mut rest, bits)?;
                for (i, delta) in deltas.into_iter().enumerate() {
                    let Some(e) = elements.get_mut((g * GROUP + i) * stride + byte) else { break };
                    *previous = previous.wrapping_add((delta >> 1) ^ (delta & 1).wrapping_neg());
                    *e = *previous;
                }
            }
        }
    }
    rest.is_empty().then_some(())
}

/// Sixteen deltas. With `code` 0 all are zero; with 1 and 2 they are packed in 2 or 4 bits, highest first,
/// where the greatest value stands for a whole byte after the packed ones; with 3 they are whole bytes.
fn byte_group(rest: &mut &[u8], code: u8) -> Option<[u8; GROUP]> {
    let mut take = |n: usize| -> Option<&[u8]> {
        let (head, tail) = rest.split_at_checked(n)?;
        *rest = tail;
        Some(head)
    };
    let mut out = [0; GROUP];
    match code {
        0 => {}
        3 => out.copy_from_slice(take(GROUP)?),
        _ => {
            let bits = usize::from(code) * 2;
            let escape = (1u8 << bits) - 1;
            let packed = take(GROUP * bits / 8)?;
            for (i, value) in out.iter_mut().enumerate() {
                let at = i * bits;
                *value = packed[at / 8] >> (8 - bits - at % 8) & escape;
                if *value == escape {
                    *value = take(1)?[0];
                }
            }
        }
    }
    Some(out)
}

/// Filter EXPONENTIAL: 32-bit words of a signed 8-bit exponent and a signed 24-bit mantissa become `f32`.
pub(super) fn exponential(bytes: &mut [u8]) {
    for word in bytes.chunks_exact_mut(4) {
        let v = i32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        let (exponent, mantissa) = (v >> 24, v << 8 >> 8);
        // Exact in f64 and rounded once to f32. A value beyond its range becomes infinite, which is refused
        // later.
        let value = f64::from(mantissa) * 2f64.powi(exponent);
        word.copy_from_slice(&(value as f32).to_le_bytes());
    }
}
