//! EXT_meshopt_compression: decoding compressed buffer views (appendix A of the extension's specification).
//!
//! Written here in safe Rust, as the text of the extension describes the three bitstreams: the pure-Rust crate takes an
//! element's size from a Rust type, where a file gives any stride, and the bindings to the C++ library need a C++ compiler
//! and the same. The tests decode what that crate encodes. Only what positions and indices use is decoded: of the
//! filters, EXPONENTIAL.

use sightline_numbers::varint;

use super::json::MeshoptView;

/// The bytes of the view before compression, `count * byteStride` of them.
pub(super) fn decode(view: &MeshoptView, data: &[u8]) -> Result<Vec<u8>, String> {
    let truncated = || "its data are too short for its count".to_owned();
    let (count, stride) = (view.count, view.byte_stride);
    let size = count.checked_mul(stride).ok_or_else(truncated)?;
    // The densest stream has 64 bytes in one (a group of zeros takes two bits), and not less than its tail.
    if size / 64 > data.len() as u64 {
        return Err(truncated());
    }
    // Below 64 times the length of a slice, and counts below that.
    let (count, stride, size) = (count as usize, stride as usize, size as usize);
    let filter = view.filter.as_deref().unwrap_or("NONE");
    match view.mode.as_str() {
        "ATTRIBUTES" => {
            if stride == 0 || stride > 256 || stride % 4 != 0 {
                return Err(format!("its stride of {stride} bytes is not a multiple of 4 up to 256"));
            }
            let mut out = vec![0; size];
            attributes(&mut out, stride, data).ok_or("its vertex data are malformed or truncated")?;
            match filter {
                "NONE" => {}
                "EXPONENTIAL" => exponential(&mut out),
                other => {
                    let shown: String = other.chars().take(20).collect();
                    return Err(format!("the filter {shown} is not one for positions"));
                }
            }
            Ok(out)
        }
        "TRIANGLES" | "INDICES" if filter != "NONE" => Err("indices cannot have a filter".to_owned()),
        mode @ ("TRIANGLES" | "INDICES") => {
            if stride != 2 && stride != 4 {
                return Err(format!("its stride is {stride} bytes, and indices take 2 or 4"));
            }
            // Every index of a sequence, and every three of a list, take a byte at least.
            if count / 3 > data.len() {
                return Err(truncated());
            }
            let indices =
                if mode == "TRIANGLES" { triangles(count, data) } else { index_sequence(count, data) };
            let indices = indices.ok_or("its index data are malformed or truncated")?;
            let mut out = Vec::with_capacity(size);
            for i in indices {
                if stride == 2 && i > 0xffff {
                    return Err(format!("its index {i} does not fit 16 bits"));
                }
                out.extend_from_slice(&i.to_le_bytes()[..stride]);
            }
            Ok(out)
        }
        other => {
            let shown: String = other.chars().take(20).collect();
            Err(format!("its mode {shown} is unknown"))
        }
    }
}

/// Elements in a byte group.
const GROUP: usize = 16;

/// Mode ATTRIBUTES, version 0: blocks of elements, within a block one byte of all elements after another, each as
/// zigzag deltas in groups of 16 with 0, 2, 4 or 8 bits a delta. `stride` is a multiple of 4 in 4..=256.
fn attributes(out: &mut [u8], stride: usize, data: &[u8]) -> Option<()> {
    let (&0xa0, body) = data.split_first()? else { return None };
    // The tail holds the element before the first one, padded in front.
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

/// Sixteen deltas: `code` 0 all zero, 1 and 2 packed in 2 or 4 bits, highest first, with the greatest value standing
/// for a whole byte that follows the packed ones, 3 whole bytes.
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

/// A number of up to 32 bits; bits beyond them, which no encoder writes, are dropped.
fn number(rest: &mut &[u8]) -> Option<u32> {
    varint::read(rest, 5).ok().map(|v| v as u32)
}

/// `v` with its sign moved from the lowest bit.
fn unzigzag(v: u32) -> u32 {
    (v >> 1) ^ (v & 1).wrapping_neg()
}

/// Mode INDICES: each index a delta to one of two running baselines.
fn index_sequence(count: usize, data: &[u8]) -> Option<Vec<u32>> {
    let (&0xd1, body) = data.split_first()? else { return None };
    let (mut rest, _tail) = body.split_at_checked(body.len().checked_sub(4)?)?;
    if count > rest.len() {
        return None;
    }
    let mut last = [0u32; 2];
    let mut out = Vec::with_capacity(count);
    for _ in 0..count {
        let v = number(&mut rest)?;
        let baseline = &mut last[(v & 1) as usize];
        *baseline = baseline.wrapping_add(unzigzag(v >> 1));
        out.push(*baseline);
    }
    rest.is_empty().then_some(out)
}

/// The last sixteen of something, counted back from the newest.
struct Fifo<T> {
    items: [T; 16],
    next: usize,
}

impl<T: Copy> Fifo<T> {
    fn new(item: T) -> Self {
        Self { items: [item; 16], next: 0 }
    }

    fn push(&mut self, item: T) {
        self.items[self.next] = item;
        self.next = (self.next + 1) & 15;
    }

    /// The item pushed `back` pushes ago; 1 is the newest.
    fn back(&self, back: usize) -> T {
        self.items[self.next.wrapping_sub(back) & 15]
    }
}

/// Decoder of mode TRIANGLES.
struct TriangleDecoder<'a> {
    /// Edges of recent triangles.
    edges: Fifo<(u32, u32)>,
    /// Recent vertices.
    vertices: Fifo<u32>,
    /// The least index not met yet.
    next: u32,
    /// The last index written as a delta.
    last: u32,
    rest: &'a [u8],
}

impl TriangleDecoder<'_> {
    fn fresh(&mut self) -> u32 {
        let n = self.next;
        self.next = n.wrapping_add(1);
        n
    }

    fn delta(&mut self) -> Option<u32> {
        let v = number(&mut self.rest)?;
        self.last = self.last.wrapping_add(unzigzag(v));
        Some(self.last)
    }

    /// A triangle that shares an edge with a recent one.
    fn on_edge(&mut self, code: u8) -> Option<[u32; 3]> {
        let (a, b) = self.edges.back(usize::from(code >> 4) + 1);
        let c = match code & 15 {
            0 => self.fresh(),
            f @ 1..=12 => self.vertices.back(usize::from(f) + 1),
            13 => {
                self.last = self.last.wrapping_sub(1);
                self.last
            }
            14 => {
                self.last = self.last.wrapping_add(1);
                self.last
            }
            _ => self.delta()?,
        };
        // A vertex found among the recent ones is not pushed again.
        if !(1..=12).contains(&(code & 15)) {
            self.vertices.push(c);
        }
        self.edges.push((c, b));
        self.edges.push((a, c));
        Some([a, b, c])
    }

    /// A triangle on its own.
    fn alone(&mut self, code: u8, table: &[u8]) -> Option<[u32; 3]> {
        let (a_code, aux) = if code < 0xfe {
            (0, *table.get(usize::from(code & 15))?)
        } else {
            let (&aux, tail) = self.rest.split_first()?;
            self.rest = tail;
            if aux == 0 {
                self.next = 0;
            }
            (if code == 0xfe { 0 } else { 15 }, aux)
        };
        let codes = [a_code, aux >> 4, aux & 15];
        // All three are told before any delta is read: fresh ones count up first.
        let mut v = [0u32; 3];
        for (v, code) in v.iter_mut().zip(codes) {
            *v = if code == 0 { self.fresh() } else { self.vertices.back(usize::from(code)) };
        }
        for (v, code) in v.iter_mut().zip(codes) {
            if code == 15 {
                *v = self.delta()?;
            }
        }
        let [a, b, c] = v;
        for (v, code) in v.into_iter().zip(codes) {
            if code == 0 || code == 15 {
                self.vertices.push(v);
            }
        }
        self.edges.push((b, a));
        self.edges.push((c, b));
        self.edges.push((a, c));
        Some(v)
    }
}

/// Mode TRIANGLES: one code byte a triangle, then the deltas, then a table of 16 frequent codes.
fn triangles(count: usize, data: &[u8]) -> Option<Vec<u32>> {
    let (&0xe1, body) = data.split_first()? else { return None };
    if !count.is_multiple_of(3) {
        return None;
    }
    let (codes, rest) = body.split_at_checked(count / 3)?;
    let (rest, table) = rest.split_at_checked(rest.len().checked_sub(16)?)?;
    let mut d = TriangleDecoder {
        edges: Fifo::new((u32::MAX, u32::MAX)),
        vertices: Fifo::new(u32::MAX),
        next: 0,
        last: 0,
        rest,
    };
    let mut out = Vec::with_capacity(count);
    for &code in codes {
        out.extend(if code < 0xf0 { d.on_edge(code)? } else { d.alone(code, table)? });
    }
    d.rest.is_empty().then_some(out)
}

/// Filter EXPONENTIAL: 32-bit words of a signed 8-bit exponent and a signed 24-bit mantissa become `f32`.
fn exponential(bytes: &mut [u8]) {
    for word in bytes.chunks_exact_mut(4) {
        let v = i32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        let (exponent, mantissa) = (v >> 24, v << 8 >> 8);
        // Exact in f64; rounding to f32 happens once, and beyond its range becomes infinite, which is refused later.
        let value = f64::from(mantissa) * 2f64.powi(exponent);
        word.copy_from_slice(&(value as f32).to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meshopt_rs::index::IndexEncodingVersion;
    use meshopt_rs::index::{buffer as ix, sequence};
    use meshopt_rs::vertex::VertexEncodingVersion;
    use meshopt_rs::vertex::buffer as vx;
    use proptest::prelude::*;

    fn view(mode: &str, count: usize, stride: usize, filter: Option<&str>) -> MeshoptView {
        MeshoptView {
            buffer: 0,
            byte_offset: 0,
            byte_length: 0,
            byte_stride: stride as u64,
            count: count as u64,
            mode: mode.into(),
            filter: filter.map(Into::into),
        }
    }

    fn pack_vertices<const N: usize>(v: &[[u8; N]]) -> Vec<u8> {
        let mut out = vec![0; vx::encode_vertex_buffer_bound(v.len(), N)];
        let n = vx::encode_vertex_buffer(&mut out, v, VertexEncodingVersion::default()).unwrap();
        out.truncate(n);
        out
    }

    fn le(v: &[u32]) -> Vec<u8> {
        v.iter().flat_map(|i| i.to_le_bytes()).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Another implementation's encoder, our decoder.
        #[test]
        fn vertices_come_back(
            v in proptest::collection::vec(proptest::array::uniform12(any::<u8>()), 0..700),
            quiet in any::<u8>(),
        ) {
            // Masking makes groups of every width.
            let v: Vec<[u8; 12]> = v.into_iter().enumerate()
                .map(|(i, e)| e.map(|b| b & (quiet >> (i / 64 % 8)))).collect();
            let got = decode(&view("ATTRIBUTES", v.len(), 12, None), &pack_vertices(&v)).unwrap();
            prop_assert_eq!(got, v.concat());
        }

        #[test]
        fn wide_vertices_come_back(v in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 256), 1..70)) {
            let v: Vec<[u8; 256]> = v.into_iter().map(|e| e.try_into().unwrap()).collect();
            let got = decode(&view("ATTRIBUTES", v.len(), 256, None), &pack_vertices(&v)).unwrap();
            prop_assert_eq!(got, v.concat());
        }

        /// Triangles come back up to the rotation of each, which the encoder may choose.
        #[test]
        fn triangle_lists_come_back(t in proptest::collection::vec(proptest::array::uniform3(0u32..40), 0..200)) {
            let flat = t.concat();
            let mut out = vec![0; ix::encode_index_buffer_bound(flat.len(), 40)];
            let n = ix::encode_index_buffer(&mut out, &flat, IndexEncodingVersion::V1).unwrap();
            let got = decode(&view("TRIANGLES", flat.len(), 4, None), &out[..n]).unwrap();
            prop_assert_eq!(got.len(), flat.len() * 4);
            for (t, g) in t.iter().zip(got.chunks(12)) {
                let [a, b, c] = *t;
                prop_assert!([[a, b, c], [b, c, a], [c, a, b]].iter().any(|r| le(r) == g));
            }
        }

        #[test]
        fn sequences_come_back(v in proptest::collection::vec(any::<u16>(), 0..300)) {
            let v: Vec<u32> = v.into_iter().map(u32::from).collect();
            let mut out = vec![0; sequence::encode_index_sequence_bound(v.len(), 65536)];
            let n = sequence::encode_index_sequence(&mut out, &v, IndexEncodingVersion::V1);
            prop_assert_eq!(decode(&view("INDICES", v.len(), 4, None), &out[..n]).unwrap(), le(&v));
        }

        #[test]
        fn noise_is_refused_or_decoded(
            head in prop_oneof![Just(0xa0u8), Just(0xe1), Just(0xd1)],
            body in proptest::collection::vec(any::<u8>(), 0..200),
            count in 0usize..100,
        ) {
            let data = [vec![head], body].concat();
            for (mode, stride) in [("ATTRIBUTES", 12), ("TRIANGLES", 4), ("INDICES", 2)] {
                if let Ok(out) = decode(&view(mode, count, stride, None), &data) {
                    prop_assert_eq!(out.len(), count * stride);
                }
            }
        }
    }

    #[test]
    fn exponents_are_applied() {
        let words: Vec<u32> = vec![0x0000_0003, 0xff00_0003, 0x01ff_ffff, 0x0000_0000];
        let mut bytes = le(&words);
        exponential(&mut bytes);
        let got: Vec<f32> = bytes.chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        assert_eq!(got, [3.0, 1.5, -2.0, 0.0]);
    }

    #[test]
    fn counts_beyond_the_data_are_refused_before_allocating() {
        let v = view("ATTRIBUTES", 1 << 40, 256, None);
        assert!(decode(&v, &[0xa0; 100]).is_err());
        assert!(decode(&view("TRIANGLES", 3 << 30, 4, None), &[0xe1; 100]).is_err());
    }
}
